"""Studies of bodies of revolution, in processes of their own, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import figures_of
from scipy.interpolate import PchipInterpolator


def run(name, *options, ranks=1):
    return figures_of(f"demos/studies/{name}.py", *options, "--json", "-", ranks=ranks)


def cavity(options, ranks=1):
    return run("cavity_expansion", "--no-plot", *options.split(), ranks=ranks)


def error(figures):
    return abs(figures["pressure"] / figures["pressure_exact"] - 1)


def within(figures, share):
    for name in ("pressure", "outer_radius", "stretch", "hoop_stress"):
        if figures[f"{name}_exact"] is not None:
            assert figures[name] == pytest.approx(figures[f"{name}_exact"], rel=share), name


# p/E, r(b)/a, λ_r(a), σ_θ(a)/E by the equations of a shell, integrated elsewhere
CYLINDER = (0.130556, 2.360440, 0.753255, 0.338395)
SPHERE = (0.255314, 2.618023, 0.405772, 0.500658)


def test_a_hencky_cylinder():
    figures = cavity("--steps 5")
    names = ("pressure_exact", "outer_radius_exact", "stretch_exact", "hoop_stress_exact")
    np.testing.assert_allclose([figures[name] for name in names], CYLINDER, rtol=3e-6)
    within(figures, 0.01)
    assert figures["inner_radius"] == pytest.approx(1.5, rel=1e-9)
    # F_θθ = r/R
    assert figures["hoop_stretch_error"] < 1e-13


@pytest.mark.parametrize("shape", ["cylinder", pytest.param("sphere", marks=pytest.mark.long)])
def test_linear_functions_are_of_second_order(shape):
    options = f"--shape {shape} --basis gimp --ratio 1.3 --steps 2"
    coarse, fine = (error(cavity(f"{options} --h {h}")) for h in (0.25, 0.125))
    assert fine < 5e-3
    assert np.log2(coarse / fine) > 1.5


def test_a_cavity_in_clay_whose_points_keep_mean_volumes():
    """Points that follow the mean volumes of F-bar find the exact pressure."""
    options = "--law tresca --ratio 2 --configuration updated --fbar volumes --rigidity-index 50"
    figures = cavity(options)
    assert figures["pressure_exact"] == pytest.approx(4.629335, rel=1e-6)
    assert error(figures) < 5e-3


def test_a_hencky_sphere_past_its_limit_point(tmp_path):
    figures = run(
        "cavity_expansion", "--shape", "sphere", "--ratio", "2", "--steps", "8", "--h", "0.25",
        "--output", str(tmp_path),
    )  # fmt: skip
    names = ("pressure_exact", "outer_radius_exact", "stretch_exact", "hoop_stress_exact")
    np.testing.assert_allclose([figures[name] for name in names], SPHERE, rtol=3e-6)
    within(figures, 0.02)
    assert figures["pressure"] < max(figures["pressures"]) - 0.01
    assert error(figures) < 1e-3
    assert (tmp_path / "cavity_expansion_sphere_hencky.png").stat().st_size > 0


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "p"),
    [
        ("--ratio 1.1", 0.045001), ("--ratio 2", 0.148870), ("--outer 5", 0.224973),
        ("--poisson 0", 0.137664), ("--shape sphere --ratio 1.1", 0.104565),
        ("--shape sphere", 0.267039), ("--shape sphere --ratio 2", 0.255314),
        ("--shape sphere --outer 5", 0.434743), ("--shape sphere --stabilisation aggregation",
        0.267039), ("--configuration updated", 0.130556),
        ("--shape sphere --configuration updated", 0.267039),
    ],
)  # fmt: skip
def test_every_shell_within_one_per_cent(options, p):
    figures = cavity(options)
    assert figures["pressure_exact"] == pytest.approx(p, rel=1e-5)
    within({**figures, "stretch": figures["stretch_exact"]}, 0.02)
    assert figures["pressure"] == pytest.approx(p, rel=0.01)
    assert figures["outer_radius"] == pytest.approx(figures["outer_radius_exact"], rel=0.01)


@pytest.mark.parametrize(
    ("options", "p"),
    [
        ("--rigidity-index 50 --ratio 1.2 --steps 8", 3.7314),
        ("--outer 10 --ratio 1.5 --steps 10", 3.8067),
        ("--shape sphere --ratio 1.05 --h 0.25 --steps 4", 4.8183),
    ],
)
def test_clay_around_a_cavity(options, p):
    figures = cavity(f"--law tresca {options}")
    assert figures["pressure_exact"] == pytest.approx(p, abs=1e-4)
    assert error(figures) < 0.04


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "p"),
    [
        ("--ratio 5", 5.5668), ("--outer 10 --ratio 3", 2.4849),
        ("--shape sphere --outer 10 --ratio 2", 6.3704),
        ("--shape sphere --ratio 1.2 --rigidity-index 50", 5.4035),
    ],
)  # fmt: skip
def test_clay_further_on(options, p):
    figures = cavity(f"--law tresca {options}")
    assert figures["pressure_exact"] == pytest.approx(p, abs=1e-4)
    assert error(figures) < 0.01


@pytest.mark.long
def test_a_cavity_on_two_ranks():
    options = "--shape sphere --h 0.25 --steps 2"
    one, two = cavity(options), cavity(options, ranks=2)
    assert two["ranks"] == 2
    for name in ("pressure", "outer_radius", "stretch", "hoop_stress"):
        assert two[name] == pytest.approx(one[name], rel=1e-8)


def test_a_thick_sphere_yields(tmp_path):
    options = ["--h", "0.0125", "--steps", "12", "--output", str(tmp_path)]
    figures = run("thick_shell", *options)
    # u_b of c = 100 ... 200 mm, and p (de Souza Neto and others 2008)
    u = np.array([0.02, 0.03456, 0.05488, 0.08192, 0.11664, 0.16]) * 1e-3
    p = np.array([0.14, 0.21295, 0.26663, 0.30368, 0.3255, 0.33271]) * 1e9
    yielded = [(w, q) for w, q in zip(figures["outer_displacement"], figures["pressure_exact"])
               if u[0] < w < u[-1]]  # fmt: skip
    assert len(yielded) > 5
    for w, q in yielded:
        assert q == pytest.approx(float(PchipInterpolator(u, p)(w)), rel=5e-3)
    assert figures["limit_load_exact"] == pytest.approx(p[-1], rel=1e-5)
    assert figures["max_pressure_error"] < 0.01
    assert figures["max_displacement_error"] < 0.01
    assert (tmp_path / "thick_sphere_of_rings.png").stat().st_size > 0


def test_a_tube_of_rings_yields():
    figures = run("thick_shell", "--no-plot", "--shape", "cylinder", "--steps", "16")
    assert figures["limit_load_exact"] == pytest.approx(0.19209e9, rel=1e-4)
    assert figures["max_pressure_error"] < 0.01


@pytest.mark.parametrize(("rough", "factor"), [("off", 5.69), ("on", 6.05)])
def test_a_circular_footing(rough, factor, tmp_path):
    options = ["--h", "0.1", "--width", "3", "--depth", "2", "--steps", "8"]
    figures = run("circular_footing", "--rough", rough, *options, "--output", str(tmp_path))
    assert figures["factor_exact"] == factor
    # of a disc that is as wide as it and half a cell
    assert figures["factor"] == pytest.approx(factor * 1.05**2, rel=0.04)
    assert figures["load"] == pytest.approx(figures["factor"] * 1e4 * np.pi, rel=1e-9)
    assert (tmp_path / f"circular_footing_{rough}.png").stat().st_size > 0


@pytest.mark.long
@pytest.mark.parametrize("rough", ["off", "on"])
def test_a_circular_footing_within_four_per_cent(rough):
    figures = run("circular_footing", "--no-plot", "--rough", rough)
    assert abs(figures["error"]) < 0.04
    # the ground flows
    assert figures["factors"][-1] < 1.01 * figures["factors"][-4]


@pytest.mark.long
def test_a_round_column_collapses(tmp_path):
    options = ["--h", "0.02", "--duration", "1.2", "--output", str(tmp_path)]
    figures = run("round_collapse", *options)
    assert figures["mass"] == pytest.approx(1600 * np.pi * 0.1**2 * 0.08, rel=1e-12)
    # all of the sand is under the surface
    assert figures["volume"] == pytest.approx(figures["mass"] / 1600, rel=1e-9)
    assert figures["unfused"] == ""
    assert 0.1 < figures["runout"] < 1.2
    assert 0.5 < figures["height"] < 0.81
    assert 0.02 < max(figures["kinetic"]) < 0.2
    assert (tmp_path / "round_collapse.png").stat().st_size > 0
