"""Von Mises, Tresca and Mohr–Coulomb at a point."""

from __future__ import annotations

import math

import numpy as np
import pytest
from laws import (
    check_maximal_dissipation,
    check_permutations,
    check_return,
    check_tangent,
    random_strains,
)

from dolfinmpm._platform.errors import ParameterError, StateError
from dolfinmpm.materials import Hencky, Law, MohrCoulomb, Tresca, VonMises
from dolfinmpm.materials.base import lame

ROOT = math.sqrt(2 / 3)
LAWS = {
    "vonmises": VonMises(1e6, 0.3, radius=2e4),
    "vonmises-linear": VonMises(1e6, 0.2, radius=2e4, hardening=3e5),
    "vonmises-softening": VonMises(1e6, 0.3, radius=2e4, hardening=0.0, saturation=5e3, rate=20.0),
    "vonmises-saturating": VonMises(
        1e6, 0.45, radius=2e4, hardening=1e4, saturation=3e4, rate=50.0
    ),
    "vonmises-weak": VonMises(1e6, 0.3, radius=1.0),
    "tresca": Tresca(1e6, 0.33, 1e4),
    "tresca-hardening": Tresca(1e6, 0.33, 1e4, ultimate_cohesion=1.5e4),
    "tresca-softening": Tresca(1e6, 0.49, 1e4, ultimate_cohesion=4e3, rate=30.0),
    "tresca-weak": Tresca(1e6, 0.0, 1.0),
    "clay": MohrCoulomb(1e6, 0.4, 1e4, 0.0),
    "associated": MohrCoulomb(1e6, 0.3, 1e3, 30.0, dilation_angle=30.0),
    "dilating": MohrCoulomb(1e6, 0.3, 1e3, 35.0, dilation_angle=8.0),
    "isochoric": MohrCoulomb(1e6, 0.2, 2e3, 25.0),
    "sand": MohrCoulomb(5.84e6, 0.3, 0.0, 21.9),
    "auxetic": MohrCoulomb(1e6, -0.5, 1e3, 40.0, dilation_angle=20.0),
    "weak": MohrCoulomb(1e6, 0.3, 1.0, 30.0, dilation_angle=10.0),
    "smooth": MohrCoulomb(1e6, 0.3, 1e3, 0.01, dilation_angle=0.005),
    "steep": MohrCoulomb(1e6, 0.3, 1e3, 80.0, dilation_angle=10.0),
    "cohesion-softening": MohrCoulomb(
        1e6, 0.3, 1e4, 25.0, dilation_angle=5.0, residual_cohesion=2e3, rate=15.0
    ),
    "cohesion-lost": MohrCoulomb(
        1e6, 0.3, 5e3, 30.0, dilation_angle=0.0, residual_cohesion=0.0, rate=10.0
    ),
    "friction-hardening": MohrCoulomb(
        1e6,
        0.3,
        1e3,
        20.0,
        dilation_angle=10.0,
        residual_cohesion=2e3,
        residual_friction_angle=35.0,
        rate=10.0,
    ),
    # so gentle that it stays unique under the largest pressure tried here
    "friction-softening": MohrCoulomb(
        1e6,
        0.3,
        1e4,
        32.0,
        dilation_angle=4.0,
        residual_cohesion=5e3,
        residual_friction_angle=30.0,
        rate=3.0,
    ),
}
PERFECT = [
    "vonmises", "vonmises-weak", "tresca", "tresca-weak", "clay", "associated"
]  # fmt: skip
laws = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())


def elastic(law: Law) -> Hencky:
    return Hencky(law.values["E"], law.values["nu"])


def check_plastic_strain(law: Law, strains, result, old=0.0) -> None:
    """α grows by √(2/3) of the plastic strain's norm."""
    grown = ROOT * np.linalg.norm(strains - result.strain, axis=1)
    size = np.abs(strains).max(axis=1) + result.internal[:, 0]
    # strains follow from stresses, where the pressure can be larger by K/μ
    lmbda, mu = lame(law.values["E"], law.values["nu"])
    size = size * (1 + abs(lmbda) / mu)
    assert (np.abs(result.internal[:, 0] - old - grown) <= 1e-12 * size).all()


