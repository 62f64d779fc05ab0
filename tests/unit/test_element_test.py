"""Element tests against exact values, for every law of the library."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from umats import NEEDS_FORTRAN, umat

import dolfinmpm as mpm
from dolfinmpm.study import element_test

E, NU, P = 20e6, 0.3, 100e3
HENCKY = mpm.materials.Hencky(E, NU)
CLAY = {
    "swelling": 0.02, "compression": 0.1, "M": 1.2, "mu0": 5e6, "alpha": 0.0,
    "reference_pressure": P, "preconsolidation": 1.5 * P,
}  # fmt: skip


@pytest.mark.parametrize("strain", ["large", "small", "jaumann"])
def test_elastic_paths(strain):
    J = (lambda v: np.exp(v)) if strain == "large" else (lambda v: 1.0)
    one = element_test(HENCKY, "oedometer", -0.05, strain=strain, steps=10)
    M = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
    np.testing.assert_allclose(one["stress_yy"], M * one["strain_yy"] / J(one["strain_yy"]))
    two = element_test(HENCKY, "isotropic", -1e6, by="stress", strain=strain, steps=5)
    volume = two["volume_strain"]
    np.testing.assert_allclose(two["p"], -E / (3 - 6 * NU) * volume / J(volume), rtol=1e-9)
    np.testing.assert_allclose(two["p"], np.linspace(0, 1e6, 6), atol=1e-3)
    three = element_test(HENCKY, "triaxial", -0.02, strain=strain, steps=7)
    assert np.abs(three["stress_xx"]).max() < 1e-4
    np.testing.assert_allclose(three["strain_xx"], -NU * three["strain_yy"], atol=1e-12)
    four = element_test(HENCKY, "undrained simple shear", 0.01, strain="small", steps=3)
    np.testing.assert_allclose(four["stress_xy"], E / (2 + 2 * NU) * four["strain_xy"])


def test_pore_pressure_of_simple_shear_keeps_the_total_stress_across_it():
    """From K0 = 0.5 it had been that of a constant total stress along x: a suction."""
    clay = mpm.materials.CamClay(**CLAY)
    first = [-0.5 * P, -P, -0.5 * P]
    shear = element_test(clay, "undrained simple shear", 0.3, stress=first)
    assert shear["pore_pressure"] == pytest.approx(P + shear["stress_yy"])
    assert shear["pore_pressure"][-1] > 0.2 * P
    assert shear["stress_xx"][-1] < -0.6 * P
    drained = element_test(clay, "simple shear", 0.1, stress=first)
    assert np.abs(drained["pore_pressure"]).max() < 1e-3


def test_neo_hookean_under_simple_shear_and_tension():
    law = mpm.materials.NeoHookean(E, NU)
    mu = E / (2 + 2 * NU)
    sheared = element_test(law, "undrained simple shear", 0.5, steps=10)
    gamma = sheared["strain_xy"]
    np.testing.assert_allclose(sheared["stress_xy"], mu * gamma)
    np.testing.assert_allclose(sheared["stress_xx"], mu * gamma**2, atol=1e-6)
    pulled = element_test(law, "triaxial", 0.1, steps=5)
    assert np.abs(pulled["stress_xx"]).max() < 1e-6 * E
    J, radial = np.exp(pulled["volume_strain"]), np.exp(pulled["strain_xx"])
    lmbda = E * NU / ((1 + NU) * (1 - 2 * NU))
    np.testing.assert_allclose(mu * (radial**2 - 1) + lmbda * np.log(J), 0.0, atol=1e-6 * E)


def test_strengths_of_perfectly_plastic_laws():
    k = (1 + np.sin(np.pi / 6)) / (1 - np.sin(np.pi / 6))
    sand = mpm.materials.MohrCoulomb(E, NU, cohesion=1e3, friction_angle=30.0)
    cone = mpm.materials.DruckerPrager(E, NU, cohesion=1e3, friction_angle=30.0)
    clay = mpm.materials.Tresca(E, NU, 50e3)
    exact = (k - 1) * P + 2e3 * np.sqrt(k)
    # the cone goes through the edges of compression
    for law, q in ((sand, exact), (cone, exact), (clay, 1e5)):
        test = element_test(law, "triaxial", -0.1, pressure=P, strain="small", steps=30)
        np.testing.assert_allclose(test["q"][-1], q, rtol=1e-9)
        np.testing.assert_allclose(test["stress_xx"], -P, rtol=1e-9)
        # no dilation: only the elastic part of the strain changes the volume
        np.testing.assert_allclose(np.diff(test["volume_strain"])[-5:], 0.0, atol=1e-12)
    mises = mpm.materials.VonMises(E, NU, yield_stress=1e5, hardening=1e6)
    test = element_test(mises, "undrained triaxial", [-0.02, 0.02], pressure=P, strain="small")
    elastic = np.abs(test["q"]) / E * (2 + 2 * NU) / 3
    np.testing.assert_allclose(test["q"][100], 1e5 + 1e6 * test["plastic_strain"][100])
    assert test["plastic_strain"][100] == pytest.approx(0.02 - elastic[100])
    assert test["strain_yy"][-1] == pytest.approx(0.02)
    assert test["stress_yy"][-1] > -P


def test_cam_clay_goes_to_its_critical_state_and_down_its_compression_line():
    law = mpm.materials.CamClay(**CLAY)
    test = element_test(law, "triaxial", -0.8, pressure=P, strain="small", steps=200)
    exact = 3 * CLAY["M"] / (3 - CLAY["M"]) * P
    assert test["q"][-1] == pytest.approx(exact, rel=1e-3)
    assert test["q"][-1] / test["p"][-1] == pytest.approx(CLAY["M"], rel=1e-3)
    line = element_test(law, "isotropic", -8 * P, by="stress", pressure=P, strain="small")
    virgin = line["p"] > 1.6 * P
    slope = np.diff(line["volume_strain"][virgin]) / np.diff(np.log(line["p"][virgin]))
    np.testing.assert_allclose(slope, -CLAY["compression"], rtol=1e-6)
    undrained = element_test(law, "undrained triaxial", -0.3, pressure=P, strain="small")
    assert undrained["q"][-1] / undrained["p"][-1] == pytest.approx(CLAY["M"], rel=1e-2)
    # total mean stress is that of the cell and a third of the deviator
    np.testing.assert_allclose(
        undrained["p"] + undrained["pore_pressure"], P + undrained["q"] / 3, rtol=1e-8
    )


def test_a_law_in_ufl():
    def energy(e, K, G):
        return (K / 2 - G / 3) * sum(e) ** 2 + G * ufl.inner(e, e)

    K, G = E / (3 - 6 * NU), E / (2 + 2 * NU)
    law = mpm.materials.EnergyWithYield(energy, yield_stress=1e5, K=K, G=G)
    same = mpm.materials.VonMises(E, NU, yield_stress=1e5)
    tests = [element_test(one, "triaxial", -0.02, pressure=P, steps=10) for one in (law, same)]
    np.testing.assert_allclose(tests[0]["q"], tests[1]["q"], rtol=1e-8, atol=1e-3)


@NEEDS_FORTRAN
def test_a_umat_and_a_built_in_law_take_the_same_path():
    own = umat("mises.f", [E, NU, 1e5, 1e6], ["plastic_strain"])
    exact = mpm.materials.VonMises(E, NU, yield_stress=1e5, hardening=1e6)
    for path, to in (("triaxial", -0.05), ("simple shear", [0.1, -0.1])):
        a, b = (element_test(one, path, to, pressure=P, strain="jaumann") for one in (own, exact))
        for name in b.names:
            size = max(np.abs(b[name]).max(), 1e-6 * (P if "s" in name else 1))
            assert np.abs(a[name] - b[name]).max() < 1e-7 * size, (path, name)


def test_legs_of_ones_own_and_stress_control():
    legs = [
        {"strain": {"yy": None}, "stress": {"xx": -2e5, "zz": -1e5}, "steps": 3},
        {"strain": {"volume": 0.0, "xx-zz": None}, "stress": {"yy-xx": -3e5}, "steps": 4},
        {"stress": {"xy": 5e4}},
    ]
    test = element_test(HENCKY, legs, steps=5, strain="small")
    assert len(test) == 1 + 3 + 4 + 5
    assert (test["stress_xx"][3], test["stress_zz"][3]) == pytest.approx((-2e5, -1e5))
    assert test["strain_yy"][3] == pytest.approx(0.0, abs=1e-15)
    assert test["volume_strain"][7] == pytest.approx(0.0, abs=1e-15)
    assert test["stress_yy"][7] - test["stress_xx"][7] == pytest.approx(-3e5)
    np.testing.assert_allclose(np.diff(test["strain_xx"] - test["strain_zz"])[3:7], 0, atol=1e-15)
    assert test["stress_xy"][-1] == pytest.approx(5e4)


def test_cycles_of_an_elastic_law_close():
    test = element_test(HENCKY, "triaxial", [-2e5, 2e5] * 3 + [0.0], by="stress", pressure=P)
    assert test["strain_yy"][-1] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(test["stress_yy"][100] - test["stress_xx"][100], -2e5)


def test_a_path_beyond_the_strength_is_told():
    sand = mpm.materials.MohrCoulomb(E, NU, cohesion=1e3, friction_angle=30.0)
    with pytest.raises(mpm.errors.StateError, match="Prescribe strains"):
        element_test(sand, "triaxial", -5e5, by="stress", pressure=P, steps=10)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"path": "torsion"}, "oedometer"),
        ({"path": 3}, "list of legs"),
        ({"path": []}, "list of legs"),
        ({"path": [{"strains": {}}]}, "dictionary"),
        ({"path": [{"strain": {"rr": 1.0}}], "to": None}, "'rr'"),
        ({"path": [{"strain": {"xx": 1.0}, "stress": {"xx": 1.0}}], "to": None}, "7 conditions"),
        ({"path": [{}]}, "of their own"),
        ({"path": [{}], "to": None, "by": "stress"}, "by = 'stress' would do nothing"),
        ({"path": [{"strain": -0.01}], "to": None}, "by component"),
        ({"path": [{"stress": None}], "to": None}, "by component"),
        ({"path": [{"stress": {"volume": 1.0}}], "to": None}, "'volume' .a strain"),
        ({"path": [{"strain": {"mean": 1.0}}], "to": None}, "'mean' .a stress"),
        ({"path": [{"strain": {"xx-xx": 1.0}}], "to": None}, "'xx-xx'"),
        (
            {"path": [{"strain": {"xx-yy": 0.1, "yy-xx": 0.1, "zz": 0.0}}], "to": None},
            "strains of which one follows",
        ),
        (
            {"path": [{"stress": {"xx-yy": 1.0, "yy-zz": 1.0, "xx-zz": 3.0}}], "to": None},
            "stresses of which one follows",
        ),
        ({"to": []}, "turning points"),
        ({"to": "far"}, "turning points"),
        ({"by": "force"}, '"strain", "stress"'),
        ({"steps": 0}, "steps"),
        ({"law": 3}, "mpm.materials"),
        ({"stress": [1.0, 2.0]}, "three normal stresses"),
        ({"stress": [1.0, 2.0, 3.0], "pressure": 1.0}, "without a pressure"),
        ({"law": mpm.materials.NeoHookean(1e6, 0.3), "pressure": 1.0}, "no first stress"),
        ({"strain": "huge"}, "jaumann"),
    ],
)
def test_bad_arguments(change, told):
    given = {"law": HENCKY, "path": "triaxial", "to": -0.01} | change
    with pytest.raises(mpm.errors.ParameterError, match=told):
        element_test(given.pop("law"), given.pop("path"), given.pop("to"), **given)


@pytest.mark.parametrize("to", [np.float32(-0.01), np.array(-0.01), [np.float32(-0.01)]])
def test_numbers_of_numpy(to):
    found = element_test(HENCKY, "triaxial", to, steps=1)
    assert (
        found["q"][-1] == element_test(HENCKY, "triaxial", float(np.ravel(to)[0]), steps=1)["q"][-1]
    )
