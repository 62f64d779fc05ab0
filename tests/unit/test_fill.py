"""Filling shapes: exact volumes, and named errors for what cannot be filled."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import unit_grid
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    FieldShapeError,
    ParameterError,
    ShapeOutsideGridError,
    UnsupportedGridError,
)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_parts_of_equal_cells_tile_the_grid(any_grid, n):
    d = any_grid.geometry.dim
    points = mpm.fill(any_grid, mpm.Box((0.0,) * d, (1.0,) * d), per_cell=n, density=2.0)
    cells = any_grid.topology.index_map(d).size_global
    assert points.total == cells * n**d
    # the Jacobian at the middle of a part is exact but on distorted hexahedra
    np.testing.assert_allclose(points["V"].sum(), 1, rtol=2e-2 if d == 3 else 1e-12)
    assert np.unique(points["id"]).size == points.total


def test_a_box_across_cells_has_its_exact_volume_and_moments():
    grid = unit_grid("quadrilateral", 5)
    points = mpm.fill(grid, mpm.Box((0.113, 0.2), (0.871, 0.777)), per_cell=2, density=1.0)
    np.testing.assert_allclose(points["V"].sum(), 0.758 * 0.577, rtol=1e-12)
    centre = points["V"] @ points["x"] / points["V"].sum()
    np.testing.assert_allclose(centre, [0.492, 0.4885], rtol=1e-12)
    np.testing.assert_allclose(points["V"], np.prod(2 * points["l"], axis=1))


def test_points_may_be_aligned_with_the_body():
    grid = unit_grid("interval", 10)
    points = mpm.fill(grid, mpm.Box(0.23, 0.63), per_cell=2, density=1.0, aligned="body")
    np.testing.assert_allclose(np.sort(points["x"][:, 0]), 0.255 + 0.05 * np.arange(8))


@pytest.mark.parametrize(
    ("shape", "area"),
    [
        (mpm.Disc((0.5, 0.5), 0.3), np.pi * 0.09),
        (mpm.Polygon([(0.1, 0.1), (0.9, 0.1), (0.5, 0.8)]), 0.28),
        (mpm.Box((0, 0), (1, 1)) - mpm.Disc((0.5, 0.5), 0.3), 1 - np.pi * 0.09),
        (mpm.Box((0, 0), (0.6, 1)) & mpm.Box((0.4, 0), (1, 1)), 0.2),
        (mpm.Box((0, 0), (0.2, 1)) | mpm.Box((0.8, 0), (1, 1)), 0.4),
        (mpm.Where(lambda x: x[0] + x[1] < 1), 0.5),
    ],
)
def test_areas_of_shapes(shape, area):
    grid = unit_grid("quadrilateral", 20)
    points = mpm.fill(grid, shape, per_cell=4, density=1.0)
    assert points["V"].sum() == pytest.approx(area, rel=0.02)


def test_density_by_position():
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, density=lambda x: 1 + x[1])
    np.testing.assert_allclose(points["density"], 1 + points["x"][:, 1])


@pytest.mark.parametrize("density", [-1.0, 0.0, float("nan"), float("inf")])
def test_impossible_densities(density):
    with pytest.raises(ParameterError, match="density = "):
        mpm.fill(unit_grid("quadrilateral"), mpm.Box((0, 0), (1, 1)), 2, density=density)


def test_a_shape_outside_the_grid():
    with pytest.raises(ShapeOutsideGridError, match="enlarge the grid"):
        mpm.fill(unit_grid("quadrilateral"), mpm.Box((0, 0), (1, 1.01)), 2, density=1.0)


def test_a_shape_without_a_point():
    with pytest.raises(EmptyShapeError, match="no material point"):
        mpm.fill(unit_grid("quadrilateral"), mpm.Disc((0.5, 0.5), 1e-4), 2, density=1.0)


def test_other_bad_arguments():
    grid = unit_grid("quadrilateral")
    with pytest.raises(ParameterError, match="per_cell = 0"):
        mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 0, density=1.0)
    with pytest.raises(ParameterError, match="has 3 coordinates"):
        mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 1)), 2, density=1.0)
    with pytest.raises(ParameterError, match="aligned"):
        mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, density=1.0, aligned="both")
    with pytest.raises(ParameterError, match="each coordinate"):
        mpm.Box((0, 1), (1, 1))
    box, triangles = mpm.Box((0, 0), (1, 1)), unit_grid("triangle")
    with pytest.raises(UnsupportedGridError, match="rectangular"):
        mpm.fill(triangles, box, 2, density=1.0, aligned="body")


def test_fields_keep_their_shape():
    points = mpm.fill(unit_grid("quadrilateral"), mpm.Box((0, 0), (1, 1)), 2, density=1.0)
    points.add_field("load", (2,), "N/m^2")
    points["load"] = (1.0, 2.0)
    assert points["load"].shape == (len(points), 2)
    assert points.load.ufl_shape == (2,)
    with pytest.raises(FieldShapeError, match="should have shape"):
        points["load"] = np.zeros((3, 3))
    with pytest.raises(FieldShapeError, match="has shape"):
        points.add_field("load", (3,))
    with pytest.raises(KeyError, match="no field 'temperature'"):
        points["temperature"]
    with pytest.raises(AttributeError, match="no field 'temperature'"):
        points.temperature  # noqa: B018
    with pytest.raises(ParameterError, match="cannot name a field"):
        points.add_field("dX")


def test_gather_sorts_by_id():
    points = mpm.fill(unit_grid("quadrilateral"), mpm.Box((0, 0), (1, 1)), 2, density=1.0)
    rows = points.gather("id", "x")
    if MPI.COMM_WORLD.rank == 0:
        assert rows is not None
        assert np.array_equal(rows[0], np.arange(points.total))
