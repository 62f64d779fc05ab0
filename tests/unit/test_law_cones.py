"""Drucker–Prager: fits, returns to the side and to the apex, tangents, errors."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from conftest import unit_grid
from hypothesis import given, settings
from hypothesis import strategies as st
from laws import central_differences, check_finite, states

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError, StateError
from dolfinmpm.materials import DruckerPrager

E, NU = 1e7, 0.3
G, K = E / (2 * (1 + NU)), E / (3 * (1 - 2 * NU))
LAWS = [
    DruckerPrager(E, NU, c, 30.0, dilation_angle=psi, fit=fit, hardening=hardening)
    for c, psi, fit, hardening in (
        (1e3, 10.0, "compression", 0.0),
        (1e3, 30.0, "extension", 1e5),
        (1e3, 0.0, "plane strain", 0.0),
        (1e3, 0.0, "inner", 1e6),
        (0.0, 0.0, "compression", 0.0),
        (0.0, 20.0, "inner", 1e5),
    )
]
TRESCA_LIKE = DruckerPrager(E, NU, 1e3, 0.0, dilation_angle=0.0)
ANY = pytest.mark.parametrize("law", [*LAWS, TRESCA_LIKE], ids=repr)


def deviator(a):
    return a - a.mean(axis=1)[:, None]


def root_of(stress):
    return np.sqrt(0.5 * (deviator(stress) ** 2).sum(axis=1))


def hencky(strain):
    return 3 * K * strain.mean(axis=1)[:, None] + 2 * G * deviator(strain)


def scale_of(law, answer):
    """Largest stress, or the cohesion where that is larger (Pa)."""
    P = law.parameter_array()
    c = P[:, 7] * (P[:, 2] + P[:, 5] * answer.internal[:, 0])
    return np.abs(answer.stress).max(axis=1) + c


def mohr_coulomb(stress, c, friction):
    """The largest of (σ1 − σ3)/2 + (σ1 + σ3)/2 sin φ − c cos φ (Pa)."""
    top, low = stress.max(axis=-1), stress.min(axis=-1)
    phi = np.radians(friction)
    return (top - low) / 2 + (top + low) / 2 * np.sin(phi) - c * np.cos(phi)


@ANY
def test_every_state_ends_on_the_cone(law):
    strain = states(100_000)
    answer = law.respond(strain)
    P = law.parameter_array()
    scale = scale_of(law, answer)
    check_finite(answer)
    f = law.yield_function(answer.stress, answer.internal, P)
    trial = law.yield_function(hencky(strain), np.zeros((len(strain), 1)), P)
    size = np.abs(hencky(strain)).max(axis=1) + scale
    yielding = trial > 1e-12 * size
    assert yielding.mean() > 0.3
    assert (np.abs(f[yielding]) <= 1e-14 * scale[yielding]).all()
    elastic = trial < -1e-12 * size
    assert np.array_equal(answer.strain[elastic], strain[elastic])
    assert (answer.internal[elastic] == 0).all()
    assert np.abs(hencky(answer.strain) - answer.stress).max() <= 1e-14 * E
    # plastic work, and the accumulated strain is that of the plastic strain
    plastic = strain - answer.strain
    assert ((answer.stress * plastic).sum(axis=1) >= -1e-14 * scale * 0.2).all()
    accumulated = np.sqrt(2 / 3 * (plastic**2).sum(axis=1))
    assert accumulated == pytest.approx(answer.internal[:, 0], rel=1e-9, abs=1e-15)


@ANY
def test_side_follows_the_dilation_angle(law):
    strain = states(20_000)
    answer = law.respond(strain)
    P = law.parameter_array()
    plastic = strain - answer.strain
    side = (answer.internal[:, 0] > 1e-6) & (root_of(answer.stress) > 1e-3 * scale_of(law, answer))
    assert side.sum() > 1000
    stress, length = answer.stress[side], answer.internal[side]
    flow = 0.5 * deviator(stress) / root_of(stress)[:, None] + P[:, 8:9] / 3
    flow *= length / np.sqrt(2 / 3 * (flow**2).sum(axis=1))[:, None]
    assert np.abs(plastic[side] - flow).max() <= 1e-12


@ANY
def test_tangent_is_the_derivative(law):
    strain = states(20_000, seed=1)
    strain = strain[np.abs(strain).max(axis=1) > 1e-5]
    step = 1e-8

    def branch(answer, at):
        apex = root_of(answer.stress) <= 1e-13 * (np.abs(answer.stress).max(axis=1) + 1)
        return np.where((answer.strain == at).all(axis=1), 0, np.where(apex, 2, 1))

    answer = law.respond(strain)
    here = branch(answer, strain)
    assert len(np.unique(here)) == 2 + (law is not TRESCA_LIKE)
    found, ends = central_differences(law, strain, step)
    same = np.ones(len(strain), bool)
    for moved, there in ends:
        same &= branch(there, moved) == here
    assert same.mean() > 0.9
    error = np.abs(found - answer.tangent).max(axis=(1, 2))[same]
    size = np.abs(strain).max(axis=1)[same]
    # rounding of stress over the step, and the curvature, which is that of the smallest strains
    assert (error <= E * (1e-15 * size / step + 10 * (step / size) ** 2 + 1e-7)).mean() > 0.999
    assert np.quantile(error, 0.99) <= 1e-6 * E


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_apex(law):
    P = law.parameter_array()[0]
    answer = law.respond([[0.01, 0.01, 0.01], [0.012, 0.011, 0.01]])
    c = P[2] + P[5] * answer.internal[:, 0]
    assert answer.stress == pytest.approx(
        np.repeat(P[7] * c / P[6], 3).reshape(2, 3), rel=1e-12, abs=1e-12
    )
    if P[5] == 0:
        assert not answer.tangent.any()
        assert not (P[2] == 0 and answer.stress.any())


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_side_meets_the_apex(law):
    """Stress and internal variables are continuous where the return changes its target."""
    strain = np.array([2.0, -1.0, -1.0]) * 1e-3 + np.linspace(-0.02, 0.02, 200_001)[:, None]
    answer = law.respond(strain)
    assert root_of(answer.stress).min() == 0.0 < root_of(answer.stress).max()
    assert np.abs(np.diff(answer.stress, axis=0)).max() <= 5 * E * 2e-7
    assert np.abs(np.diff(answer.internal, axis=0)).max() <= 2e-6


def test_fits_touch_the_pyramid():
    c, friction = 1e3, 27.0
    rng = np.random.default_rng(0)
    pressed = rng.uniform(-0.02, -0.01, 1000)[:, None]
    compressed = pressed + np.array([1.0, 1.0, -2.0]) * 0.05
    extended = pressed + np.array([-1.0, -1.0, 2.0]) * 0.05

    def f(fit, strain):
        law = DruckerPrager(E, NU, c, friction, dilation_angle=0.0, fit=fit)
        stress = law.respond(strain).stress
        assert (root_of(stress) > 0).all()
        return mohr_coulomb(stress, c, friction) / np.abs(stress).max()

    assert np.abs(f("compression", compressed)).max() < 1e-12
    assert np.abs(f("extension", extended)).max() < 1e-12
    assert (f("compression", extended) > 1e-3).all()
    angle = rng.uniform(0, 2 * np.pi, 1000)
    turned = np.cos(angle[:, None] + 2 * np.pi / 3 * np.arange(3))
    inside = f("inner", pressed + 0.05 * turned)
    assert -1e-4 < inside.max() < 1e-12
    tan = np.tan(np.radians(friction))
    P = DruckerPrager(E, NU, c, friction, dilation_angle=0.0, fit="plane strain").parameter_array()[
        0
    ]
    assert P[6] == pytest.approx(3 * tan / np.sqrt(9 + 12 * tan**2), rel=1e-14)
    assert P[7] == pytest.approx(3 / np.sqrt(9 + 12 * tan**2), rel=1e-14)
    assert P[8] == 0.0


def test_plane_strain_limit_of_associated_flow():
    """Flow without strain out of plane ends on Mohr–Coulomb's line."""
    c, friction = 1e3, 25.0
    law = DruckerPrager(E, NU, c, friction, dilation_angle=friction, fit="plane strain")
    stress, strain, internal = np.zeros((1, 3)), np.zeros((1, 3)), None
    for _ in range(400):
        # the mean stress in the plane is held by the tangent, as in a biaxial test
        trial = strain + np.array([2e-5, -2e-5, 0.0])
        for _ in range(30):
            answer = law.respond(trial, internal=internal)
            off = answer.stress[0, :2].sum() + 2e4
            if abs(off) < 1e-8:
                break
            trial[:, :2] -= off / answer.tangent[0, :2, :2].sum()
        strain, stress, internal = answer.strain, answer.stress, answer.internal
    assert mohr_coulomb(stress, c, friction)[0] == pytest.approx(0.0, abs=1e-6 * 2e4)


