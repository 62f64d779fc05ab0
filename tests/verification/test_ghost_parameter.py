"""The factor of a ghost penalty: local constants, and the deflection of a cantilever."""

from __future__ import annotations

import pytest
from conftest import figures_of

STUDY = "demos/studies/ghost_parameter.py"


@pytest.fixture(scope="module")
def figures():
    return figures_of(STUDY, "--json", "-", "--no-plot", "--depths", "4")


def test_adaptive_penalties_hold_their_target(figures):
    assert {row["nu"] for row in figures["constants"]} == {0.0, 0.3, 0.49, 0.495}
    for row in figures["constants"]:
        assert row["adaptive"] == pytest.approx(figures["target"], rel=0.02)


def test_they_hold_it_within_a_factor_of_two_in_soil_that_yields(figures):
    yielding = [row for row in figures["yielding"] if row["yielded"]]
    assert len({row["law"] for row in yielding}) == 7
    assert len(yielding) >= 20
    for row in yielding:
        assert 15.0 < row["least"] <= row["most"] < 60.0, row
        assert row["share_of_M"] > 0.1
    assert figures["worst_yielding"] < 2


# shares of an independent code for g = 1/90, 1/9, 1/3, 1
def test_a_cantilever_of_four_cells_is_not_stiffened(figures):
    (beam,) = figures["beams"]
    assert beam["default_by_hundredth"] == pytest.approx(1.0, abs=0.01)
    assert beam["share"][1:5] == pytest.approx([0.996, 0.964, 0.902, 0.762], rel=0.015)
    # what an adaptive penalty holds better it stiffens
    assert 0.9 < beam["adaptive"] < 0.95


def test_in_three_dimensions():
    figures = figures_of(
        STUDY, "--json", "-", "--no-plot", "--dimension", "3", "--depths", "2", "--factors", "0.01"
    )
    for row in figures["constants"]:
        assert row["adaptive"] == pytest.approx(30.0, rel=0.05)
    assert figures["worst_yielding"] < 2
