"""Every demo runs small, in a process of its own, and its figures hold."""

from __future__ import annotations

import csv

import pytest
from conftest import figures_of


def run(demo, *options, ranks=1):
    return figures_of(f"demos/{demo}.py", "--json", "-", *options, ranks=ranks)


@pytest.mark.parametrize("ranks", [1, 3])
def test_column_compaction(tmp_path, ranks):
    options = "--no-plot", "--elements", "16", "--columns", "2", "--points", str(tmp_path / "p.csv")
    figures = run("column_compaction", *options, ranks=ranks)
    assert figures["error"] == pytest.approx(3.6589e-3, rel=1e-4)
    assert figures["height"] == pytest.approx(24.0596, rel=5e-3)
    assert figures["max_newton_iterations"] <= 5
    assert (figures["points"], figures["steps"], figures["ranks"]) == (128, 40, ranks)
    for name in ("newton_iterations", "active_cells", "unknowns"):
        assert figures[name] > 0
    assert figures["seconds_setup"] > 0
    assert figures["seconds_solve"] > 0
    with (tmp_path / "p.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 128
    worst = max(abs(float(r["stress_yy"]) + 800 * (50 - float(r["Xy"]))) for r in rows)
    assert worst < 0.05 * 800 * 50


@pytest.mark.parametrize(
    "options",
    [
        "--dimension 3 --elements 8 --poisson 0.3 --ghost scaled",
        "--elements 10 --points-per-cell 3 --modulus 2e4 --density 100 --height 30 --steps 20",
        "--basis linear --elements 8 --ghost literal --gamma 2",
        "--gravity -0.5 --elements 16",
    ],
)
def test_column_compaction_otherwise(options):
    figures = run("column_compaction", "--no-plot", *options.split())
    assert figures["error"] < (0.2 if figures["basis"] == "linear" else 0.03)
    tolerance = 0.1 if figures["basis"] == "linear" else 0.02
    assert figures["height"] == pytest.approx(figures["height_exact"], rel=tolerance)


def test_pictures_and_files(tmp_path):
    run("column_compaction", "--elements", "8", "--output", str(tmp_path))
    for name in ("column_compaction.png", "column_compaction_points.png", "column_compaction.pvd"):
        assert (tmp_path / name).stat().st_size > 0


def test_conditioning():
    figures = run("conditioning", "--no-plot")
    assert figures["worst"]["kappa_K"] == pytest.approx(287, rel=0.01)
    assert figures["worst"]["kappa_M"] == pytest.approx(37.2, rel=0.01)
    assert figures["worst"]["dt_consistent"] == pytest.approx(0.575, rel=0.01)
    assert len(figures["places"]) == 14
    options = "--dimension 2 --basis linear --stabilisation aggregation --offsets 5 --spacing 0.1"
    turned = run("conditioning", "--no-plot", *options.split())
    assert len({place["angle"] for place in turned["places"]}) == 5
    assert turned["worst"]["kappa_K"] < 1e4


def test_compaction_compared():
    options = "--elements 8 --bases gimp,bspline2 --remedies none,ghost,aggregation"
    runs = run("compaction_compared", "--no-plot", *options.split())["runs"]
    assert len(runs) == 6
    errors = {(r["basis"], r["remedy"]): r["error"] for r in runs}
    assert all(r["completed"] for r in runs)
    for basis in ("gimp", "bspline2"):
        for remedy in ("ghost", "aggregation"):
            assert errors[basis, remedy] <= 1.05 * errors[basis, "none"]
    assert errors["bspline2", "none"] < errors["gimp", "none"]


def test_benchmark():
    figures = run("benchmark", "--repeat", "1", "--cases", "1x16")
    case = figures["cases"]["gimp 1x16"]
    assert case["points"] == 64
    assert case["newton_iterations"] == 125
    assert case["seconds"] > 0
