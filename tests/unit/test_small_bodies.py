"""Bodies that fill no cell well have roots of their own, so that their consistent mass is sound."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

BARS = {
    "bspline2": 0.1 * np.array([(2.6, 3.1), (3.6, 2.1), (7.8, 6.3), (6.8, 7.3)]),
    "bspline3": np.array([(0.8351, 0.5107), (0.7092, 0.6641), (0.2827, 0.3138), (0.4087, 0.1604)]),
}


@pytest.mark.parametrize("basis", list(BARS))
@pytest.mark.parametrize("beside", [False, True])
def test_a_turned_bar_flies_freely(basis, beside):
    """A bar of a cell and a half or two cells, alone or far from a body of many cells."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (3, 1)], (30, 10), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Polygon(BARS[basis]), 3, 1000.0)
    if beside:
        points = points + mpm.fill(grid, mpm.Box((1.8, 0.2), (2.6, 0.8)), 2, 1000.0)
    points.add_field("velocity", (2,), "m/s")
    points["velocity"][:] = 0.3, 0.1
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    problem = mpm.Newmark(F, V.increment, points, stabilisation="ghost")
    for k in range(1, 6):
        problem.step(0.02 * k)
    assert points["velocity"] == pytest.approx(np.tile([0.3, 0.1], (len(points), 1)), abs=1e-6)
    assert points["x"] - points["x0"] == pytest.approx(0.1 * points["velocity"], abs=1e-6)
