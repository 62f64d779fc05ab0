"""Kernels without a tangent: the same stress, state and strain, and nothing written beside them."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinmpm.materials import (
    CamClay,
    DruckerPrager,
    Hencky,
    MohrCoulomb,
    NorSand,
    Tresca,
    VonMises,
)
from dolfinmpm.materials.base import ELASTIC, Law
from dolfinmpm.materials.lawkernel import law_kernel, respond_at_points

LAWS = [
    Hencky(E=1e5, nu=0.3),
    VonMises(E=1e5, nu=0.3, radius=50.0, saturation=80.0, rate=10.0),
    Tresca(1e5, 0.3, 60.0),
    MohrCoulomb(1e5, 0.3, 20.0, 25.0, dilation_angle=5.0, residual_cohesion=10.0, rate=5.0),
    DruckerPrager(1e5, 0.3, 20.0, 25.0, dilation_angle=0.0, fit="plane strain"),
    CamClay(
        swelling=0.018,
        compression=0.13,
        M=1.05,
        mu0=5400.0,
        alpha=0.0,
        reference_pressure=20.0,
        preconsolidation=2e4,
    ),
    NorSand(
        swelling=0.01, mu0=2e7, alpha=0.0, reference_pressure=1e5, M=1.25, N=0.2, chi=3.5,
        hardening=150.0, critical_void_ratio=0.82, critical_slope=0.03, void_ratio=0.65,
        image_pressure=5e4,
    ),
]  # fmt: skip


def respond(address, law, trial):
    """What a kernel writes: elastic strain, internal variables, stress and tangent."""
    parameters = law.parameter_array()
    old = np.ascontiguousarray(np.repeat(law.first_internal(parameters), len(trial), axis=0))
    strain, new = trial.copy(), old.copy()
    stress, tangent = np.zeros((len(trial), 3)), np.full((len(trial), 9), 7.0)
    assert respond_at_points(address, parameters, strain, old, new, stress, tangent) == -1
    return strain, new, stress, tangent


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_a_kernel_without_a_tangent_gives_the_same_state(law):
    assert law.stress_address != law.address
    trial = np.random.default_rng(5).uniform(-2e-3, 1e-3, (200, 3))
    if isinstance(law, (CamClay, NorSand)):
        trial = trial * [1.0, 0.2, 0.2] - 1e-2
    whole = respond(law.address, law, trial)
    part = respond(law.stress_address, law, trial)
    for expected, found in zip(whole[:3], part[:3]):
        scale = np.abs(expected).max(initial=1e-300)
        assert np.abs(found - expected).max(initial=0.0) <= 1e-14 * scale
    assert not np.all(whole[3] == 7.0)
    assert np.all(part[3] == 7.0)


@law_kernel
def _spring(parameters, strain, old, new, stress, tangent):
    for i in range(3):
        stress[i] = parameters[0] * strain[i]
    return 0


class Spring(Law):
    """A law of somebody else's."""

    parameters = ELASTIC
    kernel = _spring


def test_kernels_from_elsewhere_are_taken_as_they_are():
    law = Spring(E=1e5, nu=0.0)
    assert law.stress_address == law.address
