"""NorSand: tangents, robustness, the critical state, dilatancy, and an independent integration."""

from __future__ import annotations

import numpy as np
import pytest
from laws import central_differences, check_finite
from scipy.integrate import solve_ivp

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials import NorSand
from dolfinmpm.study import element_test

P = 390e3
# Brasted sand (Andrade & Ellison 2008, Journal of Geotechnical and Geoenvironmental Engineering
# 134); Γ is e on the critical state line at 1 kPa
SAND = {
    "swelling": 0.0015, "mu0": 45e6, "alpha": 0.0, "reference_pressure": P, "M": 1.27, "N": 0.4,
    "chi": 3.5, "hardening": 120.0, "critical_void_ratio": 0.8911, "critical_slope": 0.02,
}  # fmt: skip
CRITICAL = 0.8911 - 0.02 * np.log(P / 1e3)
DENSE, LOOSE = CRITICAL - 0.12, CRITICAL + 0.04


def tip(N):
    """p/p_i of stresses without shear on the surface."""
    return np.e if N == 0.0 else (1 - N) ** ((N - 1) / N)


def sand(void_ratio=DENSE, **more):
    given = SAND | {"void_ratio": void_ratio} | more
    return NorSand(**{"image_pressure": P / tip(given["N"])} | given)


LAWS = [
    sand(),
    sand(LOOSE),
    sand(N=0.0),
    sand(N=0.0, void_ratio=0.55, hardening=400.0, swelling=0.005),
    sand(LOOSE, N=0.3, mu0=0.0, alpha=60.0, swelling=0.01, image_pressure=3 * P),
    sand(extension=0.7),
    sand(LOOSE, extension=0.75, N=0.2, mu0=5e6, alpha=20.0, swelling=0.01),
    sand(mu0=5e6, alpha=20.0, swelling=0.01, reference_strain=-0.01),
]
ANY = pytest.mark.parametrize("law", LAWS, ids=range(len(LAWS)))


@ANY
def test_tangents_are_derivatives_and_stresses_are_admissible(law):
    """For strains up to 2 %, on the whole surface and at its tip."""
    rng = np.random.default_rng(3)
    strains = rng.uniform(-0.01, 0.01, (600, 3)) + rng.uniform(-0.012, 0.004, (600, 1))
    strains[::6, 1:] = strains[::6, :1]
    strains[1::6, 2] = strains[1::6, 1]
    found = law.respond(strains)
    check_finite(found)
    parameters = law.parameter_array()
    f = law.yield_function(found.stress, found.internal, parameters)
    yielded = (found.strain != strains).any(axis=1)
    assert 0.3 < yielded.mean() < 1.0
    size = np.abs(found.stress).max(axis=1)
    assert (f <= 1e-12 * (size + P)).all()
    flat = np.ptp(found.stress, axis=1) <= 1e-12 * size
    assert np.abs(f / (size + P))[yielded & ~flat].max() < 1e-12
    differences, ends = central_differences(law, strains, 1e-7)
    smooth = np.ones(len(strains), bool)
    for moved, there in ends:
        smooth &= (there.strain != moved).any(axis=1) == yielded
        smooth &= (np.ptp(there.stress, axis=1) <= 1e-5 * size) == flat
    error = np.abs(differences - found.tangent).max(axis=(1, 2))
    error /= np.abs(found.tangent).max(axis=(1, 2))
    # below 1 Pa the differences are rounding
    assert smooth.mean() > 0.7
    assert error[smooth & (size > 1.0)].max() < 1e-6


@pytest.mark.parametrize("N", [0.0, 0.4])
def test_a_step_far_beyond_the_surface_yields(N):
    """Compression by 6 % in one step: ln p of the trial state is larger by 40."""
    law = sand(LOOSE, N=N)
    strains = np.array([[-0.023, -0.008, -0.027], [-0.02, -0.02, -0.02], [-0.03, -0.03, 0.0]])
    found = law.respond(strains)
    f = law.yield_function(found.stress, found.internal, law.parameter_array())
    assert (np.abs(f) <= 1e-12 * np.abs(found.stress).max(axis=1)).all()
    assert (found.internal[:, 0] > 10 * law.image_pressure).all()
    assert (found.strain.sum(axis=1) > 0.5 * strains.sum(axis=1)).all()


def rates(law, undrained):
    """Rates by the axial strain of (p, q, p_i, e): the law's equations, with powers of p/p_i."""
    M, N, chi, h = law.M, law.N, law.chi, law.hardening

    def rate(_, state):
        p, _, pi, e = state
        r = (p / pi) ** (N / (1 - N))
        D = M / N * (r - 1)
        psi = e - law.critical_void_ratio + law.critical_slope * np.log(pi / 1e3)
        last = p * (1 + N * chi * psi / M) ** ((N - 1) / N)
        K, G = p / law.swelling, law.mu0
        # unknowns: volume strain (compression), plastic shear strain
        stiff = np.array([[D * K - G, -(K * D**2 + 3 * G + M * r * p / pi * h * (last - pi))]])
        rows = np.vstack([stiff, [[1.0, 0.0]]])
        right = [-3 * G, 0.0]
        if not undrained:
            rows[1] = [-G - 3 * K, -3 * G + 3 * K * D]
            right[1] = -3 * G
        volume, plastic = np.linalg.solve(rows, right)
        # shear strain = axial strain less a third of the volume strain
        shear = 1 - volume / 3
        return [K * (volume - D * plastic), 3 * G * (shear - plastic),
                h * (last - pi) * plastic, -(1 + e) * volume]  # fmt: skip

    return rate


