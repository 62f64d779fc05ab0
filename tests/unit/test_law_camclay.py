"""Cam-Clay: robustness, the local equations, tangents, and triaxial tests in closed form."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from laws import central_differences, check_finite, states

from dolfinmpm._platform.errors import ParameterError, StateError
from dolfinmpm.materials import CamClay

SWELLING, COMPRESSION, M = 0.018, 0.13, 1.05


def clay(mu0=5.4e6, alpha=0.0, pc=2e4, p0=2e4, **more):
    return CamClay(
        swelling=SWELLING,
        compression=COMPRESSION,
        M=M,
        mu0=mu0,
        alpha=alpha,
        reference_pressure=p0,
        preconsolidation=pc,
        **more,
    )


LAWS = [
    clay(),
    clay(pc=8e4),
    clay(mu0=0.0, alpha=120.0),
    clay(mu0=0.0, alpha=20.0, pc=2e5),
    clay(mu0=2e6, alpha=60.0, pc=5e4, reference_strain=-0.01),
    clay(mu0=1e3, pc=3e4),
]
ANY = pytest.mark.parametrize("law", LAWS, ids=repr)


def pq(stress):
    """Pressure, positive in compression, and q (Pa)."""
    p = -stress.mean(axis=-1)
    return p, np.sqrt(1.5 * ((stress + p[..., None]) ** 2).sum(axis=-1))


def parts(strain):
    """ε_v and ε_s."""
    volume = strain.sum(axis=-1)
    dev = strain - volume[..., None] / 3
    return volume, np.sqrt(2 / 3 * (dev**2).sum(axis=-1))


def energy(law, strain):
    """Ψ as Borja and Tamagnini state it (Pa)."""
    swelling, _, _, mu0, alpha, p0, reference, _ = law.parameter_array()[0]
    volume, shear = parts(strain)
    grown = -p0 * np.exp(-(volume - reference) / swelling)
    return -swelling * grown + 1.5 * (mu0 - alpha * grown) * shear**2


def hyperelastic(law, strain):
    """p and q (Pa) of elastic strains, p positive."""
    swelling, _, _, mu0, alpha, p0, reference, _ = law.parameter_array()[0]
    volume, shear = parts(strain)
    X = p0 * np.exp(-(volume - reference) / swelling)
    return X * (1 + 1.5 * alpha / swelling * shear**2), 3 * (mu0 + alpha * X) * shear


@ANY
def test_rounding_does_not_say_whether_a_tangent_is_elastic(law):
    """That of states on the yield surface, as points that have yielded start the next step."""
    first = law.respond(states(2_000))
    moved = first.internal[:, 0] != law.values["preconsolidation"]
    strain, internal = first.strain[moved], first.internal[moved]
    assert moved.sum() > 100
    on = law.respond(strain, internal=internal)
    # well within the surface
    within = law.respond(strain, internal=internal * (1 + 1e-6))
    for share in (-1e-15, 0.0, 1e-15):
        again = law.respond(strain * (1 + share), internal=internal)
        size = np.abs(on.tangent).max(axis=(1, 2), keepdims=True)
        assert (np.abs(again.tangent - within.tangent) <= 1e-9 * size).all()
        f = law.yield_function(again.stress, again.internal, law.parameter_array())
        assert (f <= 1e-13 * again.internal[:, 0] ** 2).all()


@ANY
def test_every_state_meets_the_local_equations(law):
    strain = states(100_000)
    answer = law.respond(strain)
    check_finite(answer)
    pc = answer.internal[:, 0]
    f = law.yield_function(answer.stress, answer.internal, law.parameter_array())
    assert (f <= 1e-13 * pc**2).all()
    moved = (answer.strain != strain).any(axis=1)
    assert moved.mean() > 0.1
    assert np.abs(f / pc**2)[moved].max() <= 1e-13
    assert (pc[~moved] == law.values["preconsolidation"]).all()
    p, q = pq(answer.stress)
    p_energy, q_energy = hyperelastic(law, answer.strain)
    size = np.hypot(p, q)
    # strain of 0.2 holds p to 1e-16·0.2/κ̂ and q to 1e-16·μ
    noise = 1e-15 * (law.values["mu0"] + law.values["alpha"] * p)
    assert (np.abs(p - p_energy) <= 1e-12 * size + noise).all()
    assert (np.abs(q - q_energy) <= 1e-12 * size + noise).all()

    # the residual of Borja and Tamagnini, over pc and with the multiplier from both equations
    volume, shear = parts(strain)
    volume_e, shear_e = parts(answer.strain)
    grown = np.exp((volume_e - volume) / (COMPRESSION - SWELLING))
    assert pc == pytest.approx(law.values["preconsolidation"] * grown, rel=1e-12)
    normal, across = 2 * p / pc - 1, 2 * q / (M * pc)
    flow = (volume_e - volume) * normal + M * (shear - shear_e) * across
    assert (flow[moved] > 0).all()  # so that the plastic work Δγ |p| pc is positive
    rest = np.maximum(1e-10 * flow, 1e-15)
    assert (np.abs(volume_e - volume - flow * normal) <= rest).all()
    assert (np.abs(shear - shear_e - flow * across / M) <= rest / M).all()


@ANY
def test_tangent_is_the_derivative(law):
    strain = states(20_000, seed=1)
    answer = law.respond(strain)
    here = (answer.strain == strain).all(axis=1)
    same = np.abs(strain).max(axis=1) > 1e-5
    # a pressure far below that of the yield surface's scale leaves no room for a difference
    same &= pq(answer.stress)[0] > 1e-3 * answer.internal[:, 0]
    best = np.full(len(strain), np.inf)
    scale = np.abs(answer.tangent).max(axis=(1, 2))
    for step in (1e-6, 1e-7, 1e-8):
        found, ends = central_differences(law, strain, step)
        if step == 1e-8:
            for moved, there in ends:
                same &= (there.strain == moved).all(axis=1) == here
        best = np.minimum(best, np.abs(found - answer.tangent).max(axis=(1, 2)) / scale)
    assert same.sum() > 5000
    assert best[same].max() <= 1e-5
    assert np.quantile(best[same], 0.99) <= 1e-7


@ANY
def test_stress_is_the_derivative_of_the_energy(law):
    rng = np.random.default_rng(2)
    answer = law.respond(rng.uniform(-0.01, 0.01, (200, 3)) - 0.01)
    step = 1e-6
    for i in range(3):
        move = step * np.eye(3)[i]
        above, below = energy(law, answer.strain + move), energy(law, answer.strain - move)
        scale = np.abs(answer.stress).max(axis=1) + 1.0
        assert (
            np.abs((above - below) / (2 * step) - answer.stress[:, i]).max() <= 1e-5 * scale.max()
        )


def test_hydrostatic_limit():
    """Tangents with q → 0 tend to that of q = 0, elastic and plastic."""
    for law, volume in itertools.product(LAWS, (-0.003, -0.3)):
        still = np.full((1, 3), volume / 3)
        exact = law.respond(still)
        assert exact.stress[0] == pytest.approx(exact.stress[0, 0], rel=1e-15)
        for small in (1e-8, 1e-11, 1e-15):
            near = law.respond(still + small * np.array([1.0, -0.3, -0.7]))
            scale = np.abs(exact.tangent).max()
            assert np.abs(near.tangent - exact.tangent).max() <= scale * max(2e4 * small, 1e-7)
        assert exact.tangent[0] == pytest.approx(exact.tangent[0].T, rel=1e-14)


def test_states_on_the_surface_stay():
    law = LAWS[1]
    first = law.respond(states(20_000) - 0.005)
    again = law.respond(first.strain, internal=first.internal)
    assert again.internal == pytest.approx(first.internal, rel=1e-12)
    size = np.maximum(np.abs(first.stress).max(axis=1), first.internal[:, 0])
    assert (np.abs(again.stress - first.stress).max(axis=1) <= 1e-12 * size).all()


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3)
    | st.floats(-0.2, 0.2).map(lambda a: [a] * 3),
    st.sampled_from(LAWS),
)
def test_order_does_not_matter(strain, law):
    orders = np.array(list(itertools.permutations(range(3))))
    answer = law.respond(np.array(strain)[orders])
    size = np.abs(answer.stress[0]).max() + answer.internal[0, 0]
    for k, order in enumerate(orders):
        assert np.abs(answer.stress[k] - answer.stress[0][order]).max() <= 1e-10 * size
        assert answer.internal[k] == pytest.approx(answer.internal[0], rel=1e-11)


@settings(max_examples=100, deadline=None)
@given(
    st.floats(-3, -1), st.floats(-1, 2), st.floats(0.3, 2.5), st.floats(3, 8), st.floats(0, 3),
    st.sampled_from([(1, 0), (0, 1), (1, 1)]), st.floats(0, 3), st.integers(0, 999),
)  # fmt: skip
def test_all_parameters(swelling, ratio, slope, mu0, alpha, mixed, overconsolidation, seed):
    """No set of parameters leaves the return without a solution."""
    swelling = 10**swelling
    law = CamClay(
        swelling=swelling, compression=min(swelling * (1 + 10**ratio), 0.99), M=slope,
        mu0=mixed[0] * 10**mu0, alpha=mixed[1] * 10**alpha,
        reference_pressure=2e4, preconsolidation=2e4 * 10**overconsolidation,
    )  # fmt: skip
    strain = states(500, seed)
    # pressures within 1e±43 of the first one, so that squares are doubles too
    volume = np.abs(strain.sum(axis=1))
    strain *= np.minimum(1.0, 100 * swelling / np.maximum(volume, 1e-300))[:, None]
    answer = law.respond(strain)
    f = law.yield_function(answer.stress, answer.internal, law.parameter_array())
    assert (f <= 1e-12 * answer.internal[:, 0] ** 2).all()


# --- triaxial tests: axis 0 is the axis of the sample


def shear_undrained(law, strain, internal, steps, size):
    for _ in range(steps):
        answer = law.respond(strain + size * np.array([-1.0, 0.5, 0.5]), internal=internal)
        strain, internal = answer.strain, answer.internal
        yield answer


def shear_drained(law, answer, steps, size):
    """Axial compression at constant lateral stress, with the law's tangent."""
    hold = answer.stress[0, 1]
    lateral = 0.0
    for _ in range(steps):
        old, internal = answer.strain, answer.internal
        for k in range(30):
            answer = law.respond(old + np.array([-size, lateral, lateral]), internal=internal)
            off = answer.stress[0, 1] - hold
            assert k < 12, "the tangent does not converge quadratically"
            if abs(off) < 1e-10 * abs(hold):
                break
            lateral -= off / answer.tangent[0, 1, 1:].sum()
        yield answer, np.array([-size, lateral, lateral])


