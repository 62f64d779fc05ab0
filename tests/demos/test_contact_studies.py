"""The studies of contact at small sizes, each in a process of its own."""

from __future__ import annotations

import pytest
from conftest import figures_of


def figures(tmp_path, study, *options, ranks=1):
    where = "--output", str(tmp_path), "--json", "-"
    return figures_of(f"demos/studies/{study}.py", *options, *where, ranks=ranks)


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_plate_on_cube(tmp_path, ranks):
    options = "--stiffness-per-area", "3e5", "--h", "0.25", "--steps", "3", "--height", "0.9"
    found = figures(tmp_path, "plate_on_cube", *options, "--modulus", "2e5", ranks=ranks)
    assert found["height"] == pytest.approx(found["exact_height"], rel=1e-9)
    assert found["stress"] == pytest.approx(found["exact_stress"], rel=1e-8)
    assert found["max_newton_iterations"] <= 8
    assert (tmp_path / "plate_on_cube.png").stat().st_size > 0


def test_incline(tmp_path):
    found = figures(tmp_path, "incline", "--duration", "0.4", "--angle", "40")
    assert abs(found["displacement_error"]) < 0.01
    assert found["dissipated"] == pytest.approx(found["friction_times_slip"], rel=0.01)
    assert found["max_newton_iterations"] <= 8
    assert (tmp_path / "incline_block.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("shape", "friction", "angle", "within"),
    [
        ("disc", 0.5, 30, 0.02),
        pytest.param("disc", 0.1, 30, 0.02, marks=pytest.mark.long),
        pytest.param("sphere", 0.4, 45, 0.02, marks=pytest.mark.long),
        pytest.param("cylinder", 0.7, 60, 0.03, marks=pytest.mark.long),
    ],
)
def test_what_rolls(tmp_path, shape, friction, angle, within):
    options = "--shape", shape, "--friction", str(friction), "--angle", str(angle)
    found = figures(tmp_path, "incline", *options, "--duration", "0.4", "--no-plot")
    assert abs(found["displacement_error"]) < within
    assert found["max_newton_iterations"] <= 8


def test_hertz(tmp_path):
    found = figures(tmp_path, "hertz", "--force", "1000", "--resolution", "6")
    assert abs(found["force_error"]) < 1e-3
    assert abs(found["half_width_error"]) < 0.01
    assert abs(found["peak_error"]) < 0.05
    assert (tmp_path / "hertz_cylinder.png").stat().st_size > 0


def test_turned_block(tmp_path):
    found = figures(tmp_path, "turned_block", "--cells", "8", "--angles", "0,30", "--steps", "2")
    assert found["faces_8"] < 0.01
    assert found["corners_8"] > 1.0
    assert (tmp_path / "turned_block.png").stat().st_size > 0


@pytest.mark.long
def test_hertz_of_a_sphere(tmp_path):
    options = "--shape", "sphere", "--resolution", "4", "--steps", "1", "--no-plot"
    found = figures(tmp_path, "hertz", *options)
    assert abs(found["force_error"]) < 0.05
    assert abs(found["half_width_error"]) < 0.05


def test_retaining_wall(tmp_path):
    options = "--h", "0.25", "--length", "2", "--steps", "15"
    found = figures(tmp_path, "retaining_wall", *options)
    assert found["reached"]
    assert abs(found["thrust_error"]) < 0.05
    assert found["at_rest"] < 0.2 * found["thrust"]
    assert (tmp_path / "retaining_wall_passive.png").stat().st_size > 0


def test_a_wall_that_gives_way(tmp_path):
    """Corners that touched go along with the wall in the first iteration of a step."""
    options = "--h", "0.25", "--length", "2", "--steps", "10", "--direction", "active"
    found = figures(tmp_path, "retaining_wall", *options, "--no-plot")
    assert abs(found["thrust_error"]) < 0.05
    assert found["halvings"] <= 1


def test_wedge(tmp_path):
    options = "--h", "0.25", "--steps", "32", "--semi-angle", "45", "--points-per-cell", "2"
    found = figures(tmp_path, "wedge", *options)
    # four cells over the depth are coarse
    assert abs(found["slope_error"]) < 0.25
    assert found["lip"] == pytest.approx(found["exact_lip"], rel=0.25)
    assert (tmp_path / "wedge_45.png").stat().st_size > 0
