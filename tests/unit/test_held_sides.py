"""Points beside a side that is held along its normal stay inside it."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.kinematics.heldsides import held_sides, inside_sides


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


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_clay_that_runs_against_a_wall(basis):
    """Explicit steps had ended as the first points reached the wall."""
    h = 0.05
    lines = [np.arange(0.0, 1.01, h), np.arange(0.0, 1.51, h)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    points = mpm.fill(grid, mpm.Box((0, 0), (0.4, 0.8)), 2, 1000.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    clay = mpm.materials.VonMises(1e6, 0.3, yield_stress=1e3)
    F = mpm.momentum(clay, points, u, v) + 9.81 * points.density * v[1] * points.dX
    problem = mpm.Explicit(F, u, points, mpm.rollers(V, "left", "right", "bottom"))
    for t in mpm.times(0.6, dt=0.1):
        problem.step(t)
    x = points["x"]
    assert x[:, 0].max() > 0.99
    assert np.all((x > 0.0) & (x < (1.0, 1.5)))


def test_a_wall_that_comes_nearer_or_is_held_in_part_does_not_count():
    fixed, values = np.ones((4, 2), bool), np.zeros((4, 2))
    values[1, 0] = 0.1
    fixed[3, 1] = False
    sides = [[np.array([0, 1]), np.array([2, 3])], [np.array([0, 2]), np.array([1, 3])]]
    held = held_sides(fixed, values, sides)
    np.testing.assert_array_equal(held, [[False, True], [True, False]])


def test_a_point_that_would_cross_a_side_comes_nearer():
    held = np.array([[True, False]])
    assert inside_sides(held, 0, 0.0, 1.0, 0.5, 0.1, -0.2) == -0.2
    assert inside_sides(held, 0, 0.0, 1.0, 0.9, 0.1, 0.2) == 0.2
    # a mean of -0.02 up to 0.11 is -0.02/0.055 times the distance
    near = 0.01 + inside_sides(held, 0, 0.0, 1.0, 0.01, 0.1, -0.02)
    assert near == pytest.approx(0.01 * (1.0 - 0.02 / 0.055))
