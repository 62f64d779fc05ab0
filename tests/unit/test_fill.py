"""Filling shapes: exact volumes, and named errors for what cannot be filled."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import unit_grid
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    ParameterError,
    RoughShapeWarning,
    ShapeOutsideGridError,
    UnsupportedGridError,
)
from dolfinmpm.body import cellparts
from dolfinmpm.body.polygonpieces import moments_in_boxes, touched_boxes


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


def box_grid(kind, n=8):
    """A grid of [-1, 1]^d."""
    d = 2 if kind in ("triangle", "quadrilateral", "distorted") else 3
    cell = mesh.CellType["quadrilateral" if kind == "distorted" else kind]
    make = mesh.create_rectangle if d == 2 else mesh.create_box
    grid = make(MPI.COMM_WORLD, [(-1.0,) * d, (1.0,) * d], (n,) * d, cell)
    if kind == "distorted":
        x = grid.geometry.x
        x[:, 0] += 0.05 * np.sin(3 * x[:, 1]) * (1 - x[:, 0] ** 2)
    return grid


@pytest.mark.parametrize(
    ("kind", "shape"),
    [
        ("hexahedron", mpm.Ball((0, 0, 0), 0.7)),
        ("tetrahedron", mpm.Ball((0.01, 0.02, 0.05), 0.7)),
        ("quadrilateral", mpm.Disc((0.01, 0.02), 0.7)),
        ("distorted", mpm.Disc((0.01, 0.02), 0.7)),
        ("triangle", mpm.Disc((0.01, 0.02), 0.7)),
        ("quadrilateral", mpm.Polygon([(-0.9, -0.9), (0.8, -0.7), (0.1, 0.75), (-0.1, -0.4)])),
        ("quadrilateral", mpm.TurnedBox((-0.5, -0.3), (0.5, 0.3), np.degrees(0.3))),
        # parts are cut by less than a tenth of their width, and by less than a sample's
        ("quadrilateral", mpm.TurnedBox((-0.74, -0.51), (0.74, 0.26), 0.0)),
        ("quadrilateral", mpm.TurnedBox((-0.75, -0.5), (0.751, 0.25), 0.0)),
        ("triangle", mpm.Box((-0.7, -0.4), (0.6, 0.3))),
        ("quadrilateral", mpm.Disc((0.13, 0.2), 0.05)),
    ],
)
def test_exact_volume_and_centre_of_mass(kind, shape):
    points = mpm.fill(box_grid(kind), shape, per_cell=2, density=3.0, exact=True)
    V, x = points["V"], points["x"]
    assert V.sum() == pytest.approx(shape.volume, rel=1e-12)
    np.testing.assert_allclose(V @ x / V.sum(), shape.centroid, rtol=0, atol=1e-12)
    assert abs(points.volume_error) < 1e-12
    assert V.min() > 0
    np.testing.assert_allclose(np.prod(2 * points["l"], axis=1), V, rtol=1e-10)


@pytest.mark.parametrize("n", [2, 4])
def test_an_edge_along_diagonals_leaves_whole_parts_alone(n):
    """Cut pieces on one line get their moment across it by a shift, and no other piece changes."""
    lines = [np.arange(20 * n + 1) / n, np.arange(10 * n + 1) / n]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    slope = mpm.Polygon([(0, 0), (20, 0), (20, 1), (17, 1), (10, 8), (0, 8)])
    points = mpm.fill(grid, slope, per_cell=2, density=1.0, exact=True)
    crest = mpm.Surface(points, lambda x: np.isclose(x[1], 8.0) & (x[0] < 10), normal=(0, 1))
    np.testing.assert_allclose(crest.total_area, 10.0, rtol=1e-12)
    middle = points["V"] @ points["x"] / points["V"].sum()
    np.testing.assert_allclose(middle, slope.centroid, rtol=1e-12)


def test_what_exact_volumes_mend():
    """A ball of radius 0.7 on cells of 0.25: 2.1 % too light, its moment of inertia by as much."""
    grid, ball = box_grid("hexahedron"), mpm.Ball((0, 0, 0), 0.7)
    inertia = 0.6 * ball.volume * 0.49
    errors = {}
    for exact in (False, True):
        points = mpm.fill(grid, ball, per_cell=2, density=1.0, exact=exact)
        own = np.sum(points["l"] ** 2, axis=1) / 3
        second = points["V"] @ (np.sum(points["x"] ** 2, axis=1) + own)
        errors[exact] = points.volume_error, second / inertia - 1
    assert errors[False][0] == pytest.approx(-0.0212, abs=1e-4)
    assert abs(errors[False][1]) > 0.02
    assert abs(errors[True][0]) < 1e-12
    assert abs(errors[True][1]) < 2e-4


def test_a_volume_that_is_far_off_is_told():
    grid = unit_grid("quadrilateral", 4)
    plate = mpm.TurnedBox((0.1, 0.4), (0.9, 0.48), 30.0)
    with pytest.warns(RoughShapeWarning, match=r"the volume 0\.0\d+, and their shape has 0\.064"):
        points = mpm.fill(grid, plate, per_cell=2, density=1.0)
    assert abs(points.volume_error) > 0.15
    assert abs(mpm.fill(grid, plate, per_cell=2, density=1.0, exact=True).volume_error) < 1e-12


def test_combinations_are_as_good_as_sampling():
    ring = mpm.Disc((0, 0), 0.8) - mpm.Disc((0.1, 0), 0.3)
    points = mpm.fill(box_grid("quadrilateral"), ring, per_cell=2, density=1.0, exact=True)
    assert points["V"].sum() == pytest.approx(0.55 * np.pi, rel=1e-3)
    assert points.volume_error is None
    # who knows the volume may say so
    ring.volume = 0.55 * np.pi
    points = mpm.fill(box_grid("quadrilateral"), ring, per_cell=2, density=1.0, exact=True)
    assert points["V"].sum() == pytest.approx(0.55 * np.pi, rel=1e-12)
    ring.volume = 3.0
    with pytest.raises(ParameterError, match="too far apart to be made equal"):
        mpm.fill(box_grid("quadrilateral"), ring, per_cell=2, density=1.0, exact=True)


def test_volumes_and_centroids_of_shapes():
    """Against sums over fine samples."""
    line = (np.arange(400) + 0.5) / 200 - 1
    x = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    for shape in (
        mpm.Box((-0.3, 0.1), (0.4, 0.8)),
        mpm.TurnedBox((-0.5, -0.3), (0.5, 0.2), np.degrees(0.7)),
        mpm.Disc((0.1, -0.2), 0.6),
        mpm.Polygon([(-0.9, -0.9), (-0.1, -0.4), (0.1, 0.75), (-0.6, 0.1)]),
    ):
        inside = shape.contains(x)
        assert shape.volume == pytest.approx(inside.sum() * 0.005**2, rel=5e-3)
        np.testing.assert_allclose(shape.centroid, x[inside].mean(axis=0), atol=3e-3)
    assert mpm.Ball((0, 0, 0), 2.0).volume == pytest.approx(32 / 3 * np.pi)
    assert mpm.Ball((0,), 2.0).volume == pytest.approx(4.0)
    far = mpm.Polygon([(1e6, 1e6), (1e6 + 1, 1e6), (1e6, 1e6 + 1)])
    np.testing.assert_allclose(far.centroid - 1e6, 1 / 3, atol=1e-9)


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        ([(0, 0), (1, 1), (1, 0), (0, 1)], "edge 0 .* meets edge 2"),
        ([(0, 0), (2, 0), (2, 1), (1, 0), (0, 1)], "edge 0 .* meets edge 2"),
        ([(0, 0), (1, 0), (2, 0)], "edge 0 .* meets edge"),
        ([(0, 0), (1, 0), (1, 1), (1, 0.5), (0, 1)], "edge 1 .* meets edge 2"),
        ([(0, 0), (1, 0), (1, 1), (0, 0)], "corners 0 and 3 .* are the same"),
        ([(0, 0), (1, 0), (1, float("nan"))], "corner 2 .* must be finite"),
        ([(0, 0), (1, 0)], "n >= 3"),
    ],
)
def test_polygons_that_are_none(corners, message):
    with pytest.raises(ParameterError, match=message):
        mpm.Polygon(corners)


def test_polygons_that_only_look_wrong():
    # a corner on a straight side, and teeth
    teeth = [(0, 0), (0.5, 0), (1, 0), (1, 1), (0.8, 0.1), (0.6, 1), (0.4, 0.1), (0.2, 1), (0, 0.1)]
    assert mpm.Polygon(teeth).volume == pytest.approx(mpm.Polygon(teeth[::-1]).volume)


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


def test_a_shape_beyond_the_axis():
    """A grid that is larger there would be refused, too."""
    with pytest.raises(ShapeOutsideGridError, match="cut the shape at the axis, as in shape & mpm"):
        mpm.fill(unit_grid("quadrilateral"), mpm.Disc((0, 0.5), 0.4), 2, 1.0, axisymmetric=True)


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
    with pytest.raises(ParameterError, match=r"per_cell = 2\.0 must be a whole number"):
        mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2.0, density=1.0)
    with pytest.raises(ParameterError, match=r"one shape, got a str; use mpm\.Box"):
        mpm.fill(grid, "box", 2, density=1.0)
    two = [mpm.fill(grid, mpm.Box((0, 0), (0.5, 1)), 2, 1.0)] * 2
    with pytest.raises(ParameterError, match="one shape, got a list"):
        mpm.fill(grid, two, 2, density=1.0)
    with pytest.raises(
        ParameterError, match=r"got a MaterialPoints; join bodies of points with \+"
    ):
        mpm.fill(grid, two[0], 2, density=1.0)
    with pytest.raises(ParameterError, match=r"dolfinx\.mesh\.Mesh, got a int"):
        mpm.fill(3, mpm.Box((0, 0), (1, 1)), 2, density=1.0)
    with pytest.raises(ParameterError, match="3 coordinates cannot be combined with one of 2"):
        mpm.Box((0, 0, 0), (1, 1, 1)) | mpm.Box((0, 0), (1, 1))
    with pytest.raises(ParameterError, match="shapes only, got a int"):
        mpm.Box((0, 0), (1, 1)) - 1
    with pytest.raises(ParameterError, match=r"Where should tell of .* it returned float64"):
        mpm.fill(grid, mpm.Where(lambda x: x[0]), 2, density=1.0)
    with pytest.raises(ParameterError, match=r"density = \[1\.0, 2\.0\] must be a number"):
        mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, density=[1.0, 2.0])
    with pytest.raises(ParameterError, match=r"tag = 1\.5"):
        mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, density=1.0, tag=1.5)
    single = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2, dtype=np.float32)
    with pytest.raises(UnsupportedGridError, match=r"float32; .* dtype=np\.float64"):
        mpm.fill(single, mpm.Box((0, 0), (1, 1)), 2, density=1.0)
    grid.topology.create_connectivity(1, 2)
    facets = mesh.exterior_facet_indices(grid.topology)
    edge = mesh.create_submesh(grid, 1, facets)[0]
    with pytest.raises(UnsupportedGridError, match="cells of dimension 1 in 2D"):
        mpm.fill(edge, mpm.Box((0, 0), (1, 1)), 2, density=1.0)
    box, triangles = mpm.Box((0, 0), (1, 1)), unit_grid("triangle")
    with pytest.raises(UnsupportedGridError, match="rectangular"):
        mpm.fill(triangles, box, 2, density=1.0, aligned="body")


def test_more_points_than_can_be_meant_are_refused(monkeypatch):
    grid = box_grid("quadrilateral")
    with pytest.raises(
        ParameterError, match=r"per_cell = 5000 puts 2\.5e\+07 points into each cell"
    ):
        mpm.fill(grid, mpm.Box((0.1, 0.2), (0.8, 0.7)), per_cell=5000, density=1.0)
    # and more than the machine has room for
    monkeypatch.setattr(cellparts, "_memory", lambda: 1e6)
    for kind in ("quadrilateral", "triangle"):
        shape = mpm.Box((0.1, 0.2), (0.8, 0.7))
        with pytest.raises(
            ParameterError, match=r"per_cell = 50 makes .* GB at least, .* 0\.001 GB"
        ):
            mpm.fill(box_grid(kind), shape, per_cell=50, density=1.0)
    with pytest.raises(ParameterError, match="GB at least"):
        mpm.fill(grid, mpm.Box((0.1, 0.2), (0.8, 0.7)), 50, density=1.0, aligned="body")
    mpm.fill(grid, mpm.Box((0.1, 0.2), (0.8, 0.7)), per_cell=2, density=1.0)


@pytest.mark.parametrize("top", [4.7, 4.55, 5.05])
@pytest.mark.parametrize("h", [0.5, 0.25])
def test_faces_of_a_polygon_between_lines(h, top):
    """A slope whose crest lies within cells has whole faces at its crest and at its side."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 14 + h, h), np.arange(0, 6 + h, h)])
    corners = [(0, 0), (14, 0), (14, 2), (10, 2), (6, top), (0, top)]
    shape = mpm.Polygon(corners)
    points = mpm.fill(grid, shape, 2, 1.0, exact=True)
    crest = mpm.Surface(points, lambda x: np.isclose(x[1], top), normal=(0, 1))
    side = mpm.Surface(points, lambda x: np.isclose(x[0], 0.0), normal=(-1, 0))
    assert crest.total_area == pytest.approx(6.0, rel=1e-12)
    assert side.total_area == pytest.approx(top, rel=1e-12)
    V0 = points["V0"]
    assert points.comm.allreduce(V0.sum()) == pytest.approx(shape.volume, rel=1e-12)
    np.testing.assert_allclose(V0 @ points["x"] / V0.sum(), shape.centroid, rtol=1e-11)