@pytest.mark.parametrize("alpha", [0.0, 120.0])
def test_isotropic_compression_and_unloading(alpha):
    law = clay(alpha=alpha, pc=8e4)
    p0, pc = 2e4, 8e4
    to_pc = -SWELLING * np.log(pc / p0)
    volume = np.linspace(0, -0.3, 61)
    p, q = pq(law.respond(np.repeat(volume[:, None] / 3, 3, axis=1)).stress)
    swell = p0 * np.exp(-volume / SWELLING)
    virgin = pc * np.exp(-(volume - to_pc) / COMPRESSION)
    assert p == pytest.approx(np.where(volume > to_pc, swell, virgin), rel=1e-12)
    assert q == pytest.approx(0.0, abs=1e-9)
    # in steps to the same state, as the hardening is exact; then back along κ̂
    state, internal = np.zeros((1, 3)), None
    for _ in range(60):
        answer = law.respond(state - 0.3 / 180, internal=internal)
        state, internal = answer.strain, answer.internal
    assert pq(answer.stress)[0][0] == pytest.approx(p[-1], rel=1e-10)
    back = law.respond(state + 0.02 / 3, internal=internal)
    assert pq(back.stress)[0][0] == pytest.approx(p[-1] * np.exp(-0.02 / SWELLING), rel=1e-10)
    assert np.array_equal(back.internal, internal)


