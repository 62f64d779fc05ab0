"""The studies of laws by element tests: published curves, and exact facts of each theory."""

from __future__ import annotations

import pytest
from conftest import figures_of
from umats import NEEDS_FORTRAN


def figures(tmp_path, study, *options):
    found = figures_of(
        f"demos/studies/{study}.py", *options, "--output", str(tmp_path), "--json", "-"
    )
    assert (tmp_path / f"{study}.png").stat().st_size > 0
    return found


@NEEDS_FORTRAN
def test_hypoplastic_sand_follows_the_published_curves_within_their_rounding(tmp_path):
    found = figures(tmp_path, "hypoplastic_sand", "--steps", "40")
    for error, allowed in zip(found["published_error"], found["rounding"]):
        assert error < allowed
    facts = found["facts"]
    assert facts["bauer"] < 1e-6
    assert facts["radius"] == pytest.approx(1.0, abs=1e-4)
    assert facts["m_R"] == pytest.approx(found["expected_m_R"], rel=1e-3)
    assert facts["m_T"] == pytest.approx(found["expected_m_T"], rel=1e-3)
    for name in ("dense", "loose"):
        assert facts["angle"][name] == pytest.approx(found["expected_angle"], abs=0.1)
        assert abs(facts["critical"][name]) < 2e-3


def test_norsand_has_the_peaks_and_ends_of_the_theory(tmp_path):
    found = figures(tmp_path, "norsand_paths", "--pressures", "250e3", "--states=-0.1,0.03")
    worst = found["worst"]
    assert worst["peak"] < 3e-3
    assert worst["end"] < 1e-3
    assert worst["void_ratio"] < 1e-3
    assert worst["residual"] < 5e-3
    # loose sand liquefies
    assert found["rows"][1]["brittle"] > 0.5


@pytest.mark.long
@NEEDS_FORTRAN
def test_damping_is_that_of_masings_rule(tmp_path):
    found = figures(tmp_path, "damping")
    assert found["error_stiffness"] < 1e-10
    assert found["error_damping"] < 1e-4
    assert found["off_published"]["stiffness"] < 0.03
