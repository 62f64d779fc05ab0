"""A side of the grid that moves from the first explicit step on pushes the body."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import COMM

import dolfinmpm as mpm

E, RHO, SPEED = 1e6, 2000.0, 0.1


def bar(mapping, fused, scheme="musl"):
    grid = mpm.create_lattice(COMM, [np.linspace(0, 0.3, 4), np.linspace(-1, 5, 61)])
    points = mpm.fill(grid, mpm.Box((0, 0), (0.3, 4)), 2, RHO)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E, 0.0), points, V.increment, V.test)
    bcs = mpm.moving(V, lambda x: x[1] < 1e-9, 1, velocity=SPEED)
    bcs += mpm.rollers(V, "left", "right")
    options = {"mapping": mapping, "fused": fused, "scheme": scheme}
    return mpm.Explicit(F, V.increment, points, bcs, **options), points


@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize("mapping", ["flip", pytest.param("apic", marks=pytest.mark.long), "pic"])
def test_momentum_of_the_wave(mapping, fused):
    """The side gives ρ c v per area and time; steps that are taken one by one do not fail."""
    problem, points = bar(mapping, fused)
    c = math.sqrt(E / RHO)
    for k in range(1, 31):
        problem.step(0.004 * k)
    momentum = COMM.allreduce((points["density"] * points["V0"] * points["velocity"][:, 1]).sum())
    assert momentum == pytest.approx(RHO * c * SPEED * 0.3 * problem.time, rel=0.015)
    energies = problem.energies()
    work = RHO * c * SPEED**2 * 0.3 * problem.time
    if mapping != "pic":
        assert energies.external == pytest.approx(work, rel=0.02)
        assert abs(energies["integrator"]) < 0.01 * work
    assert bool(problem.unfused) != fused


# the loops of "apic" take seconds to compile
@pytest.mark.parametrize("scheme", ["musl", "usl", "usf"])
@pytest.mark.parametrize("mapping", ["flip", pytest.param("apic", marks=pytest.mark.long)])
def test_first_step(mapping, scheme):
    """Points beside the side have its velocity after the first step, fused or not."""
    found = []
    for fused in (True, False):
        problem, points = bar(mapping, fused, scheme)
        problem.step(1e-4)
        problem.step(2e-4)
        low = points["velocity"][points["x0"][:, 1] < 0.05, 1]
        assert low.mean() == pytest.approx(0.75 * SPEED, rel=0.01)
        # the impulse gives half of m v² of the nodes
        nodes = 0.5 * (0.5 * RHO * 0.1 * 0.3) * SPEED**2
        assert problem.energies().external == pytest.approx(nodes, rel=0.02)
        order = np.argsort(points["id"])
        found.append((points["velocity"][order], problem.energies().external))
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-12)
    assert found[0][1] == pytest.approx(found[1][1], rel=1e-9)