def test_without_friction_it_is_von_mises():
    answer = TRESCA_LIKE.respond([[0.1, 0.0, 0.0], [0.5, 0.4, 0.1]])
    assert np.sqrt(3) * root_of(answer.stress) == pytest.approx(2e3, rel=1e-13)
    assert answer.stress.mean(axis=1) == pytest.approx([3 * K * 0.1 / 3, K], rel=1e-13)


def test_hardening_is_linear_in_pure_shear():
    law = DruckerPrager(E, NU, 1e3, 0.0, dilation_angle=0.0, hardening=2e5)
    answer = law.respond([[0.01, -0.01, 0.0]])
    plastic = answer.internal[0, 0]
    assert root_of(answer.stress)[0] == pytest.approx(2 / np.sqrt(3) * (1e3 + 2e5 * plastic))
    again = law.respond(answer.strain, internal=answer.internal)
    assert again.stress == pytest.approx(answer.stress, rel=1e-13)
    assert again.internal == pytest.approx(answer.internal, rel=1e-12)


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3)
    | st.floats(-0.3, 0.3).map(lambda a: [a] * 3),
    st.sampled_from(LAWS),
)
def test_order_does_not_matter(strain, law):
    orders = np.array(list(itertools.permutations(range(3))))
    answer = law.respond(np.array(strain)[orders])
    size = E * max(map(abs, strain)) + 1e-300
    for k, order in enumerate(orders):
        assert np.abs(answer.stress[k] - answer.stress[0][order]).max() <= 1e-13 * size
        if root_of(answer.stress[:1])[0] > 1e-9 * size:
            turned = answer.tangent[0][np.ix_(order, order)]
            assert np.abs(answer.tangent[k] - turned).max() <= 1e-5 * E


