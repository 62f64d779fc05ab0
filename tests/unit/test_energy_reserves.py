"""What bounds energy that nothing has brought: of penalties, of steps, of explicit contact."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.contact.contactlaw import explicit_reduction
from dolfinmpm.contact.meanforces import bounding_multipliers, normal_energy
from dolfinmpm.dynamics.energybounds import EnergyGain, PenaltyEnergy
from dolfinmpm.dynamics.worksums import Work


def begun(energy, stiffness, V):
    """A reserve of so much energy at the start of a step of 2 s, with Φ(v) = stiffness v·v."""
    reserve = PenaltyEnergy()
    reserve.energy[0] = energy
    mass = SimpleNamespace(inner=lambda v, blocks, w: stiffness * float(np.sum(v * w)))
    here = SimpleNamespace(blocks_of=lambda kind, k: [kind, k])
    reserve.begin(here, [(0, mass, V)], 2.0, 1.0)
    return reserve


@pytest.mark.parametrize("energy", [0.0, 0.3, 2.0])
def test_a_penalty_gives_back_no_more_than_it_has_taken(energy):
    V, K = np.array([[0.6, -0.8]]), 1.5
    reserve = begun(energy, K, V)
    assert reserve.share[0] == pytest.approx(min(1.0, np.sqrt(energy / K)))
    # the increment that it gives most for
    for u in (reserve.share[0] * V, 2 * V, -V):
        given = -K * float(np.sum(u * (u - 2 * reserve.share[0] * V)))
        assert given <= energy + 1e-12


def test_a_reserve_of_rounding_is_none():
    assert begun(-1e-20, 1.0, np.zeros((1, 2))).share[0] == 1.0
    assert begun(-1e-20, 1.0, np.ones((1, 2))).share[0] == 0.0


def test_fields_have_reserves_of_their_own():
    reserve, V = PenaltyEnergy(), np.ones((1, 2))
    reserve.energy[0] = 0.5
    mass = SimpleNamespace(inner=lambda v, blocks, w: float(np.sum(v * w)))
    here = SimpleNamespace(blocks_of=lambda kind, k: [kind, k])
    reserve.begin(here, [(0, mass, V), (1, mass, V)], 2.0, 1.0)
    assert reserve.share[0] == pytest.approx(0.5)
    assert reserve.share[1] == 0.0


def test_a_step_that_makes_energy_is_parted():
    gains, works = EnergyGain(), [Work(internal=x) for x in (0.3, -0.2, 0.3)]
    assert "makes 0.3 J" in gains.judge(works[0], 0.0, 100.0, True)
    assert gains.made == 0.0
    # one that may not be parted counts, and one that loses is always taken
    assert gains.judge(works[0], 0.0, 100.0, False) is None
    assert gains.judge(works[1], 0.0, 100.0, True) is None
    assert gains.made == pytest.approx(0.1)
    # what contact does is no gain
    assert gains.judge(works[2], 0.3, 100.0, True) is None


@pytest.mark.parametrize("spare", [0.0, 0.4, 1e3])
def test_places_start_with_no_more_than_they_had(spare):
    k, q = np.array([2.0, 3.0, 4.0]), np.array([1.0, -5.0, 4.0])
    stored = normal_energy(q, k)
    assert stored == pytest.approx([0.25, 0.0, 2.0])
    held = bounding_multipliers(q, stored.sum(), 0.0, 1.5 + spare, MPI.COMM_SELF)
    started = normal_energy(q + held, k).sum()
    assert started == pytest.approx(min(2.25, 1.5 + spare))
    assert held[1] == 0.0


def bounced(dt, offset, corrects):
    """Energy kept by a mass of 1 kg that leapfrogs against a penalty of 1 N/m at 1 m/s."""
    x, v, last = 3.0 * dt + offset * dt, -1.0, 0.0
    while x > 0.0 or v < 0.0 or last > 0.0:
        p = max(-x, 0.0)
        last = p
        if corrects:
            p -= float(explicit_reduction(np.array([x]), np.array([-v * dt]), np.array([p]))[0])
        v += dt * p
        x += dt * v
        if x > 4.0 * dt and v > 0.0:
            break
    return v * v


def test_explicit_contact_that_begins_within_a_step_keeps_energy():
    """Wherever in a step it begins: without the share of time inside some is made or lost."""
    errors = {}
    for corrects in (False, True):
        found = [bounced(0.2, offset, corrects) for offset in np.linspace(0.0, 1.0, 11)]
        errors[corrects] = max(abs(one - 1.0) for one in found)
    assert errors[True] < 0.3 * errors[False]


def test_a_rigid_body_placed_inside_points_brings_energy():
    """Energy of an initial overlap is work done from outside, and not energy from nothing."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(7), range(5)])
    points = mpm.fill(grid, mpm.Box((3, 1), (5, 3)), per_cell=2, density=1000.0)
    points.add_field("velocity", (2,), "m/s")
    V = mpm.Space(grid, "linear")
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    body = mpm.RigidBody(mpm.Box((1, 1.2), (3.01, 2.8)), mass=2e3, inertia=1e3, name="body")
    F += mpm.contact(body, points, V.increment, V.test)
    problem = mpm.Newmark(F, V.increment, points)
    assert problem.energies().initial == 0.0
    problem.step(0.01)
    e = problem.energies()
    # corners on 1.5 m of the side of 2 m are inside by 0.01 m, under 5 E/h
    assert e.external == pytest.approx(0.5 * 5e6 * 1.5 * 0.01**2)
    assert e.kinetic + e.bodies > 0.1 * e.external
    assert abs(e["integrator"]) < 0.02 * e.external
    problem.step(0.02)
    assert problem.energies().external == e.external
