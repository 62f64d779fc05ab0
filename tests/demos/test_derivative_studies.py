"""Studies of derivatives, calibration and reliability, at small sizes."""

from __future__ import annotations

import pytest
from conftest import figures_of


def study(name: str, *options: str, ranks: int = 1) -> dict:
    return figures_of(f"demos/studies/{name}.py", "--json", "-", *options, ranks=ranks)


def test_derivatives_beside_whole_runs():
    (row,) = study("derivatives", "--cases", "elastic", "--no-plot")["rows"]
    assert row["error"] < 1e-7
    assert not row["notes"]


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, 2])
def test_permeability_from_pressures_and_settlements(ranks, tmp_path):
    options = ("--steps", "5", "--output", str(tmp_path))
    found = study("calibrate_permeability", *options, ranks=ranks)
    assert found["runs"] <= 8
    for name, value in {"permeability": 1e-5, "E": 1e6}.items():
        low, high = found["intervals"][name]
        assert low < value < high < 1.3 * low
    assert (tmp_path / "calibrate_permeability.png").exists()


@pytest.mark.long
def test_intervals_of_a_footing_contain_the_truth():
    """At 95 %, three of four sets of errors have each parameter inside with 0.986."""
    found = study("calibrate_footing", "--seeds", "4", "--no-plot")
    assert max(found["runs"]) <= 8
    assert min(found["counts"].values()) >= 3


@pytest.mark.long
def test_a_slope_is_safer_with_a_shorter_correlation_length():
    pytest.importorskip("openturns", reason="OpenTURNS is optional, and not installed")
    options = ("--lengths", "40,10", "--modes", "4", "--steps", "4", "--no-plot")
    far, near = study("slope_reliability", *options)["rows"]
    assert 1.5 < far["beta"] < near["beta"] - 0.1
    assert near["runs"] < 10


@pytest.mark.long
def test_the_modulus_that_an_indentation_tells():
    found = study("indentation", "--cells", "5", "--steps", "2", "--no-plot")
    assert found["by_dimensions"] < 1e-6
    assert max(found["apart"].values()) < 1e-5
    assert abs(found["missed"]) < 1e-5
    # in two steps the flow changes no digit of the force, which is told
    assert all(note.startswith("mobility: no figure changes") for note in found["notes"])


@pytest.mark.long
def test_points_that_yield_otherwise_at_another_poissons_ratio():
    found = study("cone_parameters", "--reach", "1e-3")
    assert any("points start or stop to yield" in note for note in found["kinks"])
    # between the kinks, differences of whole runs and the derivative agree
    near = found["differences"]["0.0001"]
    assert abs(near - found["elasticities"]["nu"]) < 1e-4
    assert abs(found["differences"]["0.001"] - near) > 1e-3