@laws
def test_returned_states_are_admissible_and_consistent(law):
    strains = random_strains(100_000, seed=1)
    result = check_return(law, strains, elastic=elastic(law))
    check_plastic_strain(law, strains, result)
    assert 0.05 < (result.internal[:, 0] > 0).mean() < 0.999


@laws
def test_states_on_the_yield_surface_stay_there(law):
    first = law.respond(random_strains(20_000, seed=2))
    result = check_return(law, first.strain, first.internal, elastic=elastic(law))
    size = np.abs(first.stress).max(axis=1) / law.values["E"]
    assert (np.abs(result.strain - first.strain).max(axis=1) <= 1e-11 * size).all()


@laws
def test_states_that_have_flowed_before(law):
    strains = random_strains(20_000, seed=3, low=1e-4)
    old = np.random.default_rng(3).exponential(0.1, (len(strains), 1))
    result = check_return(law, strains, old, elastic=elastic(law))
    check_plastic_strain(law, strains, result, old[:, 0])


@laws
def test_tangent_is_the_derivative(law):
    yields = np.abs(law.yield_function(np.zeros((1, 3)), np.zeros((1, 1)), law.parameter_array()))
    size = max(yields[0] / law.values["E"], 1e-4)
    strains = random_strains(5_000, seed=4, low=size, high=min(100 * size, 1.0))
    check_tangent(law, strains[np.ptp(strains, axis=1) > 0], share=0.8)


@laws
def test_order_of_the_axes_does_not_matter(law):
    check_permutations(law, random_strains(10_000, seed=5))


@pytest.mark.parametrize("name", PERFECT)
def test_associated_laws_dissipate_the_most(name):
    check_maximal_dissipation(LAWS[name], random_strains(1500, seed=6, low=1e-6, high=0.1))


@pytest.mark.parametrize("name", ["dilating", "isochoric", "sand", "auxetic", "steep", "smooth"])
def test_flow_is_normal_to_the_potential(name):
    # a return along the potential's normals is the projection on the potential's level set
    # through the stress found, which is what the associated law of that angle does
    law = LAWS[name]
    strains = random_strains(20_000, seed=7, low=1e-6, high=0.1)
    result = law.respond(strains)
    yielded = (result.internal[:, 0] > 0) & (np.ptp(result.stress, axis=1) > 0)
    strains, stress = strains[yielded], result.stress[yielded]
    psi = law.values["dilation_angle"]
    high, low = stress.max(axis=1), stress.min(axis=1)
    level = high - low + (high + low) * math.sin(math.radians(psi))
    inside = level > 1e-9 * np.abs(stress).max(axis=1)
    assert inside.mean() > 0.5
    E, nu = law.values["E"], law.values["nu"]
    cohesion = level[inside] / (2 * math.cos(math.radians(psi)))
    potential = MohrCoulomb(E, nu, cohesion, psi, dilation_angle=psi)
    found = potential.respond(strains[inside], x=np.zeros((inside.sum(), 2)))
    size = E * np.abs(strains[inside]).max(axis=1)
    assert (np.abs(found.stress - stress[inside]).max(axis=1) <= 1e-11 * size).all()


def test_tresca_is_mohr_coulomb_without_friction():
    strains = random_strains(5_000, seed=8)
    one = Tresca(1e6, 0.3, 1e4, ultimate_cohesion=2e4, rate=7.0).respond(strains)
    other = MohrCoulomb(
        1e6, 0.3, 1e4, 0.0, dilation_angle=0.0, residual_cohesion=2e4, rate=7.0
    ).respond(strains)
    assert (one.stress == other.stress).all()
    assert (one.tangent == other.tangent).all()


