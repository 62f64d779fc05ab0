"""Consolidation against closed forms, at small sizes."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import figures_of


def study(name: str, *options: str, ranks: int = 1) -> dict:
    return figures_of(f"demos/studies/{name}.py", "--json", "-", "--no-plot", *options, ranks=ranks)


COLUMN = ("--h", "0.0625", "--steps", "100")


@pytest.mark.parametrize(
    ("options", "U", "base"),
    [
        pytest.param(
            ("--load", "1e-3", "--permeability", "constant"), 0.01, 0.005, marks=pytest.mark.long
        ),
        (("--load", "0.3"), 0.02, 0.01),
        pytest.param(("--load", "0.3", "--law", "xie-leo"), 0.02, 0.01, marks=pytest.mark.long),
        pytest.param(
            ("--load", "0.2", "--permeability", "kozeny-carman", "--pair", "bspline2-linear",
             "--h", "0.05"), 0.02, 0.01, marks=pytest.mark.long,
        ),
        (("--scene", "self-weight", "--load", "0.3", "--porosity", "0.4", "--permeability",
          "kozeny-carman"), 0.02, 0.01),
    ],
)  # fmt: skip
def test_a_layer_consolidates(options, U, base):
    figures = study("consolidation", *COLUMN, *options)
    assert figures["U_error"] < U
    assert figures["base_pressure_error"] < base
    assert figures["overshoot"] < 0.01
    assert figures["halvings"] == 0


def test_finite_differences_are_terzaghis_where_those_are_known():
    """The stretch obeys the linear heat equation: U is that of the linear theory."""
    figures = study("consolidation", "--h", "0.25", "--steps", "5", "--load", "0.2")
    M = (2 * np.arange(200) + 1) * np.pi / 2
    exact = [1 - np.sum(2 / M**2 * np.exp(-(M**2) * T)) for T in figures["times"]]
    np.testing.assert_allclose(figures["U_exact"], exact, atol=2e-4)
    assert figures["final_settlement"] == pytest.approx(0.15542, abs=1e-5)


def test_the_pressure_in_mandels_slab_rises_first():
    figures = study(
        "mandel", "--cells", "16", "--steps", "60", "--times", "0.05,0.1,0.5", "--poisson", "0.1"
    )
    for name in ("pressure_centre", "pressure_half", "u_x", "u_z"):
        assert figures[f"{name}_error"] < 0.01
    assert figures["pressure_centre"][0] > 0.5


def test_a_cylinder_drains_at_its_round_edge():
    figures = study("de_leeuw", "--cells", "12", "--steps", "40", "--times", "0.05,0.2,0.5")
    assert figures["centre_pressure_error"] < 0.02
    assert figures["u_r_error"] < 0.02


def test_a_strip_footing_settles():
    options = "--h", "0.5", "--steps", "20", "--times", "0.3,3"
    figures = study("footing_consolidation", *options)
    assert figures["compared"]
    for name in ("settlement_centre", "settlement_edge"):
        np.testing.assert_allclose(figures[name], figures[f"{name}_exact"], rtol=0.03)
    two = study("footing_consolidation", *options, ranks=2)
    np.testing.assert_allclose(two["settlement_centre"], figures["settlement_centre"], rtol=1e-8)


@pytest.mark.long
def test_iterations_of_a_footing_do_not_depend_on_what_flows():
    options = "--cells", "14", "--steps", "1", "--permeability", "1e-12,1e-5,1e-2"
    runs = study("footing_3d", *options)["runs"]
    means = [one["mean_iterations"] for one in runs]
    assert max(means) < 10
    assert max(means) - min(means) < 0.3 * (max(means) + min(means))
