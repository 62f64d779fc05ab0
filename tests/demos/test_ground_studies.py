"""The studies of ground at small sizes: site response, a slope in an earthquake, a debris flow."""

from __future__ import annotations

import pytest
from conftest import figures_of


def figures(tmp_path, study, *options, ranks=1):
    where = "--output", str(tmp_path), "--json", "-"
    found = figures_of(f"demos/studies/{study}.py", *options, *where, ranks=ranks)
    assert (tmp_path / f"{study}.png").stat().st_size > 0
    return found


@pytest.mark.parametrize(
    "integrator", ["newmark", pytest.param("explicit", marks=pytest.mark.long)]
)
def test_a_layer_amplifies_waves_up_to_the_limit_of_the_grid(tmp_path, integrator):
    size = "--height", "5", "--duration", "1", "--integrator", integrator
    found = figures(tmp_path, "site_response", *size, "--courant", "0.2")
    assert found["errors"]["10"] < 0.02
    assert abs(found["missing_energy"]) < (1e-8 if integrator == "newmark" else 1e-3)


def test_a_slope_slips_like_the_sliding_block(tmp_path):
    size = "--depth", "4", "--duration", "2.5", "--h", "0.5", "--dt", "0.005"
    found = figures(tmp_path, "sliding_slope", *size)
    assert found["block"] > 0.01
    assert abs(found["error"]) < 0.05


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_debris_flow_keeps_volume_and_momentum(tmp_path, ranks):
    found = figures(tmp_path, "debris_flow", "--h", "5", "--duration", "2", ranks=ranks)
    assert abs(found["volume_error"]) < 1e-12
    assert found["momentum_error"] < 0.01
    # it slides down, by less than without friction
    assert 46.0 < found["front"] < 62.0


@pytest.mark.long
def test_debris_on_a_plane_has_the_velocity_of_a_block(tmp_path):
    size = "--bed", "plane", "--h", "5", "--duration", "3"
    found = figures(tmp_path, "debris_flow", *size, ranks=2)
    assert abs(found["block_error"]) < 0.03
    assert abs(found["work_error"]) < 0.02
    assert found["losses"]["friction"] > 0.3


def test_level_ground_between_free_field_sides_is_its_column(tmp_path):
    size = "--height", "10", "--h", "1", "--width", "2", "--duration", "0.7", "--courant", "0.4"
    found = figures(tmp_path, "free_field", "--parts", "level", *size)["level"]
    assert found["off_column"] < 1e-3
    assert found["vertical"] < 1e-3
    assert abs(found["missing_energy"]) < 1e-4


@pytest.mark.long
def test_waves_of_a_hill_leave_through_free_field_sides(tmp_path):
    found = figures(tmp_path, "free_field", "--parts", "hill")["hill"]
    assert found["errors"]["free field"] < 0.5 * found["errors"]["tied"]
