"""Boundaries and walls beside leaves hold a body as on a fine grid."""

from __future__ import annotations

import contextlib
import itertools

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


@pytest.mark.parametrize(
    ("method", "basis"), [("nitsche", "gimp"), ("penalty", "gimp"), ("nitsche", "bspline2")]
)
def test_a_boundary_across_leaves_holds_the_body_as_on_a_fine_grid(method, basis):
    def settled(cells, **options):
        grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, cells + 1)] * 2)
        V = mpm.Space(grid, basis, **options)
        corners = [(0.3, 0.3), (3.7, 0.3), (3.7, 2.3), (0.3, 2.3)]
        body = mpm.Polygon(corners)
        points = mpm.fill(grid, body, per_cell=2, density=2000.0, refine=V, exact=True)
        u, v, law = V.increment, V.test, mpm.materials.Hencky(1e6, 0.3)
        F = mpm.momentum(law, points, u, v)
        load = fem.Constant(grid, (0.0, -9.81))
        F -= ufl.inner(points.density * load, v) * points.dX
        foot = mpm.Boundary.from_polygon(points, corners[:2], closed=False, spacing=0.05)
        extra = {"penalty": 20.0} if method == "penalty" else {}
        F += mpm.dirichlet(foot, u, v, law=law, method=method, **extra)
        problem = mpm.QuasiStatic(F, u, points, stabilisation=mpm.Stabilisation("ghost"))
        problem.step()
        return float(points["V0"] @ (points["x"] - points["x0"])[:, 1]) / 6.8

    fine = settled(16)
    assert settled(4, refine=lambda x: np.full(x.shape[1], 0.25), levels=2) == pytest.approx(
        fine, rel=1e-6
    )
    mixed = settled(4, refine=lambda x: np.where(x[1] < 1.1, 0.25, 0.5), levels=2)
    assert mixed == pytest.approx(fine, rel=0.02)


@pytest.mark.parametrize("gdim", [2, 3])
def test_a_wall_at_a_side_holds_leaves_as_on_a_fine_grid(gdim):
    """With pieces as long as the leaves; those of the grid's cells are too few."""

    def pushed(levels, spacing):
        grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 2, 3 if levels else 5)] * gdim)
        refined = {"refine": lambda x: np.full(x.shape[1], 0.5), "levels": 1} if levels else {}
        V = mpm.Space(grid, "gimp", **refined)
        box = mpm.Box((0.0,) * gdim, (2.0,) * (gdim - 1) + (1.7,))
        points = mpm.fill(grid, box, 2, 1e3, **({"refine": V} if levels else {}))
        u, v = V.increment, V.test
        law = mpm.materials.Hencky(1e6, 0.3)
        F = mpm.momentum(law, points, u, v)
        wall = mpm.Boundary.from_side(points, "right", spacing=spacing)
        F += mpm.signorini(wall, u, v, stiffness_per_area=1e7)
        bcs = mpm.prescribed(V, "left", 0, increment=0.01) + mpm.rollers(V, "bottom")
        if gdim == 3:
            bcs += mpm.rollers(V, "front", "back")
        problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-10)
        told = pytest.warns(mpm.errors.LongPiecesWarning, match="spacing=0.5")
        with told if levels and spacing is None else contextlib.nullcontext():
            problem.step()
        return wall.force(), np.sort(points["stress"][:, 0, 0])

    fine, same, rough = (pushed(*case) for case in ((0, None), (1, 0.5), (1, None)))
    for a, b, c in zip(fine, same, rough):
        assert np.abs(a - b).max() < 1e-8 * np.abs(a).max()
        assert np.abs(a - c).max() > 1e-6 * np.abs(a).max()


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_a_polygon_is_cut_where_leaves_end(basis):
    """A pressure on two sides that end between the lines gives the same stress everywhere."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, 9), np.linspace(0, 3, 7)])
    V = mpm.Space(
        grid, basis, refine=lambda x: np.where(abs(x[0] - 1.3) < 0.4, 0.25, 0.5), levels=1
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (2.7, 1.8)), 2, 1.0, refine=V)
    u, v = V.increment, V.test
    corners = [(2.7, 0), (2.7, 1.8), (0, 1.8)]
    edge = mpm.Boundary.from_polygon(points, corners, closed=False, spacing=0.25)
    assert edge.total_area == pytest.approx(4.5, rel=1e-14)
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), points, u, v) + edge.pressure(1.0, u, v)
    bcs = mpm.rollers(V, "left", "bottom")
    mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-12).step()
    expected = np.broadcast_to(-np.eye(2), (len(points), 2, 2))
    np.testing.assert_allclose(points["stress"][:, :2, :2], expected, rtol=0, atol=1e-9)


def test_pieces_of_an_oblique_polygon_are_no_longer_than_asked():
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, 9), np.linspace(0, 3, 7)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 3)), 2, 1.0)
    ends = [(0.3, 0.1), (3.1, 2.9), (0.9, 2.7)]
    line = mpm.Boundary.from_polygon(points, ends, closed=False, spacing=0.11, rule=1)
    length = sum(np.hypot(*np.subtract(b, a)) for a, b in itertools.pairwise(ends))
    assert line.total_area == pytest.approx(length, rel=1e-14)
    assert line.markers["V"].max() <= 0.11 * (1 + 1e-9)


@pytest.mark.parametrize("spacing", [None, 0.25, 0.125])
def test_pieces_longer_than_leaves_are_told(spacing):
    """Stresses beside a base within leaves were off by a fifth of the weight above it."""
    h, low = 0.25, 0.08
    lines = [h * np.arange(5), np.r_[h * np.arange(-1, 7), 3.0]]
    grid = mpm.create_lattice(MPI.COMM_SELF, lines)
    V = mpm.Space(grid, "gimp", refine=lambda x: np.where(x[0] > 0.51, h / 2, h), levels=1)
    points = mpm.fill(grid, mpm.Box((0, low), (1, 1 + low)), 2, 2e3, exact=True, refine=V)
    u, v, law = V.increment, V.test, mpm.materials.Hencky(1e6, 0.0)
    F = mpm.momentum(law, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), v) * points.dX
    base = mpm.Boundary.from_polygon(points, [(0, low), (1, low)], closed=False, spacing=spacing)
    F += mpm.dirichlet(base, u, v, law=law, direction="normal")

    def rest(x):
        stress = np.zeros((x.shape[1], 3, 3))
        stress[:, 1, 1] = -2e4 * (1 + low - x[1])
        return stress

    mpm.set_stress(law, points, rest)
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "right"), stabilisation="ghost")
    if spacing == 0.125:
        problem.step()
        assert np.abs(points["stress"] - rest(points["x0"].T)).max() < 0.02 * 2e4
        return
    with pytest.warns(mpm.errors.LongPiecesWarning, match=r"spacing=0\.125"):
        problem.step()
    # no second message
    problem.step()
