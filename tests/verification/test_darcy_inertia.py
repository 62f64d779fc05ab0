"""Darcy's law with the soil's acceleration, against the modes of a column and damped waves."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from dolfinx import fem
from scipy import linalg
from test_poroelastic_waves import DENSITY, LENGTH, POROSITY, M, column, settlement, sinking

import dolfinmpm as mpm

WATER, BULK = 1000.0, 8e5
NUMBER = 0.5 * math.pi / LENGTH
OMEGA = NUMBER * math.sqrt(M / DENSITY)


def swinging(share, steps, rule=mpm.Newmark, end=2.0, inertia=True, **options):
    """A column, drained at its top and begun with sin(πy/2L), at `end` radians of the dry one.

    Returns:
        Amplitudes of displacement, velocity and pressure after each step, and the exact ones.
    """
    water = mpm.Fluid(density=WATER, gravity=9.81, bulk_modulus=BULK)
    k = water.unit_weight / (DENSITY * share * OMEGA)
    of_form = {"theta": 0.5, **options.pop("of_form", {})}
    F, points, fields, _, _, bcs = column(
        permeability=k, fluid=water, open_top=True, inertia=inertia, **of_form
    )
    problem = rule(F, fields, points, bcs, stabilisation=["ghost", "ghost"], **options)
    sine, cosine = (f(NUMBER * points["x0"][:, 1]) for f in (np.sin, np.cos))
    points["velocity"][:, 1] = 1e-4 * sine
    times, found = [], []
    for t in mpm.times(end / OMEGA, dt=end / OMEGA / steps):
        problem.step(t)
        moved = (points["x"] - points["x0"])[:, 1]
        both = sine * moved, sine * points["velocity"][:, 1], cosine * points["pressure"]
        found.append(2 * np.mean(both, axis=1))
        times.append(problem.time)
    return np.array(found), exact(times, k / water.unit_weight, inertia)


def exact(times, K, inertia):
    """u = U sin κy, p = P cos κy: ρU″ = −Mκ²U + κP, SP′ = −Kκ²P − κU′ + Kρ_wκU″ where the water
    is accelerated; three modes, whose s are roots of a cubic."""
    rate = np.zeros((3, 3))
    rate[0, 1] = 1.0
    rate[1] = -M * NUMBER**2 / DENSITY, 0.0, NUMBER / DENSITY
    rate[2] = 0.0, -NUMBER, -K * NUMBER**2
    if inertia:
        rate[2] += K * WATER * NUMBER * rate[1]
    rate[2] *= BULK / POROSITY
    return np.array([linalg.expm(t * rate) @ (0.0, 1e-4, 0.0) for t in times])


def error(found, expected):
    """Largest errors by the largest values."""
    return np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)


def orders(runs):
    """Orders of steps halved from run to run, by what changes over all times in common."""
    common = [run[len(run) // len(runs[0]) - 1 :: len(run) // len(runs[0])] for run in runs]
    changes = [np.linalg.norm(a - b, axis=0) for a, b in itertools.pairwise(common)]
    return [np.log2(before / after) for before, after in itertools.pairwise(changes)]


@pytest.mark.parametrize(
    "share", [1.0, *(pytest.param(s, marks=pytest.mark.long) for s in (0.2, 5.0))]
)
def test_a_column_swings_with_its_water(share):
    """Dragged by a share of the dry column's frequency; without inertia it is another curve."""
    found, expected = swinging(share, 60)
    assert error(found, expected).max() < 1e-3
    other = exact(np.arange(1, 61) / 30 / OMEGA, 1 / (DENSITY * share * OMEGA), False)
    assert error(other, expected).max() > 0.05


@pytest.mark.long
@pytest.mark.parametrize("share", [0.2, 5.0])
def test_crank_and_nicolson_is_of_second_order(share):
    runs = [swinging(share, steps)[0] for steps in (10, 20, 40, 80)]
    for order in orders(runs):
        np.testing.assert_allclose(order, 2.0, atol=0.2)


@pytest.mark.long
@pytest.mark.parametrize("inertia", [False, True])
@pytest.mark.parametrize("rho_inf", [1.0, 0.8, 0.3])
def test_generalised_alpha_is_of_second_order_in_both_fields(rho_inf, inertia):
    runs, last = [], None
    for steps in (20, 40, 80):
        last = swinging(
            1.0, steps, mpm.GeneralisedAlpha, inertia=inertia, rho_inf=rho_inf,
            of_form={"theta": 1.0, "rho_inf": rho_inf},
        )  # fmt: skip
        runs.append(last[0])
    assert error(*last).max() < 1e-3
    for order in orders(runs):
        np.testing.assert_allclose(order, 2.0, atol=0.15)


@pytest.mark.long
@pytest.mark.parametrize("share", [0.5, 5.0])
def test_incompressible_water_takes_its_mass_from_the_waves(share):
    """Over a sealed base w = −u′, so that (ρ − ρ_w) u″ + γ_w/k u′ = M u_yy: with ρ_w = ρ/2 waves
    are faster by √2."""
    first = NUMBER * math.sqrt(M / (DENSITY - WATER))
    water, load = mpm.Fluid(density=WATER, gravity=9.81), 1e3
    damping = share * first
    k = water.unit_weight / ((DENSITY - WATER) * damping)
    F, points, fields, V, top, bcs = column(
        permeability=k, fluid=water, open_top=True, inertia=True
    )
    F += top.traction(fem.Constant(points.grid, (0.0, -load)), V.test)
    problem = mpm.Newmark(F, fields, points, bcs, stabilisation=["ghost", "ghost"])
    times, found = sinking(problem, top, first, load)
    off = np.abs(found - settlement(times, damping, DENSITY - WATER))
    assert off.max() < 0.03
    assert np.sqrt(np.mean(off**2)) < 0.01
