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
from dolfinx import mesh
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
    clay = mpm.materials.CamClay(SWELLING, COMPRESSION, M, 2e7, 0.0, P0, ratio * P0)
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
@pytest.mark.parametrize(("axisymmetric", "fbar"), [(True, False), (True, True), (False, True)])
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
