"""The studies of contact in 3D and between deformable bodies at small sizes."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import pytest
from conftest import figures_of

PLOUGH = "--h", "0.5", "--distance", "0.1", "--step", "0.1", "--tolerance", "1e-6"


def figures(tmp_path, study, *options, ranks=1):
    where = "--output", str(tmp_path), "--json", "-"
    return figures_of(f"demos/studies/{study}.py", *options, *where, ranks=ranks)


@functools.cache
def ploughed():
    """Figures of one rank."""
    with tempfile.TemporaryDirectory() as folder:
        found = figures(folder, "plough", *PLOUGH)
        assert (Path(folder) / "plough.png").stat().st_size > 0
        return found


@pytest.mark.long
def test_plough():
    """Sand is heaped up before the share, which needs more and more force."""
    found = ploughed()
    pull = found["pulls"]
    assert len(pull) == 3
    # at rest as much sand presses from behind as from the front
    assert abs(found["at_rest"]) < 0.01 * pull[-1]
    # more than Rankine's passive thrust on its width, which is 29 kN
    assert 40e3 < pull[1] < pull[2] < 200e3
    assert found["heaps"][-1] > found["heaps"][1] > 0.0
    assert found["halvings"] <= 4


@pytest.mark.long
def test_plough_with_cells_that_follow_it(tmp_path):
    """The pull is that on a graded grid, in balance to 1e-6."""
    found, graded = figures(tmp_path, "plough", *PLOUGH, "--refine", "--no-plot"), ploughed()
    pull = found["pulls"]
    assert abs(found["at_rest"]) < 0.01 * pull[-1]
    assert pull[1:] == pytest.approx(graded["pulls"][1:], rel=0.15)
    assert found["newton_iterations"] <= 8 * len(pull)
    assert found["halvings"] == 0


@pytest.mark.long
def test_plough_on_two_ranks(tmp_path):
    one, two = ploughed(), figures(tmp_path, "plough", *PLOUGH, "--no-plot", ranks=2)
    assert two["pulls"] == pytest.approx(one["pulls"], rel=1e-4, abs=10.0)
    assert two["heaps"] == pytest.approx(one["heaps"], rel=1e-4, abs=1e-6)


@pytest.mark.long
def test_discs_that_collide_as_bodies_of_their_own(tmp_path):
    options = "--integrator", "explicit", "--contact", "gap", "--h", "0.025", "--no-plot"
    found = figures(tmp_path, "colliding_discs", *options)
    assert found["kinetic_below_99_percent"] == pytest.approx(found["touch"], abs=0.03)
    assert found["min_kinetic"] == pytest.approx(0.053, abs=0.01)
    assert found["time_of_min"] == pytest.approx(0.518, abs=0.02)
    assert found["rebound"] == pytest.approx(0.9077, abs=0.03)
