"""Forms over the active cells of refined spaces: soft stiffness, and forms of one's own."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


def settled(cells, levels, d=2, axisymmetric=False, size=None, **options):
    """A body that settles under its weight in one step; its problem and points."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 4, cells + 1)] * d)
    refined = {}
    if levels:
        wanted = size or (lambda x: np.full(x.shape[1], 4 / (cells * 2**levels)))
        refined = {"refine": wanted, "levels": levels}
    V = mpm.Space(grid, "gimp", **refined)
    body = mpm.Box((0,) * d, (4,) * (d - 1) + (2.3,))
    refined = {"refine": V} if levels else {}
    points = mpm.fill(grid, body, 2, 1000.0, axisymmetric=axisymmetric, **refined)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0,) * (d - 1) + (-10.0,))
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    if "form" in options:
        F += options.pop("form")(points, u, v)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    problem = mpm.QuasiStatic(F, u, points, bcs, tolerance=1e-10, **options)
    problem.step()
    return problem, points


@pytest.mark.parametrize(("d", "axisymmetric"), [(2, False), (2, True), (3, False)])
def test_soft_stiffness_of_equal_leaves_is_that_of_the_grid(d, axisymmetric):
    cells = 4 if d == 2 else 2
    options = {"stabilisation": mpm.Stabilisation("soft", eta=0.1, E=1e6, nu=0.3)}
    grid, _ = settled(2 * cells, 0, d, axisymmetric, **options)
    leaves, _ = settled(cells, 1, d, axisymmetric, **options)
    expected = grid.stiffness().norm()
    assert leaves.stiffness().norm() == pytest.approx(expected, rel=1e-12)
    without, _ = settled(cells, 1, d, axisymmetric)
    assert without.stiffness().norm() < 0.95 * expected


def graded(x):
    return np.where(x[0] < 1.6, 0.25, 1.0)


def test_soft_stiffness_does_not_change_where_newton_ends():
    """Also with hanging nodes, since it is in the tangent only."""
    soft, points = settled(4, 2, size=graded, stabilisation="soft")
    _, others = settled(4, 2, size=graded)
    assert len(points) == len(others) > 150
    assert points["x"] == pytest.approx(others["x"], abs=1e-8)
    assert soft.history[-1].iterations < 30


def test_a_form_of_ones_own_beside_a_ghost_penalty():
    """Springs of each cell hold the body where it is; constants may change between steps."""

    def springs(points, u, v):
        k = fem.Constant(points.grid, 1e12)
        return k * ufl.inner(u, v) * points.dC + mpm.ghost(points, u, v, gamma=1e5)

    _, points = settled(4, 2, size=graded, form=springs)
    assert np.abs(points["x"] - points["x0"]).max() < 1e-6
    _, loose = settled(4, 2, size=graded, form=lambda p, u, v: mpm.ghost(p, u, v, gamma=1e5))
    assert np.abs(loose["x"] - loose["x0"]).max() > 1e-3