@pytest.mark.parametrize("pc", [2e4, 3e4, 16e4])
def test_undrained_path(pc):
    """Without volume change κ̂ ln p + (λ̂ − κ̂) ln pc stays, whatever the steps."""
    law = clay(pc=pc)
    constant = SWELLING * np.log(2e4) + (COMPRESSION - SWELLING) * np.log(pc)
    for answer in shear_undrained(law, np.zeros((1, 3)), None, 200, 3e-3):
        p, q = pq(answer.stress[0])
        now = answer.internal[0, 0]
        left = SWELLING * np.log(p) + (COMPRESSION - SWELLING) * np.log(now)
        assert left == pytest.approx(constant, rel=1e-12)
    end = 2e4 * (pc / 4e4) ** (1 - SWELLING / COMPRESSION)
    assert p == pytest.approx(end, rel=1e-6)
    assert q == pytest.approx(M * end, rel=1e-6)
    assert now == pytest.approx(2 * end, rel=1e-6)


@pytest.mark.parametrize(("mu0", "alpha"), [(5.4e6, 0.0), (1e6, 120.0)])
def test_drained_path(mu0, alpha):
    """q = 3 (p − p0), ends at p = 3 p0/(3 − M), q = M p, with the volume of the state variables."""
    law = clay(mu0=mu0, alpha=alpha)
    total = 0.0
    start = law.respond(np.zeros((1, 3)))
    for answer, increment in shear_drained(law, start, 400, 5e-3):
        total += increment.sum()
        p, q = pq(answer.stress[0])
        assert q == pytest.approx(3 * (p - 2e4), rel=1e-7, abs=1e-4)
    elastic = answer.strain.sum()
    pc = answer.internal[0, 0]
    assert total - elastic == pytest.approx(-(COMPRESSION - SWELLING) * np.log(pc / 2e4), rel=1e-9)
    if alpha == 0.0:
        assert elastic == pytest.approx(-SWELLING * np.log(p / 2e4), rel=1e-9)
    assert p == pytest.approx(3 * 2e4 / (3 - M), rel=1e-4)
    assert q == pytest.approx(M * p, rel=1e-4)


