"""The studies of bodies with fields of their own that touch, at small sizes."""

from __future__ import annotations

import pytest
from conftest import figures_of


def figures(tmp_path, study, *options, ranks=1):
    where = "--output", str(tmp_path), "--json", "-"
    return figures_of(f"demos/studies/{study}.py", *options, *where, ranks=ranks)


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_two_cylinders(tmp_path, ranks):
    found = figures(tmp_path, "hertz_bodies", "--resolution", "4", ranks=ranks)
    assert abs(found["half_width_error"]) < 0.02
    assert abs(found["peak_error"]) < 0.04
    # diametral planes of whole cylinders do not stay plane
    assert abs(found["approach_error"]) < 0.05
    assert found["max_newton_iterations"] <= 8
    assert (tmp_path / "hertz_cylinders.png").stat().st_size > 0


@pytest.mark.long
@pytest.mark.parametrize(
    "options", [("--ratio", "5"), ("--friction", "0.4"), ("--basis", "bspline2")]
)
def test_two_cylinders_of_other_kinds(tmp_path, options):
    found = figures(tmp_path, "hertz_bodies", *options, "--no-plot")
    assert abs(found["half_width_error"]) < 0.02
    assert abs(found["peak_error"]) < 0.05


@pytest.mark.long
def test_two_spheres(tmp_path):
    options = "--shape", "sphere", "--resolution", "3", "--steps", "2"
    found = figures(tmp_path, "hertz_bodies", *options)
    assert abs(found["half_width_error"]) < 0.03
    assert abs(found["approach_error"]) < 0.1
    assert (tmp_path / "hertz_spheres.png").stat().st_size > 0


@pytest.mark.long
@pytest.mark.parametrize("mapping", ["flip", "pic"])
def test_discs_with_fields_of_their_own(tmp_path, mapping):
    """They touch when they should, and part, with momentum to rounding."""
    options = "--contact", "bodies", "--integrator", "newmark", "--mass", "consistent"
    found = figures(tmp_path, "colliding_discs", *options, "--mapping", mapping)
    assert found["time_of_min"] == pytest.approx(0.518, abs=0.01)
    assert 0.02 < found["min_kinetic"] < 0.053
    assert found["rebound"] == pytest.approx(0.908, abs=0.035)
    assert found["kinetic_below_99_percent"] - found["touch"] < 0.05
    assert found["momentum_drift"] < 1e-12
    assert found["energy_end"] < 1.0
    assert (tmp_path / "colliding_discs.png").stat().st_size > 0