def test_boxes_cut_polygons_exactly():
    """Moments of a star in boxes add up to its own, in either order of its corners."""
    angle = 2 * np.pi * np.arange(14) / 14 + 0.1
    radius = np.where(np.arange(14) % 2, 0.3, 0.95)
    corners = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    line = np.linspace(-1, 1, 14)
    low = np.stack(np.meshgrid(line[:-1], line[:-1]), axis=-1).reshape(-1, 2)
    high, star = low + 2 / 13, mpm.Polygon(corners)
    found = moments_in_boxes(corners, low, high)
    area, middle = found[:, :1], 0.5 * (low + high)
    assert area.sum() == pytest.approx(star.volume, rel=1e-13)
    first = np.sum(found[:, 1:3] + area * middle, axis=0)
    np.testing.assert_allclose(first / star.volume, star.centroid, atol=1e-14)
    second = found[:, 3:] + 2 * middle * found[:, 1:3] + area * middle**2
    fine = star.contains(
        np.stack(np.meshgrid(*[(np.arange(2000) + 0.5) / 1000 - 1] * 2), -1).reshape(-1, 2)
    )
    x = ((np.arange(2000) + 0.5) / 1000 - 1)[None].repeat(2000, 0).ravel()[fine]
    assert second[:, 0].sum() == pytest.approx((x**2).sum() * 1e-6, rel=2e-3)
    np.testing.assert_allclose(
        moments_in_boxes(corners[::-1].copy(), low, high), -found, atol=1e-15
    )
    # only boxes that an edge enters are neither full nor empty
    between = (area[:, 0] > 1e-12) & (area[:, 0] < (2 / 13) ** 2 - 1e-12)
    assert not np.any(between & ~touched_boxes(corners, low, high))