def test_a_bar_in_tension_yields_at_its_yield_stress():
    # strain-driven bar: lateral strains that leave the sides free of stress
    rho, H, mu, bulk = 2e4, 3e5, 4e5, 1e6
    E = 9 * bulk * mu / (3 * bulk + mu)
    nu = E / (2 * mu) - 1
    plastic = 0.01
    sigma = math.sqrt(1.5) * (rho + H * plastic)
    axial, lateral = sigma / E + plastic, -nu * sigma / E - plastic / 2
    root = math.sqrt(1.5)
    for strengths in (
        {"radius": rho, "hardening": H},
        {"yield_stress": root * rho, "hardening": root * H},
    ):
        found = VonMises(E, nu, **strengths).respond([[lateral, axial, lateral]])
        assert found.stress[0] == pytest.approx([0, sigma, 0], rel=1e-12, abs=1e-8)
        assert found.internal[0, 0] == pytest.approx(plastic, rel=1e-12)


def test_strengths_of_the_bar_are_those_of_the_radius():
    strains, root = random_strains(1_000, seed=4), math.sqrt(1.5)
    radii = {"radius": 2e4, "hardening": 1e4, "saturation": 3e4}
    one = VonMises(1e6, 0.3, rate=50.0, **radii)
    other = VonMises(
        1e6, 0.3, rate=50.0, yield_stress=root * 2e4, hardening=root * 1e4, saturation=root * 3e4
    )
    for name in ("stress", "tangent", "internal"):
        expected = getattr(one.respond(strains), name)
        assert getattr(other.respond(strains), name) == pytest.approx(expected, rel=1e-9, abs=1e-3)
    stress, internal = one.respond(strains).stress, one.respond(strains).internal
    f = [law.yield_function(stress, internal, law.parameter_array()) for law in (one, other)]
    assert f[0] == pytest.approx(f[1], rel=1e-9, abs=1e-6)


def test_saturating_strength_follows_its_curve():
    law = VonMises(1e6, 0.3, radius=2e4, hardening=1e4, saturation=3e4, rate=50.0)
    found = law.respond([[0.1, -0.1, 0.0]])
    alpha = found.internal[0, 0]
    radius = 2e4 + 1e4 * alpha + 1e4 * (1 - math.exp(-50 * alpha))
    assert np.linalg.norm(found.stress[0]) == pytest.approx(radius, rel=1e-13)


def test_tresca_in_pure_shear():
    law = Tresca(1e6, 0.33, 1e4, ultimate_cohesion=1.5e4)
    mu = 1e6 / 2.66
    multiplier = 0.02
    alpha = 2 / math.sqrt(3) * multiplier
    c = 1.5e4 - 5e3 * math.exp(-5 * alpha)
    strain = c / (2 * mu) + multiplier
    found = law.respond([[0.0, -strain, strain]])
    assert found.internal[0, 0] == pytest.approx(alpha, rel=1e-12)
    assert found.stress[0] == pytest.approx([0, -c, c], rel=1e-12, abs=1e-8)


def test_laws_that_call_their_tangent_symmetric_have_such_tangents():
    rate = {"rate": 2.0}
    mixed = Tresca(1e4, 0.2, np.array([1e2, 2e2]), ultimate_cohesion=np.array([1e2, 3e2]), **rate)
    same = Tresca(1e4, 0.2, np.array([1e2, 2e2]), ultimate_cohesion=np.array([1e2, 2e2]), **rate)
    by_place = Tresca(1e4, 0.2, lambda x: 1e2 + x[0])
    other = Tresca(1e4, 0.2, lambda x: 1e2 + x[0], ultimate_cohesion=2e2, **rate)
    found = [law.symmetric for law in (mixed, same, by_place, other)]
    assert found == [False, True, True, False]
    # two of three strains are close to each other, so that many states return to an edge
    strains = np.random.default_rng(0).uniform(-0.15, 0.15, (200, 3))
    strains[100:, 1] = strains[100:, 2] * (1.0 + 1e-3 * strains[:100, 0])
    more = {"soft": Tresca(1e4, 0.2, 260.0, ultimate_cohesion=208.0, rate=2.0)}
    for name, law in (LAWS | more).items():
        tangent = law.respond(strains, internal=np.full((200, 1), 0.01)).tangent
        skew = np.abs(tangent - tangent.transpose(0, 2, 1)).max() / np.abs(tangent).max()
        assert not law.symmetric or skew < 1e-12, name
        assert name not in ("soft", "tresca-hardening") or skew > 1e-3