@pytest.mark.parametrize("undrained", [False, True])
@pytest.mark.parametrize("e", [DENSE, LOOSE])
def test_triaxial_paths_are_those_of_the_rate_equations(e, undrained):
    """Against an integration by scipy of the published equations; the error falls with steps."""
    law, name = sand(e), "undrained triaxial" if undrained else "triaxial"
    start = [P, 0.0, P / tip(law.N), e]
    ends = np.linspace(0.0, 0.1, 6)[1:]
    exact = solve_ivp(rates(law, undrained), (0, 0.1), start, t_eval=ends, rtol=1e-9, atol=1e-9,
                      method="LSODA").y  # fmt: skip
    errors = []
    for steps in (100, 400):
        test = element_test(law, name, -0.1, pressure=P, strain="small", steps=steps)
        pick = np.searchsorted(-np.array(test["strain_yy"]), ends - 1e-9)
        found = [np.array(test[k])[pick] for k in ("p", "q", "image_pressure", "void_ratio")]
        scale = np.abs(exact).max(axis=1, keepdims=True)
        errors.append(np.abs((np.array(found) - exact) / scale).max())
    assert errors[1] < 0.01, errors
    assert errors[1] < 0.35 * errors[0], errors


@pytest.mark.parametrize("e", [DENSE, LOOSE])
def test_the_critical_state(e):
    """Loose and dense sand end at η = M and e = e_c(p), drained and undrained."""
    law = sand(e)
    test = element_test(law, "triaxial", -1.5, pressure=P, strain="small", steps=150)
    assert test["q"][-1] / test["p"][-1] == pytest.approx(1.27, rel=1e-3)
    critical = 0.8911 - 0.02 * np.log(test["p"][-1] / 1e3)
    assert test["void_ratio"][-1] == pytest.approx(critical, abs=1e-3)
    if e == LOOSE:
        test = element_test(law, "undrained triaxial", -2.5, pressure=P, strain="small")
        critical = 1e3 * np.exp((0.8911 - e) / 0.02)
        assert test["p"][-1] == pytest.approx(critical, rel=1e-3)
        assert test["q"][-1] == pytest.approx(1.27 * critical, rel=1e-3)
        assert test["q"].max() > 2 * test["q"][-1]  # static liquefaction
    else:
        # the peak is above the critical state
        assert test["q"].max() > 1.2 * test["q"][-1]


@pytest.mark.parametrize("N", [0.0, 0.4])
def test_dilatancy_follows_stress_and_its_limit_the_state_parameter(N):
    """At constant p: Δε_vᵖ/Δε_sᵖ = (η − M)/(1 − N) in each step, and χ ψ_i at the peak."""
    law = sand(N=N)
    path = [{"strain": {"yy": -0.1, "xx-zz": None}, "stress": {"mean": None}, "steps": 400}]
    test = element_test(law, path, pressure=P, strain="small")
    ratio = np.array(test["q"]) / P
    volume = np.diff(np.log(1 + np.array(test["reference_void_ratio"])))
    strain = np.array(test["strain_yy"]) - np.array(test["volume_strain"]) / 3
    shear = -np.diff(strain) - np.diff(test["q"]) / (3 * law.mu0)
    D = -volume / shear
    assert np.abs(D - (1.27 - ratio[1:]) / (1 - N)).max() < 1e-8
    psi = np.array(test["void_ratio"]) - 0.8911
    psi += 0.02 * np.log(np.array(test["image_pressure"]) / 1e3)
    peak = int(np.argmax(ratio))
    assert 10 < peak < 350
    assert D.min() == pytest.approx(law.chi * psi[peak], rel=2e-3)


def test_extension_has_its_own_critical_ratio():
    """Triaxial extension, compression, and plane shear between them."""
    law, found = sand(extension=0.7), []
    for to in (-1.5, 1.5):
        test = element_test(law, "triaxial", to, pressure=P, strain="small", steps=150)
        found.append(test["q"][-1] / test["p"][-1])
    assert found[0] == pytest.approx(1.27, rel=1e-3)
    assert found[1] == pytest.approx(0.7 * 1.27, rel=1e-3)
    strain = {"xy": 3.0, "xx-yy": None, "yy-zz": None}
    path = [{"strain": strain, "stress": {"mean": None}, "steps": 150}]
    test = element_test(law, path, pressure=P, strain="small")
    z0 = 0.7 * (2 / (1 + 0.7**4)) ** 0.25
    assert test["q"][-1] / test["p"][-1] == pytest.approx(z0 * 1.27, rel=1e-3)


def test_isotropic_compression_stays_at_the_tip():
    law = sand(N=0.2, swelling=0.005, hardening=200.0)
    test = element_test(law, "isotropic", -4 * P, by="stress", pressure=P, strain="small")
    assert np.abs(test["q"]).max() < 1e-6 * P
    place = np.array(test["p"]) / np.array(test["image_pressure"])
    assert place == pytest.approx(tip(0.2), rel=1e-9)
    unloaded = element_test(law, "isotropic", [-4 * P, -P], by="stress", pressure=P, strain="small")
    elastic = unloaded["volume_strain"][-1] - test["volume_strain"][-1]
    assert elastic == pytest.approx(0.005 * np.log(4), rel=1e-9)


def test_contradictions_are_refused():
    for given, words in (
        (
            {"image_pressure": 0.5 * P / tip(0.4)},
            "the tip = .* must be at least the first",
        ),
        ({"mu0": 0.0}, "mu0 = 0 must not be 0 together with alpha = 0"),
        ({"N": 1.0}, "N = 1.0 must be in"),
        ({"chi": -1.0}, "chi = -1.0 must be in"),
    ):
        with pytest.raises(ParameterError, match=words):
            sand(**given)
