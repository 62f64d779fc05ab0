"""Domains beside the axis of revolution that reach beyond it."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm


def pressed(basis, leaves):
    """A cone is pressed into a block in cells of 0.25 m: displacements and the force."""
    size = 0.5 if leaves else 0.25
    lines = [np.arange(0.0, top + size / 2, size) for top in (2.0, 2.0)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    fine = {"refine": lambda x: np.full(x.shape[1], 0.25), "levels": 1} if leaves else {}
    V = mpm.Space(grid, basis, **fine)
    block = mpm.Box((0, 0), (1.5, 1.15))
    points = mpm.fill(grid, block, 2, 1.0, axisymmetric=True, refine=V if leaves else None)
    corners = [(-0.4, 1.6), (0, 1.12), (0.4, 1.6), (0.4, 2.0), (-0.4, 2.0)]
    cone = mpm.RigidBody(mpm.Polygon(corners), increment=(0, -0.03))
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F += mpm.contact(cone, points, u, v)
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "bottom"))
    for _ in range(3):
        problem.step()
    assert np.any(points["x"][:, 0] < points["l"][:, 0] - 1e-6)
    order = np.lexsort(np.round(points["x0"], 6).T)
    return (points["x"] - points["x0"])[order], cone.force[1]


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_leaves_of_one_size_are_the_finer_grid(basis):
    """A corner beyond the axis had taken functions of leaves, continued; forces were off by 1 %."""
    (way, force), (expected, of_grid) = pressed(basis, True), pressed(basis, False)
    assert force == pytest.approx(of_grid, rel=1e-8)
    np.testing.assert_allclose(way, expected, atol=1e-8 * np.abs(expected).max())