def test_triaxial_strength_with_friction():
    # σ₁ = σ₃ (1 + sin φ)/(1 − sin φ) for c = 0, in compression and in extension
    law = LAWS["sand"]
    ratio = math.tan(math.radians(45 + 21.9 / 2)) ** 2
    for strain in ([-0.1, 0.0, 0.0], [-0.1, -0.1, 0.03]):
        stress = np.sort(law.respond([strain]).stress[0])
        assert stress[0] / stress[2] == pytest.approx(ratio, rel=1e-12)
        assert stress[1] in (stress[0], stress[2])


@pytest.mark.parametrize("dilation", [0.0, 1e-9, 10.0, 30.0])
def test_apex(dilation):
    law = MohrCoulomb(1e6, 0.3, 1e3, 30.0, dilation_angle=dilation)
    pressure = 1e3 / math.tan(math.radians(30))
    strains = np.array([[0.01, 0.01, 0.01], [0.02, 0.018, 0.019], [0.5, 0.4, 0.45]])
    found = law.respond(strains)
    assert found.stress == pytest.approx(pressure, rel=1e-14)
    assert found.strain == pytest.approx(pressure * 0.4 / 1e6, rel=1e-13)
    assert (found.tangent == 0).all()
    check_plastic_strain(law, strains, found)


def test_sand_in_tension_carries_nothing():
    found = LAWS["sand"].respond([[0.01, 0.02, 0.015], [1e-12, 1e-12, 1e-12]])
    assert (found.stress == 0).all()
    assert (found.strain == 0).all()
    # at rest it is elastic, so that a first step has a stiffness
    assert LAWS["sand"].respond([[0.0, 0.0, 0.0]]).tangent[0, 0, 0] > 0


@laws
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_strains_that_are_not_numbers_are_refused(law, bad):
    for strain in ([bad, 0.0, 0.0], [0.0, 0.1, bad], [bad, bad, bad]):
        with pytest.raises(StateError, match="point 1"):
            law.respond([[0.0, 0.0, 0.0], strain])


