"""Hypoplasticity as a UMAT: exact states of the theory, and an independent integration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from umats import HOCHSTETTEN, NEEDS_FORTRAN, sand

import dolfinmpm as mpm

pytestmark = NEEDS_FORTRAN
I3 = np.eye(3)
PHI, HS, N_EXP, ED0, EC0, EI0, ALPHA, BETA, RADIUS, M_R, M_T, BETA_R, CHI, _ = HOCHSTETTEN
ROW = dict(zip(("xx", "yy", "zz", "xy", "yz", "xz"), zip((0, 1, 2, 0, 1, 0), (0, 1, 2, 1, 2, 2))))


def norm(a):
    return np.sqrt(np.sum(a * a))


def parts(T, e):
    """f_s L as a function of a tensor, and f_s f_d N; von Wolffersdorff (1996), by tensors."""
    sine = np.sin(np.radians(PHI))
    a = np.sqrt(3) * (3 - sine) / (2 * np.sqrt(2) * sine)
    trace = np.trace(T)
    hat = T / trace
    dev = hat - I3 / 3
    square = np.sum(dev * dev)
    tan_psi = np.sqrt(3 * square)
    cos3 = -np.sqrt(6) * np.trace(dev @ dev @ dev) / square**1.5 if square > 1e-24 else 1.0
    root = tan_psi**2 / 8 + (2 - tan_psi**2) / (2 + np.sqrt(2) * tan_psi * cos3)
    F = np.sqrt(root) - tan_psi / (2 * np.sqrt(2))
    ratio = np.exp(-((-trace / HS) ** N_EXP))
    ei, ec, ed = EI0 * ratio, EC0 * ratio, ED0 * ratio
    fd = ((e - ed) / (ec - ed)) ** ALPHA
    fe = (ec / e) ** BETA
    inner = 3 + a * a - a * np.sqrt(3) * ((EI0 - ED0) / (EC0 - ED0)) ** ALPHA
    fb = HS / N_EXP * (EI0 / EC0) ** BETA * (1 + ei) / ei * (-trace / HS) ** (1 - N_EXP) / inner
    size = np.sum(hat * hat)

    def L(D):
        return fb * fe / size * (F * F * D + a * a * hat * np.sum(hat * D))

    return L, fb * fe * fd * F * a / size * (hat + dev)


def rates(T, h, e, D, intergranular):
    """Rates of stress, intergranular strain and void ratio; Niemunis & Herle (1997)."""
    L, N = parts(T, e)
    de = (1 + e) * np.trace(D)
    if not intergranular:
        return L(D) + N * norm(D), 0 * h, de
    rho = norm(h) / RADIUS
    g = h / norm(h) if norm(h) > 0 else 0 * h
    along = np.sum(g * D)
    dT = (rho**CHI * M_T + (1 - rho**CHI) * M_R) * L(D)
    if along > 0:
        dT = dT + rho**CHI * ((1 - M_T) * L(g) + N) * along
        return dT, D - g * along * rho**BETA_R, de
    return dT + rho**CHI * (M_R - M_T) * L(g) * along, D, de


def integrated(stress, e, D, intergranular):
    """Stress and void ratio after a strain D along a straight path, to 1e-10."""

    def slope(_, y):
        T, h = y[:9].reshape(3, 3), y[9:18].reshape(3, 3)
        dT, dh, de = rates(T, h, y[18], D, intergranular)
        return np.concatenate([dT.ravel(), dh.ravel(), [de]])

    start = np.concatenate([np.asarray(stress, float).ravel(), np.zeros(9), [e]])
    done = solve_ivp(slope, (0, 1), start, method="LSODA", rtol=1e-11, atol=1e-13)
    assert done.success
    return done.y[:9, -1].reshape(3, 3), done.y[18, -1]


def tensors(test):
    sigma = np.zeros((len(test), 3, 3))
    for name, (i, j) in ROW.items():
        sigma[:, i, j] = sigma[:, j, i] = test[f"stress_{name}"]
    return sigma


@pytest.mark.parametrize("intergranular", [True, False])
@pytest.mark.parametrize(
    "strains",
    [
        {"yy": -0.02},
        {"yy": -0.02, "xx": 0.008, "zz": 0.009},
        {"xx": 0.0012, "yy": -0.002, "xy": 0.004},
    ],
    ids=["oedometer", "dilating", "sheared"],
)
def test_paths_are_those_of_an_independent_integration(strains, intergranular):
    law = sand(0.7, error=1e-9, R=RADIUS if intergranular else 0.0)
    # small strain: the axes do not turn
    leg = {"strain": {k: strains.get(k, 0.0) for k in ROW}, "steps": 4}
    test = mpm.study.element_test(law, [leg], pressure=100e3, strain="small")
    D = np.zeros((3, 3))
    for name, value in strains.items():
        i, j = ROW[name]
        D[i, j] = D[j, i] = value if i == j else value / 2
    T, e = integrated(-100e3 * I3, 0.7, D, intergranular)
    assert norm(tensors(test)[-1] - T) < 1e-6 * norm(T)
    assert abs(test["void_ratio"][-1] - e) < 1e-9


def test_isotropic_compression_from_the_loosest_state_follows_bauers_law():
    start = EI0 * np.exp(-((3 * 10e3 / HS) ** N_EXP))
    test = mpm.study.element_test(
        sand(start, error=1e-9, R=0.0), "isotropic", -1e6, by="stress", pressure=10e3, steps=20
    )
    exact = EI0 * np.exp(-((3 * test["p"] / HS) ** N_EXP))
    assert np.abs(test["void_ratio"] / exact - 1).max() < 1e-8


@pytest.mark.parametrize("void_ratio", [0.65, 0.95])
def test_triaxial_compression_goes_to_the_critical_state(void_ratio):
    p = 100e3
    law = sand(void_ratio, error=1e-7)
    test = mpm.study.element_test(law, "triaxial", -1.5, pressure=p, steps=150)
    sine = np.sin(np.radians(PHI))
    exact = 2 * sine / (1 - sine) * p
    ec = EC0 * np.exp(-(((2 * p + (exact + p)) / HS) ** N_EXP))
    assert abs(test["q"][-1] / exact - 1) < 0.01
    assert abs(test["void_ratio"][-1] / ec - 1) < 0.01
    if void_ratio < 0.9:
        assert test["q"].max() > 1.2 * exact  # dense sand has a peak, and dilates
        assert test["volume_strain"][-1] > 0


def test_reversal_gives_m_r_times_the_stiffness():
    """At a fresh intergranular strain and after a full reversal the stiffness is m_R L."""
    law = sand(0.7, error=1e-9)
    tiny, p = 1e-9, 100e3
    L, _ = parts(-p * I3, 0.7)
    test = mpm.study.element_test(law, "oedometer", -tiny, pressure=p, steps=1)
    D = np.diag([0, -1.0, 0])
    found = (tensors(test)[-1] + p * I3) / tiny
    np.testing.assert_allclose(found[1, 1], M_R * L(D)[1, 1], rtol=1e-4)
    # 20 R of strain make the intergranular strain swept out; then a small reversal
    swept = mpm.study.element_test(law, "oedometer", [-20 * RADIUS, -20 * RADIUS + 1e-8],
                                   pressure=p, steps=20)  # fmt: skip
    sigma = tensors(swept)
    L, _ = parts(sigma[20], swept["void_ratio"][20])
    # the last small step only; rates at a known state
    slope = (sigma[21] - sigma[20])[1, 1] / (1e-8 / 20)
    np.testing.assert_allclose(slope, M_R * L(-D)[1, 1], rtol=1e-3)


def test_stiffness_falls_with_strain_after_a_turn():
    test = mpm.study.element_test(sand(0.7), "undrained simple shear", [1e-2, 0.0], pressure=1e5)
    shear, gamma = test["stress_xy"], test["strain_xy"]
    back = np.diff(shear)[100:] / np.diff(gamma)[100:]
    assert back[0] > 2 * back[20]


def test_undrained_loose_sand_loses_strength_and_dense_sand_gains_it():
    loose, dense = (
        mpm.study.element_test(sand(e, R=0.0), "undrained triaxial", -0.1, pressure=200e3)
        for e in (0.93, 0.65)
    )
    assert loose["q"][-1] < 0.8 * loose["q"].max()
    assert dense["q"][-1] == dense["q"].max()
    assert loose["pore_pressure"][-1] > 0 > dense["pore_pressure"][-1]