def test_parameters_may_vary():
    law = DruckerPrager(
        E, NU, lambda x: 1e3 * (1 + x[0]), np.array([20.0, 30.0]), dilation_angle=10.0
    )
    strain = np.array([[0.01, -0.02, 0.003]] * 2)
    answer = law.respond(strain, x=np.array([[0.0, 0.0], [1.0, 0.0]]))
    for k, (c, friction) in enumerate(((1e3, 20.0), (2e3, 30.0))):
        alone = DruckerPrager(E, NU, c, friction, dilation_angle=10.0).respond(strain[:1])
        assert np.array_equal(alone.stress[0], answer.stress[k])


def test_errors():
    with pytest.raises(ParameterError, match="dilation_angle = 31 degrees must not be larger than"):
        DruckerPrager(E, NU, 0.0, 30.0, dilation_angle=31.0)
    with pytest.raises(ParameterError, match='"inner"'):
        DruckerPrager(E, NU, 0.0, 30.0, dilation_angle=0.0, fit="outer")
    with pytest.raises(ParameterError, match="cohesion = -1"):
        DruckerPrager(E, NU, -1.0, 30.0, dilation_angle=0.0)
    with pytest.raises(ParameterError, match="friction_angle = 91"):
        DruckerPrager(E, NU, 1.0, 91.0, dilation_angle=0.0)
    for bad in (np.inf, -np.inf, np.nan):
        with pytest.raises(StateError, match="DruckerPrager finds no stress at point 1"):
            LAWS[0].respond([[0.0, 0.0, 0.0], [0.0, bad, 0.0]])
    assert "fit='inner'" in repr(LAWS[3])


def test_a_cone_of_sand_whose_stiffness_varies():
    """Drucker–Prager's kernel takes numbers that follow from the parameters, point by point."""
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    sand = mpm.materials.sand(0.44)
    parts = []
    for E in (1e6, lambda x: np.full(x.shape[1], 1e6)):
        law = mpm.materials.DruckerPrager(E=E, **sand.parameters)
        F = mpm.momentum(law, points, V.increment, V.test)
        bcs = mpm.fixed(V, "bottom")
        problem = mpm.QuasiStatic(F, V.increment, points, bcs)
        operator = problem.operator()
        x = np.linspace(-1e-3, 1e-3, operator.here.unknowns.owned)
        parts.append(operator.residual(x).values)
    assert np.abs(parts[0]).max() > 0
    np.testing.assert_allclose(parts[1], parts[0], rtol=1e-12)
