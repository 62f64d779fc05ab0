"""Bodies that move past boundaries which stay in space."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem

import dolfinmpm as mpm


@pytest.mark.parametrize(
    ("basis", "stabilisation"), [("bspline2", "aggregation"), ("bspline2", "ghost")]
)
def test_nitsches_constants_follow_a_body_along_a_wall(basis, stabilisation):
    """A heavy block is pulled along a smooth wall: the wall bears its weight, and nothing rubs.

    The wall stays where it is. Its cells have another part of the block in them after each step.
    """
    h, y0, weight = 0.125, 0.046, 1e4
    grid = mpm.create_lattice(COMM, [np.arange(-1, 15) * h, np.arange(-1, 11) * h])
    points = mpm.fill(grid, mpm.Box((0.013, y0), (1.013, 1 + y0)), 3, 1000.0, aligned="body")
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(2e6, 0.3)
    ends = [(0.013, 1 + y0), (0.013, y0)]
    end = mpm.Boundary.from_polygon(points, ends, closed=False)
    ends = [(-0.05, y0), (1.7, y0)]
    wall = mpm.Boundary.from_polygon(points, ends, closed=False, follows=False)
    way = fem.Constant(grid, 0.0)
    F = mpm.momentum(law, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), v) * points.dX
    F += mpm.dirichlet(end, u, v, way, law=law, direction=(1, 0), method="penalty")
    F += mpm.dirichlet(wall, u, v, law=law, direction="normal")
    problem = mpm.QuasiStatic(F, u, points, stabilisation=stabilisation)
    for k in range(24):
        way.value = 0.02 * (k + 1)
        problem.step()
        np.testing.assert_allclose(wall.force(), (0.0, weight), atol=1e-6 * weight)
        np.testing.assert_allclose(end.force(), 0.0, atol=1e-6 * weight)
        exact = -weight * (1 + y0 - points["x"][:, 1])
        error = points["stress"][:, 1, 1] - exact
        # beside faces sums over points are not exact in splines
        assert np.sqrt(np.mean(error**2)) < 0.08 * weight
