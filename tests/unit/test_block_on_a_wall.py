"""A free block on a rough wall, which friction alone holds."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

h, FRICTION = 0.5, 0.5
STONE = mpm.materials.Hencky(1e7, 0.3)


def tilted(degrees, low=0.0, basis="gimp"):
    """The problem under gravity tilted by an angle, the wall, and the weight (N)."""
    lines = [h * np.arange(-3, 8), h * np.arange(-2, 5)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    points = mpm.fill(grid, mpm.Box((0, low), (2, low + 1)), 2, 2000.0, exact=True)
    V = mpm.Space(grid, basis)
    u, v, angle = V.increment, V.test, np.radians(degrees)
    gravity = fem.Constant(grid, 9.81 * np.array([np.sin(angle), -np.cos(angle)]))
    wall = mpm.Boundary.from_polygon(points, [(-1.4, low), (3.4, low)], closed=False, follows=False)
    F = mpm.momentum(STONE, points, u, v) + mpm.signorini(wall, u, v, law=STONE, friction=FRICTION)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    weight = 2 * 2000 * np.asarray(gravity.value)
    return mpm.QuasiStatic(F, u, points, [], stabilisation="ghost"), wall, weight


@pytest.mark.parametrize(
    ("low", "basis"), [(0.0, "gimp"), (0.3 * h, "gimp"), (0.3 * h, "bspline2")]
)
def test_it_stands_below_the_angle_of_friction(low, basis):
    """A block that touches without pressure had slipped in the first iteration, and had failed."""
    for degrees in (0.0, 10.0, 25.0):
        problem, wall, weight = tilted(degrees, low, basis)
        assert problem.step().halvings == 0
        np.testing.assert_allclose(wall.force(), -weight, atol=1e-6 * np.linalg.norm(weight))


def test_it_slides_above_the_angle_of_friction():
    with pytest.raises(mpm.errors.ConvergenceError):
        tilted(np.degrees(np.arctan(FRICTION)) + 0.5)[0].step()
