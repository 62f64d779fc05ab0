"""Strength of clay that does not drain: Modified Cam-Clay with water in its pores, k = 0.

At constant volume swelling makes up for compression, κ ln(p/p0) = −(λ − κ) ln(pc/pc0), until the
critical state, pc = 2p. So p = p0 (R/2)^Λ there, with R = pc0/p0 and Λ = 1 − κ/λ, whatever the
way to it (Wood 1990, "Soil behaviour and critical state soil mechanics", §7.2), and
c_u = M p/2 in triaxial compression, M p/√3 in plane strain.
"""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

P0, M, SWELLING, COMPRESSION = 1e5, 1.05, 0.02, 0.1


@pytest.mark.parametrize(("rings", "R"), [(True, 1.2), (False, 1.0), (False, 4.0)])
def test_clay_fails_at_the_critical_state_of_its_volume(rings, R):
    """A block between smooth plates whose side is free: suction holds it together at first."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (1, 1)], (2, 2), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 2000.0, axisymmetric=rings)
    soil = mpm.materials.CamClay(SWELLING, COMPRESSION, M, 8e6, 0.0, P0, R * P0)
    V = mpm.Space(grid, "linear", configuration="total")
    Q = mpm.Space(grid, "linear", shape=(), configuration="total")
    F = mpm.poromechanics(
        soil, points, (V.increment, Q.increment), (V.test, Q.test), permeability=0.0,
        porosity=0.5, modulus=1e7,
    )  # fmt: skip
    # plates come closer by 1 % of their distance in every step
    plate = fem.Constant(grid, 0.0)
    bcs = mpm.rollers(V, "left", "bottom") + mpm.prescribed(V, "top", 1, plate)
    problem = mpm.QuasiStatic(F, [V.increment, Q.increment], points, bcs)
    for k in range(25):
        plate.value = -0.01 * 0.99**k
        problem.step()
    np.testing.assert_allclose(np.linalg.det(points["F"]), 1.0, atol=1e-7)
    p = -np.trace(points["stress"], axis1=1, axis2=2) / 3
    expected = P0 * (R / 2) ** (1 - SWELLING / COMPRESSION)
    np.testing.assert_allclose(p, expected, rtol=1e-3)
    np.testing.assert_allclose(points["preconsolidation_pressure"], 2 * expected, rtol=1e-3)
    strength = 0.5 * (points["stress"][:, 0, 0] - points["stress"][:, 1, 1])
    c_u = M * expected * (0.5 if rings else 1 / np.sqrt(3))
    np.testing.assert_allclose(strength, c_u, rtol=1e-3)
    # the side is free: water and soil together carry nothing across it
    total = points["stress"][:, 0, 0] - points["pressure"]
    assert np.abs(total).max() < 1e-5 * P0
