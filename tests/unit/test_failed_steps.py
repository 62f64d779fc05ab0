"""What a step that fails advises: pieces of the body that hang free, and scenes far away."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError


def block_of(shape, first=(0.0, 0.0), disc=None):
    """Points of a shape with weight, on a grid of cells of 0.5 m, and their problem."""
    lines = [a + np.arange(0.0, b + 0.5, 0.5) for a, b in zip(first, (3, 3))]
    grid = mpm.create_lattice(COMM, lines)
    points = mpm.fill(grid, shape, 2, 1800.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(2e6, 0.3), points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), v) * points.dX
    if disc is not None:
        F += mpm.contact(disc, points, u, v, friction=0.3)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return grid, points, mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", max_halvings=1)


def test_a_piece_that_hangs_free_is_named():
    """A block that was added above the ground had been a point turned inside out."""
    grid, points, problem = block_of(mpm.Box((0, 0), (3, 1)))
    problem.step()
    points.add(mpm.fill(grid, mpm.Box((1, 2), (2, 3)), 2, 1800.0))
    message = r"2 pieces that share no nodes.* along x, along y, 1 with a turn .*\[1\.5 +2\.5 *\] m"
    with pytest.raises(ConvergenceError, match=message):
        problem.step()


@pytest.mark.parametrize("first", [(0.0, 0.0), (5e6, 4.5e6)])
def test_contact_far_from_the_origin_cannot_balance_to_every_tolerance(first):
    x, y = first
    disc = mpm.RigidBody(mpm.Disc((x + 1.0, y + 2.49), 0.5), increment=(0.0, -0.02))
    _, _, problem = block_of(mpm.Box(first, (x + 3, y + 2)), first, disc)
    problem.tolerance = 1e-10
    if x == 0.0:
        assert problem.step().halvings == 0
        return
    with pytest.raises(ConvergenceError, match=r"5e\+06 m from the origin, .* subtract an origin"):
        problem.step()