def test_heavily_overconsolidated_clay_softens():
    """The drained peak lies above the critical state, and the sample dilates."""
    law = clay(pc=20e4)
    q, volume, start = [0.0], 0.0, law.respond(np.zeros((1, 3)))
    for size in (5e-4, 5e-3):
        for answer, increment in shear_drained(law, start, 300, size):
            q.append(pq(answer.stress[0])[1])
            volume += increment.sum()
        start = answer
    assert max(q) > 1.5 * M * 3 * 2e4 / (3 - M)
    assert q[-1] == pytest.approx(M * 3 * 2e4 / (3 - M), rel=0.02)
    assert volume > 0.0


def test_unstrained_points_stand_under_the_reference_pressure():
    law = clay(pc=5e4, reference_strain=0.01)
    answer = law.respond(np.zeros((1, 3)))
    assert answer.stress[0] == pytest.approx(-2e4 * np.exp(0.01 / SWELLING), rel=1e-14)
    assert answer.internal[0, 0] == 5e4


def test_parameters_may_vary():
    law = clay(p0=lambda x: 2e4 * (1 + x[1]), pc=np.array([3e4, 9e4]))
    strain = np.array([[-0.02, -0.01, 0.001]] * 2)
    answer = law.respond(strain, x=np.array([[0.0, 0.0], [0.0, 1.0]]))
    for k, (p0, pc) in enumerate(((2e4, 3e4), (4e4, 9e4))):
        assert np.array_equal(clay(p0=p0, pc=pc).respond(strain[:1]).stress[0], answer.stress[k])


def test_errors():
    with pytest.raises(ParameterError, match=r"compression = 0.01 must be larger than swelling"):
        CamClay(
            swelling=0.018,
            compression=0.01,
            M=M,
            mu0=1e6,
            alpha=0.0,
            reference_pressure=2e4,
            preconsolidation=2e4,
        )
    with pytest.raises(ParameterError, match="mu0 = 0 must not be 0 together with alpha"):
        clay(mu0=0.0)
    with pytest.raises(ParameterError, match="preconsolidation = 10000 must be at least the first"):
        clay(pc=1e4)
    with pytest.raises(ParameterError, match="reference_pressure = -20000"):
        clay(p0=-2e4)
    # a pressure above 1e308 Pa, one below 1e-308 Pa, and no numbers
    for bad in ([-40.0] * 3, [5.0] * 3, [np.nan, 0.0, 0.0], [np.inf, 0.0, 0.0]):
        with pytest.raises(StateError, match="CamClay finds no stress at point 1"):
            clay().respond([[0.0, 0.0, 0.0], bad])
