"""Points beside a side that is held along its normal stay inside it."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm


def squeezed(basis, bcs, steps=18, stretch=0.9):
    """A block between two walls that come together; it rises, and its domains stay wide."""
    line = np.arange(0.0, 1.1, 0.25)
    grid = mpm.create_lattice(MPI.COMM_WORLD, [line, np.arange(0.0, 8.1, 0.25)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1000.0)
    V = mpm.Space(grid, basis, domains="fixed")
    u, v = V.increment, V.test
    wall = mpm.RigidBody(mpm.Plane((1, 0), (-1, 0)), displacement=lambda t: (stretch**t - 1.0, 0))
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F += mpm.contact(wall, points, u, v, penalty=20.0, corners="material")
    problem = mpm.QuasiStatic(F, u, points, bcs(V), stabilisation="ghost", tolerance=1e-6)
    for _ in range(steps):
        problem.step()
    return points


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_points_do_not_cross_a_held_side(basis):
    """Means over domains had moved the first column through the side."""
    points = squeezed(basis, lambda V: mpm.rollers(V, "left", "bottom"))
    assert points["x"].min() > 0.0
    first = points["x0"][:, 0] < 0.2
    assert points["x"][first, 0].max() < points["x"][~first, 0].max()


def test_points_still_leave_through_a_side_that_is_free():
    with pytest.raises(mpm.errors.PointsOutsideGridError, match="points would leave the grid"):
        squeezed("gimp", lambda V: mpm.rollers(V, "bottom"))
