"""NorSand in a boundary value problem: a plate is pressed into sand in a box."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm

P, SIZE, PLATE = 100e3, 4.0, 1.6
LAW = {
    "swelling": 0.005, "mu0": 20e6, "alpha": 0.0, "reference_pressure": P, "M": 1.25, "N": 0.2,
    "chi": 3.5, "hardening": 150.0, "critical_void_ratio": 0.82, "critical_slope": 0.03,
    "image_pressure": 50e3,
}  # fmt: skip


def on_plate(x):
    return (x[1] > SIZE - 1e-6) & (x[0] < PLATE)


def beside(x):
    return (x[1] > SIZE - 1e-6) & (x[0] > PLATE)


def box(void_ratio):
    law = mpm.materials.NorSand(**LAW, void_ratio=void_ratio)
    lines = np.linspace(0.0, SIZE, 9)
    grid = mpm.create_lattice(MPI.COMM_WORLD, [lines, lines])
    points = mpm.fill(grid, mpm.Box((0, 0), (SIZE, SIZE)), per_cell=2, density=2000.0)
    mpm.set_stress(law, points, -P * np.eye(3))
    V = mpm.Space(grid, "gimp")
    sides = mpm.rollers(V, "left", "right", "bottom") + mpm.prescribed(V, beside, 1)
    return points, V, sides, mpm.momentum(law, points, V.increment, V.test)


def figures(points):
    """Mean pressure and shear stress (Pa), and change of the mean void ratio."""
    V, stress = points["V"], points["stress"]
    q = np.sqrt(1.5) * np.linalg.norm(
        stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3), axis=(1, 2)
    )
    p = -np.trace(stress, axis1=1, axis2=2) / 3
    return np.array([p @ V, q @ V, points["void_ratio"] @ points["V0"]]) / SIZE**2


@pytest.mark.parametrize("void_ratio", [0.6, 0.75])
def test_a_plate_in_implicit_and_explicit_steps(void_ratio):
    points, V, sides, F = box(void_ratio)
    down = mpm.prescribed(V, on_plate, 1, increment=-0.004)
    problem = mpm.QuasiStatic(F, V.increment, points, sides + down)
    for _ in range(10):
        record = problem.step()
        # Newton's method with the consistent tangent
        last = np.array(record.residuals[-3:])
        assert record.iterations <= 8
        assert last[2] < 1e-8 or last[2] < 10 * last[1] ** 1.7
    implicit = figures(points)
    yielded = points["image_pressure"] != LAW["image_pressure"]
    assert yielded.mean() > 0.5

    points, V, sides, F = box(void_ratio)
    down = mpm.moving(V, on_plate, 1, velocity=-0.2)
    problem = mpm.Explicit(F, V.increment, points, sides + down, damping=0.5)
    problem.step(0.2)
    explicit = figures(points)
    assert explicit[:2] == pytest.approx(implicit[:2], rel=0.02)
    assert explicit[2] - void_ratio == pytest.approx(implicit[2] - void_ratio, rel=0.05)
    assert not problem.unfused
