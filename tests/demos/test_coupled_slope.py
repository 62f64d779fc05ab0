"""A saturated slope, fast and slowly, between its drained and its undrained limit."""

from __future__ import annotations

import pytest
from test_porous_studies import study
from test_studies import run


def test_clay_without_drainage_fails_as_in_total_stresses():
    options = "--law", "cam-clay", "--rate", "fast", "--h", "1", "--steps", "10"
    found = study("coupled_slope", *options)
    assert abs(found["fast_error"]) < 0.07
    assert found["runs"]["fast"]["limit"] == pytest.approx(5.24, rel=0.07)
    # shear that wants to contract raises the pressure
    assert found["runs"]["fast"]["excess"][-1] > 1


@pytest.mark.long
def test_clay_that_contracts_fails_without_drainage_alone():
    """Drained it does what the soil does under the same pressure from outside."""
    found = study("coupled_slope", "--law", "cam-clay")
    fast, slow = (found["runs"][name] for name in ("fast", "slow"))
    assert abs(found["fast_error"]) < 0.03
    assert fast["limit"] == pytest.approx(fast["taylor"], rel=0.03)
    assert slow["limit"] is None
    assert found["slow_apart"] < 0.02
    assert abs(slow["excess"][-1]) < 0.01


@pytest.mark.long
def test_friction_without_drainage():
    """The mean stress of the plane stays: the strength in closed form."""
    found = study("coupled_slope", "--rate", "fast", "--surface-suction", "50")
    runs = found["runs"]
    assert runs["undrained"]["limit"] == pytest.approx(runs["undrained"]["taylor"], rel=0.01)
    assert abs(found["fast_error"]) < 0.05


@pytest.mark.long
def test_a_wet_slope_fails_sooner_when_it_is_loaded_slowly():
    found = study("coupled_slope", "--h", "0.5")
    fast, slow = (found["runs"][name] for name in ("fast", "slow"))
    assert abs(found["fast_error"]) < 0.05
    assert abs(found["slow_error"]) < 0.01
    assert fast["limit"] == pytest.approx(fast["taylor"], rel=0.06)
    assert slow["limit"] == pytest.approx(slow["taylor"], rel=0.1)


@pytest.mark.long
def test_a_wet_slope_fails_later(tmp_path):
    options = "--rate", "fast", "--load", "4", "--steps", "10", "--hold", "10", "--no-limits"
    found = run("coupled_slope", *options, "--output", str(tmp_path))["runs"]["fast"]
    assert found["limit"] is None
    assert 0.02 < found["failed_at"] < 1.0
    assert (tmp_path / "coupled_slope_held.png").stat().st_size > 0
