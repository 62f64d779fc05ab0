"""A screw pile and a drag anchor, over some steps."""

from __future__ import annotations

import pytest
from conftest import figures_of


def run(study, *options):
    return figures_of(f"demos/studies/{study}.py", "--json", "-", *options)


@pytest.mark.long
def test_a_screw_pile_that_is_turned_too_much_pulls_itself_down(tmp_path):
    options = "--ratios", "0.5", "--turn", "30", "--step", "10", "--sides", "12"
    (figures,) = run("screw_pile", *options, "--output", str(tmp_path))["runs"]
    assert figures["force"] < 0 < figures["torque"]
    # the work that is put in is dissipated, not gained
    assert figures["work"] > 0
    assert (tmp_path / "screw_pile.png").stat().st_size > 0


def test_a_drag_anchor_finds_its_attitude(tmp_path):
    figures = run("drag_anchor", "--way", "0.1", "--output", str(tmp_path))
    way, depth, tension, inclination, angle = figures["curve"]
    assert len(way) == 4
    assert depth[-1] > depth[0]
    # it pitches towards the angle that the line asks for
    assert inclination[0] > inclination[-1] > figures["inclination_predicted"] - 5
    assert 10e3 < min(tension) < max(tension) < 100e3
    assert 20 < min(angle) < max(angle) < 45
    assert (tmp_path / "drag_anchor.png").stat().st_size > 0