@pytest.mark.parametrize(
    ("law", "strain"),
    [
        # strength used up
        (VonMises(1e6, 0.3, radius=2e4, hardening=-1e5), [0.3, -0.3, 0.0]),
        (
            VonMises(1e6, 0.3, radius=2e4, hardening=-1e5, saturation=3e4, rate=5.0),
            [0.5, -0.5, 0.0],
        ),
        # friction that falls faster under this pressure than elasticity unloads
        (
            MohrCoulomb(
                1e6,
                0.3,
                0.0,
                35.0,
                dilation_angle=0.0,
                residual_cohesion=0.0,
                residual_friction_angle=20.0,
                rate=50.0,
            ),
            [-0.5, 0.2, -0.1],
        ),
        # apex of a cohesion that falls, far out for so little friction
        (
            MohrCoulomb(1e6, 0.3, 1e3, 1.0, dilation_angle=0.0, residual_cohesion=0.0, rate=50.0),
            [0.2, 0.2, 0.2],
        ),
    ],
)
def test_states_without_one_stress_are_refused(law, strain):
    with pytest.raises(StateError, match="finds no stress at point 0"):
        law.respond([strain])


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: VonMises(1e6, 0.3, radius=0.0), "radius = 0.0 Pa"),
        (lambda: VonMises(1e6, 0.3, yield_stress=0.0), "yield_stress = 0.0 Pa"),
        (lambda: VonMises(1e6, 0.3, yield_stress=1e4, hardening=-2e6), "3 μ"),
        (lambda: VonMises(1e6, 0.3), "give exactly one"),
        (lambda: VonMises(1e6, 0.3, yield_stress=1e4, radius=1e4), "give exactly one"),
        (lambda: VonMises(1e6, 0.3, radius=1e4, hardening=-1e7), "√6 μ"),
        (lambda: VonMises(1e6, 0.3, radius=1e5, hardening=0.0, saturation=1e3, rate=20.0), "√6 μ"),
        (lambda: Tresca(1e6, 0.3, -1.0), "cohesion"),
        (lambda: Tresca(1e6, 0.3, 1e5, ultimate_cohesion=1e4, rate=10.0), "3/2 μ"),
        (lambda: MohrCoulomb(1e6, 0.3, 1e3, 95.0), "friction"),
        (lambda: MohrCoulomb(1e6, 0.3, 1e3, 20.0, dilation_angle=21.0), "dilation_angle = 21"),
        (
            lambda: MohrCoulomb(
                1e6, 0.3, 1e3, 30.0, dilation_angle=10.0, residual_friction_angle=5.0, rate=1.0
            ),
            "dilation_angle = 10",
        ),
        (lambda: MohrCoulomb(1e6, 0.3, 0.0, 0.0), "cohesion must be positive"),
        (
            lambda: MohrCoulomb(
                1e6, 0.3, 1e3, 0.0, dilation_angle=0.0, residual_cohesion=0.0, rate=1.0
            ),
            "must be positive",
        ),
        (
            lambda: MohrCoulomb(1e6, 0.3, 1e3, 30.0, dilation_angle=0.0, residual_cohesion=1.0),
            "positive rate",
        ),
        (
            lambda: MohrCoulomb(
                1e6, 0.3, 1e5, 30.0, dilation_angle=0.0, residual_cohesion=1.0, rate=20.0
            ),
            "cohesion falls",
        ),
    ],
)
def test_parameters_that_make_no_law_are_refused(make, match):
    with pytest.raises(ParameterError, match=match):
        make()


def test_the_limits_of_softening_are_those_of_the_kernel():
    # just inside the bound an edge still returns; just outside the law refuses itself
    mu = lame(1e6, 0.3)[1]
    for make in (
        lambda fall: Tresca(1e6, 0.3, 1e4 + fall, ultimate_cohesion=1e4, rate=1.0),
        lambda fall: MohrCoulomb(
            1e6, 0.3, 1e4 + fall, 0.0, dilation_angle=0.0, residual_cohesion=1e4, rate=1.0
        ),
    ):
        law = make(1.499 * mu)
        yields = law.values["cohesion"] / mu
        check_return(law, np.array([[1.001, -0.5, -0.5]]) * yields * 4 / 3)
        with pytest.raises(ParameterError):
            make(1.501 * mu)


def test_parameters_may_vary_from_point_to_point():
    x = np.random.default_rng(9).random((50, 2))
    strains = random_strains(50, seed=9, low=0.01)

    def cohesion(x):
        return 1e3 + 1e3 * x[1]

    varying = [
        (Tresca(1e6, 0.3, cohesion), lambda c: Tresca(1e6, 0.3, c)),
        (MohrCoulomb(1e6, 0.3, cohesion, 30.0), lambda c: MohrCoulomb(1e6, 0.3, c, 30.0)),
        (VonMises(1e6, 0.3, radius=cohesion), lambda c: VonMises(1e6, 0.3, radius=c)),
        (Tresca(1e6, 0.3, cohesion(x.T)), lambda c: Tresca(1e6, 0.3, c)),
    ]
    for law, single in varying:
        result = check_return(law, strains, x=x)
        for p, c in enumerate(cohesion(x.T)):
            assert (single(c).respond(strains[p : p + 1]).stress == result.stress[p]).all()
    with pytest.raises(ParameterError, match="dilation"):
        MohrCoulomb(1e6, 0.3, 1e3, lambda x: 40 * x[0], dilation_angle=20.0).parameter_array(x)
