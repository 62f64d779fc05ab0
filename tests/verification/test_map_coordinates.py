"""Bodies far from the origin, as in map coordinates: the same results but for rounding.

Coordinates of 5e6 m are rounded to 1e-9 m, 1e-8 of a cell of 0.1 m. Parts of domains of this size
had made cells, nodes and leaves active, and had decided which cells are well filled.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import WideComparisonWarning
from dolfinmpm.grid.lattice import lattice_of

H, MAP = 0.1, (5e5, 5e6)
LAW = mpm.materials.Hencky(E=1e6, nu=0.3)


def slope(origin, basis, kind=mesh.CellType.quadrilateral, **options):
    """A slope of five cells in height under its weight; points, field, form, conditions, weight."""
    x0, y0 = origin
    grid = mesh.create_rectangle(COMM, [(x0, y0), (x0 + 10 * H, y0 + 8 * H)], (10, 8), kind)
    if "refine" in options:
        middle = np.array([[x0 + 4.03 * H], [y0 + 2.07 * H]])
        options["refine"] = lambda x: np.where(
            np.linalg.norm(x - middle, axis=0) < 2.13 * H, H / 4, H
        )
    V = mpm.Space(grid, basis, **options)
    corners = np.array([(0, 0), (7.3, 0), (4.3, 4.7), (0, 5.2)]) * H + origin
    refined = {"refine": V} if "refine" in options else {}
    points = mpm.fill(grid, mpm.Polygon(corners), per_cell=2, density=2000.0, **refined)
    g = fem.Constant(grid, (0.0, -20.0))
    F = mpm.momentum(LAW, points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    return points, V, F, mpm.rollers(V, "left") + mpm.fixed(V, "bottom"), g


def settled(origin, basis, stabilisation, **options):
    """Stresses after three steps, in the order of the points, and the iterations."""
    points, V, F, bcs, g = slope(origin, basis, **options)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)
    iterations = []
    for load in (10.0, 20.0, 30.0):
        g.value[1] = -load
        iterations.append(problem.step().iterations)
    return points.gather("stress")[0], iterations


def thrown(origin, basis, scheme):
    """Stresses after 20 ms of explicit steps, in the order of the points."""
    points, V, F, bcs, _ = slope(origin, basis)
    problem = mpm.Explicit(F, V.increment, points, bcs, scheme=scheme)
    problem.step(0.02)
    return points.gather("stress")[0]


def check(far, near):
    np.testing.assert_allclose(far, near, atol=3e-7 * np.abs(near).max())


@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation", "extended"])
@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2", "bspline3"])
def test_slope(basis, stabilisation):
    """GIMP with a ghost penalty had been off by 2e-4, splines with aggregation by 3e-2."""
    (far, i), (near, k) = (settled(origin, basis, stabilisation) for origin in (MAP, (0.0, 0.0)))
    check(far, near)
    assert i == k


@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2", "bspline3"])
def test_leaves(basis):
    """Another number of leaves, and of points."""
    runs = (
        settled(origin, basis, "aggregation", refine=True, levels=2) for origin in (MAP, (0.0, 0.0))
    )
    (far, i), (near, k) = runs
    check(far, near)
    assert i == k


@pytest.mark.parametrize("scheme", ["musl", pytest.param("usl", marks=pytest.mark.long)])
def test_explicit_steps(scheme):
    check(*(thrown(origin, "gimp", scheme) for origin in (MAP, (0.0, 0.0))))


def test_sides_of_a_small_grid_of_triangles():
    """One node of eleven had been at the bottom, without a message."""
    bcs = slope(MAP, "linear", kind=mesh.CellType.triangle)[3]
    assert COMM.allreduce(len(bcs[-1].nodes)) >= 11
    runs = (
        settled(origin, "linear", "aggregation", kind=mesh.CellType.triangle)
        for origin in (MAP, (0.0, 0.0))
    )
    (far, _), (near, _) = runs
    check(far, near)


def test_a_uniform_grid_is_uniform():
    near, far = (slope(origin, "gimp")[0].grid for origin in ((0.0, 0.0), MAP))
    for grid in (near, far):
        assert lattice_of(grid).uniform
        assert isinstance(mpm.cell_size(grid), fem.Constant)
    assert float(mpm.cell_size(far).value) == pytest.approx(H, rel=1e-8)


def pressed(origin, basis):
    """Stresses under a pressure that follows the top of a block, after two steps."""
    x0, y0 = origin
    grid = mesh.create_rectangle(
        COMM, [(x0, y0), (x0 + 8 * H, y0 + 8 * H)], (8, 8), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((x0, y0), (x0 + 6 * H, y0 + 5 * H)), 2, 2000.0)
    V = mpm.Space(grid, basis)
    top = mpm.Surface(points, lambda x: x[1] > y0 + 4.9 * H, (0, 1))
    p = fem.Constant(grid, 0.0)
    F = mpm.momentum(LAW, points, V.increment, V.test) + top.pressure(p, V.increment, V.test)
    bcs = mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    for p.value in (1e3, 2e3):
        problem.step()
    return points.gather("stress")[0]


@pytest.mark.parametrize("basis", ["gimp", "bspline2", "bspline3"])
def test_faces_under_pressure(basis):
    """A face off the end of its domain by rounding had ended in forces that are not finite."""
    check(*(pressed(origin, basis) for origin in (MAP, (0.0, 0.0))))


def test_a_comparison_of_map_coordinates_as_wide_as_the_body():
    """All nodes had been held, so that the stress of the body was zero."""
    y0, kind = 5e6, mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(COMM, [(0, y0), (2, y0 + 2)], (4, 4), kind)
    V = mpm.Space(grid)
    with pytest.warns(
        WideComparisonWarning, match=r"tolerance of 50 m at x\[1\] = 5000002 m, 1e-5"
    ):
        mpm.prescribed(V, lambda x: np.isclose(x[1], y0), 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mpm.prescribed(V, lambda x: np.isclose(x[1], y0, rtol=0.0, atol=1e-6), 1)
        mpm.prescribed(V, lambda x: x[1] < y0 + 1.1, 1)
        # two sides at once, near the origin
        near = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (4, 4), kind)
        V = mpm.Space(near)
        mpm.prescribed(V, lambda x: np.isclose(x[1], 0.0) | np.isclose(x[0], 0.0), 1)
