"""Unconfined compression of saturated Cam-Clay by a rigid plate: effective stresses find c_u.

No water leaves, so the volume stays, and elastic and plastic volume strains cancel. The critical
state is then at |p'| = p0 (R/2)^Λ with R = pc/p0 and Λ = 1 − κ̂/λ̂, and q = M |p'| there; in plane
strain c_u = q/√3 (Wood 1990, "Soil behaviour and critical state soil mechanics", ch. 7).
Suction holds the grains together at first.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

SWELLING, COMPRESSION, M, P0 = 0.018, 0.13, 1.05, 1e5
HEIGHT, RADIUS, CELL = 0.8, 0.4, 0.2


def compressed(ratio, axisymmetric, fbar=False, strain=0.11, steps=11):
    """Axial total stress by the plate's force (Pa, positive in compression), and the points."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (3 * CELL, HEIGHT + CELL)], (3, 5), mesh.CellType.quadrilateral
    )
    block = mpm.Box((0, 0), (RADIUS, HEIGHT))
    points = mpm.fill(grid, block, 2, 2000.0, axisymmetric=axisymmetric)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    clay = mpm.materials.CamClay(
        swelling=SWELLING,
        compression=COMPRESSION,
        M=M,
        mu0=2e7,
        alpha=0.0,
        reference_pressure=P0,
        preconsolidation=ratio * P0,
    )
    plate = mpm.RigidBody(
        mpm.Plane((0, HEIGHT), (0, -1)), velocity=(0, -strain * HEIGHT / steps), name="plate"
    )
    F = mpm.poromechanics(
        clay, points, fields, tests, permeability=0.0, porosity=0.5, modulus=5e7, fbar=fbar
    )
    F += mpm.contact(plate, points, V.increment, V.test, stiffness_per_area=1e11)
    bcs = mpm.rollers(V, "left", "bottom")
    problem = mpm.Transient(F, list(fields), points, bcs, stabilisation=["ghost", "ghost"])
    points["pressure"] = -P0
    for k in range(steps):
        problem.step(k + 1.0)
    volume = points["V"].sum() / (2 * math.pi if axisymmetric else 1.0)
    height = HEIGHT * (1 - strain)
    area = volume / height * (2 * math.pi if axisymmetric else 1.0)
    return plate.force[1] / area, points


@pytest.mark.parametrize("ratio", [1.0, 4.0])
@pytest.mark.parametrize(
    ("axisymmetric", "fbar"),
    [(True, True), pytest.param(True, False, marks=pytest.mark.long), (False, True)],
)
def test_undrained_strength(ratio, axisymmetric, fbar):
    stress, points = compressed(ratio, axisymmetric, fbar)
    p = P0 * (ratio / 2) ** (1 - SWELLING / COMPRESSION)
    c_u = M * p / (2 if axisymmetric else math.sqrt(3))
    assert stress / 2 == pytest.approx(c_u, rel=1e-3)
    effective = -np.trace(points["stress"], axis1=1, axis2=2) / 3
    np.testing.assert_allclose(effective, p, rtol=3e-3)
    # nothing leaves
    J = np.linalg.det(points["F"])
    np.testing.assert_allclose(J, 1.0, atol=2e-3)


@pytest.mark.parametrize(("rings", "R"), [(True, 1.2), (False, 1.0), (False, 4.0)])
def test_clay_fails_at_the_critical_state_of_its_volume(rings, R):
    """A block in total Lagrangian steps, between smooth plates that nodes are."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (1, 1)], (2, 2), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 2000.0, axisymmetric=rings)
    soil = mpm.materials.CamClay(
        swelling=SWELLING,
        compression=COMPRESSION,
        M=M,
        mu0=2e7,
        alpha=0.0,
        reference_pressure=P0,
        preconsolidation=R * P0,
    )
    V = mpm.Space(grid, "linear", configuration="total")
    Q = mpm.Space(grid, "linear", shape=(), configuration="total")
    F = mpm.poromechanics(
        soil, points, (V.increment, Q.increment), (V.test, Q.test), permeability=0.0,
        porosity=0.5, modulus=1e7,
    )  # fmt: skip
    # plates come closer by 1 % of their distance in every step
    plate = fem.Constant(grid, 0.0)
    bcs = mpm.rollers(V, "left", "bottom") + mpm.prescribed(V, "top", 1, increment=plate)
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
