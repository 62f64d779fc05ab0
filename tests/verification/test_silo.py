"""Ground in a silo hangs on its rough walls (Janssen 1895, Z. Ver. Dtsch. Ing. 39, 1045-1049)."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

B, HEIGHT, FRICTION, NU, GAMMA = 1.0, 4.0, 0.3, 0.3, 20e3


@pytest.mark.parametrize(
    ("basis", "apart"), [("gimp", 0.0), ("gimp", 0.37), ("bspline2", 0.0), ("linear", 0.37)]
)
def test_vertical_stress_between_rough_walls(basis, apart):
    """σ = γB/(2μK) (1 − exp(−2μKz/B)) with K = ν/(1−ν), where all markers slip.

    Janssen's horizontal stress is the same over the width, which is an error of about 1 % here.
    """
    h = B / 16
    low = apart * h
    lines = [h * np.arange(-2, 19), h * np.arange(1, 66)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    points = mpm.fill(grid, mpm.Box((low, h), (low + B, HEIGHT)), 2, 2000.0, exact=True)
    V, law = mpm.Space(grid, basis), mpm.materials.Hencky(1e8, NU)
    u, v = V.increment, V.test
    gravity, down = fem.Constant(grid, (0.0, 0.0)), fem.Constant(grid, -2e-4)
    F = mpm.momentum(law, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
    top, walls = HEIGHT + h, []
    for ends in ([(low, top), (low, h)], [(low + B, h), (low + B, top)]):
        walls.append(mpm.Boundary.from_polygon(points, ends, closed=False, follows=False))
        F += mpm.signorini(walls[-1], u, v, law=law, friction=FRICTION)
    floor = mpm.prescribed(V, "bottom", 1, increment=down)
    problem = mpm.QuasiStatic(F, u, points, floor, stabilisation="ghost")
    for k in range(10):
        gravity.value[1] = -(k + 1.0)
        record = problem.step()
        assert record.iterations <= 15
        assert record.halvings == 0
    x, V_p, stress = points["x"], points["V"], points["stress"]
    slope = 2 * FRICTION * NU / (1 - NU) / B
    for z in (1.0, 2.0, 2.5):
        band = np.abs(HEIGHT - z - x[:, 1]) < 0.6 * h
        found = -(V_p * stress[:, 1, 1])[band].sum() / V_p[band].sum()
        assert found == pytest.approx(GAMMA / slope * (1 - np.exp(-slope * z)), rel=0.015)
    left, right = (wall.force() for wall in walls)
    np.testing.assert_allclose(left, [-right[0], right[1]], rtol=1e-3)
    assert left[1] == pytest.approx(FRICTION * left[0], rel=1e-6)
