"""The stability atlas: chosen seeds end as they must, again the same, and never twice."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from test_studies import run

STUDIES = Path(__file__).resolve().parents[2] / "demos" / "studies"
SLOPE = "--family", "slopes", "--basis", "gimp", "--stabilisation", "none,ghost", "--seed", "35"


def lines(folder):
    text = (folder / "stability_atlas.jsonl").read_text()
    return [json.loads(line) for line in text.splitlines() if line]


def test_a_slope_needs_its_stabilisation(tmp_path):
    found = run("stability_atlas", *SLOPE, "--output", str(tmp_path))
    assert found["success"] == {"none": 0.0, "ghost": 1.0}
    assert found["wrong"] == 0
    (failed,) = found["worst"]
    assert failed["outcome"] == "told why"
    # no balance is found, or the substeps become too many
    assert failed["reason"].startswith(("ConvergenceError", "iterations: more than"))
    assert failed["command"].endswith("--family slopes --basis gimp --stabilisation none")
    assert (tmp_path / "stability_atlas.png").stat().st_size > 0
    first = lines(tmp_path)
    assert len(first) == 2

    # a run that was killed in the middle of a line goes on, and what is there is not run again
    file = tmp_path / "stability_atlas.jsonl"
    kept = next(text for text in file.read_text().splitlines() if '"ghost"' in text)
    file.write_text(kept + "\n" + kept[:40])
    again = run("stability_atlas", *SLOPE, "--output", str(tmp_path), "--resume", "--no-plot")
    assert file.read_text().startswith(kept)
    assert file.read_text().count('"outcome": "to the end"') == 1
    # the same seed, the same figures
    rows = {row["stabilisation"]: row["iterations"] for row in again["table"]}
    for one in first:
        assert one["iterations"] / max(1, one["steps_done"]) == rows[one["stabilisation"]]


@pytest.mark.parametrize("seed", ["9170", "9192"])
def test_clay_slides_down_a_wall_in_cubic_splines(tmp_path, seed):
    """One row of points beside the wall had left functions free there, and halved the steps."""
    found = run(
        "stability_atlas", "--family", "slopes", "--basis", "bspline3", "--stabilisation", "ghost",
        "--seed", seed, "--output", str(tmp_path), "--no-plot",
    )  # fmt: skip
    assert found["success"] == {"ghost": 1.0}
    (row,) = found["table"]
    assert row["halvings"] == 0.0
    assert row["iterations"] < 8


def test_ranks_share_problems_and_agree(tmp_path):
    found = run(
        "stability_atlas", "--family", "slopes,bodies", "--basis", "linear", "--stabilisation",
        "ghost", "--seeds", "2", "--compare", "2", "--output", str(tmp_path), ranks=2,
    )  # fmt: skip
    assert found["compared"] == 2
    assert found["success"] == {"ghost": 1.0}
    assert sum("ranks" in one for one in lines(tmp_path)) == 2
    assert (tmp_path / "stability_atlas.png").stat().st_size > 0


@pytest.fixture
def studies(monkeypatch):
    monkeypatch.syspath_prepend(str(STUDIES))
    yield
    for name in [name for name in sys.modules if name.startswith("atlas_")]:
        del sys.modules[name]


class Places:
    """A rigid body that has moved and turned."""

    angle, position = np.array([90.0]), np.array([3.0, 0.0])


def test_points_inside_a_body(studies):
    from atlas_checks import inside_by
    from atlas_example import Rigid
    from atlas_shapes import rounded

    corners = np.array([(-2.0, -1.0), (2.0, -1.0), (2.0, 1.0), (-2.0, 1.0)])
    # turned by a right angle: 2 wide and 4 high about (3, 0)
    x = np.array([(3.0, 0.0), (3.9, 0.0), (3.0, 1.75), (4.1, 0.0), (5.0, 0.0)])
    assert inside_by(Rigid(Places, corners, 0.1), x) == pytest.approx([1.0, 0.1, 0.25, 0.0, 0.0])
    # fillets take the corners away, and nothing from the middle of an edge
    x = np.array([(3.9, 1.9), (3.9, 0.0)])
    outline = rounded(corners, 0.5)
    assert inside_by(Rigid(Places, outline, 0.1), x) == pytest.approx([0.0, 0.1])


def test_checks_find_what_is_wrong(studies):
    import atlas_slopes
    from atlas_checks import Checks
    from mpi4py import MPI

    example = atlas_slopes.build(atlas_slopes.draw(0), "linear", "ghost", MPI.COMM_SELF)
    checks, points = Checks(example), example.problem.points
    example.go(1)
    assert checks.step()
    assert checks.end()
    good = points["be"].copy()
    points["be"] = good * np.array([1.4, 0.7, 1.0, 1.0, 1.0, 1.0])
    assert not checks.end()
    assert checks.found.startswith("beyond the yield surface")
    points["be"] = good
    points["F"] = points["F"] * np.array([[1.0, 1.0], [-1.0, -1.0]])
    checks.found = ""
    assert not checks.step()
    assert checks.found.startswith("det F")
