"""Contact of bodies of revolution with rigid ones against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI
from scipy.optimize import brentq

import dolfinmpm as mpm

RADIUS, HEIGHT, MODULUS = 0.6, 0.8, 1e6  # m, Pa


@pytest.mark.parametrize(
    ("nu", "kappa", "corners", "steps"),
    [
        (0.3, 3e7, "domains", 1),
        (0.3, 3e7, "material", 1),
        (0.49, 1e8, "material", 1),
        (0.0, 1e8, "domains", 4),
    ],
)
def test_a_plate_on_a_cylinder(nu, kappa, corners, steps):
    """Uniaxial stress: τ = E ln λ with E ln λ/λ + κ (λH − z) = 0, all radii grow by λ^(−ν).

    Points that have spread across the grid's lines would see the pressure on their corners as a
    sum of two values on both sides of a kink, and bend a little.
    """
    n, down = 3, 0.04 / steps
    h = HEIGHT / 4
    cells = mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (5 * h, 5 * h)], (5, 5), cells)
    body = mpm.Box((0, 0), (n * h, HEIGHT))
    points = mpm.fill(grid, body, 2, 1000.0, axisymmetric=True)
    assert points.shape_volume == pytest.approx(math.pi * RADIUS**2 * HEIGHT)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    plate = mpm.RigidBody(mpm.Plane((0, HEIGHT), (0, -1)), increment=(0, -down), name="plate")
    F = mpm.momentum(mpm.materials.Hencky(E=MODULUS, nu=nu), points, u, v)
    F += mpm.contact(plate, points, u, v, stiffness_per_area=kappa, corners=corners)
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "bottom"), tolerance=1e-11)
    stretch, area = 1.0, math.pi * RADIUS**2
    for k in range(steps):
        record = problem.step()
        z = HEIGHT - (k + 1) * down
        balance = lambda s: MODULUS * math.log(s) / s + kappa * (s * HEIGHT - z)  # noqa: B023, E731
        stretch = brentq(balance, 0.5, 1.0, xtol=1e-15, rtol=1e-14)
        force = -MODULUS * math.log(stretch) / stretch * area
        assert plate.force[1] == pytest.approx(force, rel=1e-8)
        assert plate.force[0] == plate.moment[0] == 0.0
        assert record.bodies["plate"]["force"][1] == plate.force[1]
        assert record.iterations <= 8
    across = stretch**-nu
    exact = np.diag([across, stretch, across])
    np.testing.assert_allclose(points["F"], np.broadcast_to(exact, points["F"].shape), atol=1e-9)
    np.testing.assert_allclose(points["x"], points["x0"] * [across, stretch], rtol=1e-9)
    stress = MODULUS * math.log(stretch) / np.linalg.det(exact) * np.diag([0.0, 1.0, 0.0])
    apart = np.abs(points["stress"] - stress).max()
    assert apart < 1e-9 * MODULUS
