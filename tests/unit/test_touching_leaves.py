"""Deformable bodies that touch on refined spaces."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


def near_contact(x):
    return np.where(np.abs(x[1] - 1.0) < 0.4, 0.125, 0.5)


def slid(cells, levels, size=None, steps=3, basis="gimp"):
    """A block slides on another one; its problem and points after some steps."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 4, cells + 1)] * 2)
    h = 4 / (cells * 2**levels)
    size = size or (lambda x: np.full(x.shape[1], h))
    refined = {"refine": size, "levels": levels} if levels else {}
    A, B = (mpm.Space(grid, basis, tag=tag, **refined) for tag in (1, 2))
    given = [{"refine": V} if levels else {} for V in (A, B)]
    lower = mpm.fill(grid, mpm.Box((0, 0), (3.5, 1)), 2, 2000.0, tag=1, **given[0])
    upper = mpm.fill(grid, mpm.Box((1, 1), (2.5, 2)), 2, 2000.0, tag=2, **given[1])
    points = lower + upper
    top = mpm.Boundary.from_polygon(points, [(3.5, 1), (0, 1)], closed=False, spacing=h / 2)
    bottom = mpm.Boundary.from_polygon(points, [(1, 1), (2.5, 1)], closed=False, spacing=h / 2)
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.contact_between(
        (bottom, top), (B.increment, A.increment), (B.test, A.test), friction=0.3
    )
    for tag, V in ((1, A), (2, B)):
        law = mpm.materials.Hencky(1e6, 0.3)
        F += mpm.momentum(law, points, V.increment, V.test, tag=tag)
        F -= ufl.inner(points.density * g, V.test) * points.dX
    problem = mpm.QuasiStatic(
        F, [A.increment, B.increment], points, mpm.fixed(A, "bottom"),
        stabilisation=["ghost", "ghost"], tolerance=1e-10,
    )  # fmt: skip
    for k in range(steps):
        g.value[:] = 2.0 * k, -10.0 * (k + 1)
        problem.step()
    return problem, points, bottom


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_equal_leaves_touch_as_the_cells_of_a_grid(basis):
    on_grid, points, _ = slid(16, 0, basis=basis)
    on_leaves, others, _ = slid(8, 1, basis=basis)
    assert on_leaves.history[-1].unknowns == on_grid.history[-1].unknowns
    order, other = (np.lexsort(p["x0"].T.round(9)) for p in (points, others))
    assert others["x"][other] == pytest.approx(points["x"][order], abs=1e-8)
    assert np.abs(points["x"] - points["x0"]).max() > 0.01


def test_small_leaves_along_the_contact_carry_the_weight():
    """The pressure of contact balances the weight of the upper block, across hanging nodes."""
    problem, points, bottom = slid(8, 2, near_contact)
    upper = points["tag"] == 2
    weight = 30.0 * float((points["density"] * points["V0"])[upper].sum())
    (force,) = [n for n in bottom.markers.fields if n.endswith("normal_force")]
    assert bottom.markers[force].sum() == pytest.approx(weight, rel=2e-2)
    assert problem.history[-1].iterations < 8
