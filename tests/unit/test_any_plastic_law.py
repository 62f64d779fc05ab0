"""Laws of plasticity with any parameters, at any strains."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from laws import (
    check_permutations,
    check_return,
    random_strains,
)
from test_law_plasticity import check_plastic_strain, elastic

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials import Law, MohrCoulomb, Tresca, VonMises
from dolfinmpm.materials.base import lame


def sizes(low: float, high: float):
    return st.floats(math.log(low), math.log(high)).map(math.exp)


moduli = st.tuples(sizes(1e3, 1e12), st.floats(-0.9, 0.499))

seeds = st.integers(0, 2**32 - 1)

often = settings(max_examples=60, deadline=None)


def made(make) -> Law:
    try:
        return make()
    except ParameterError:
        assume(False)
        raise


@often
@given(moduli, sizes(1e-6, 0.1), st.floats(0, 2), sizes(0.01, 10), st.floats(0, 300), seeds)
def test_any_vonmises(elasticity, ratio, hardening, growth, rate, seed):
    E, nu = elasticity
    # no linear softening: its strength ends
    law = made(
        lambda: VonMises(
            E,
            nu,
            radius=ratio * E,
            hardening=hardening * E,
            saturation=growth * ratio * E,
            rate=rate,
        )
    )
    check_any(law, seed)


@often
@given(moduli, sizes(1e-6, 0.1), sizes(0.01, 10), st.floats(0, 300), seeds)
def test_any_tresca(elasticity, ratio, growth, rate, seed):
    E, nu = elasticity
    check_any(
        made(lambda: Tresca(E, nu, ratio * E, ultimate_cohesion=growth * ratio * E, rate=rate)),
        seed,
    )


@pytest.mark.filterwarnings("ignore::dolfinmpm._platform.errors.DegreesWarning")
@often
@given(
    moduli,
    st.one_of(st.just(0.0), sizes(1e-6, 0.1)),
    st.floats(0.1, 70),
    st.one_of(st.just(0.0), st.floats(0, 1)),
    sizes(1, 10),
    st.floats(0, 15),
    st.floats(0.01, 300),
    seeds,
)
def test_any_mohrcoulomb(elasticity, ratio, friction, dilation, growth, more, rate, seed):
    E, nu = elasticity
    c = ratio * E
    last = friction + (0.0 if growth < 2 else more)
    # friction that grows lowers the apex, and must not do so faster than elasticity unloads
    lowered = (
        rate * math.radians(last - friction) * growth * c / math.sin(math.radians(friction)) ** 2
    )
    assume(lowered < 0.3 * min(E / (1 - 2 * nu), lame(E, nu)[1]))
    law = MohrCoulomb(
        E,
        nu,
        c,
        friction,
        dilation_angle=dilation * friction,
        residual_cohesion=growth * c,
        residual_friction_angle=last,
        rate=rate,
    )
    check_any(law, seed)


def check_any(law: Law, seed: int) -> None:
    strains = random_strains(300, seed)
    result = check_return(law, strains, elastic=elastic(law))
    check_plastic_strain(law, strains, result)
    check_permutations(law, strains)
