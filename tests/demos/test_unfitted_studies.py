"""Studies of boundaries that do not fit the grid, at small sizes."""

from __future__ import annotations

import pytest
from test_studies import run


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_nitsche_ring(ranks):
    options = ["--cells", "4,8,16", "--positions", "2", "--no-plot"]
    figures = run("nitsche_ring", *options, ranks=ranks)
    assert min(figures["orders"]) > 1.9
    assert figures["errors"][-1] == pytest.approx(2.2889e-4, rel=1e-3)
    assert figures["pressure"] == pytest.approx(1.0, abs=0.02)
    assert figures["kappa"] < 3e4
    assert figures["least"] > 0
    assert figures["ranks"] == ranks


@pytest.mark.long
def test_nitsche_ring_otherwise(tmp_path):
    options = "--cells", "4,8", "--offset", "1e-5", "--stabilisation", "aggregation"
    figures = run("nitsche_ring", *options, "--positions", "1", "--output", str(tmp_path))
    assert figures["orders"][0] > 1.9
    assert figures["penalties"][1] < 30
    assert (tmp_path / "nitsche_ring.png").stat().st_size > 0
    penalty = run("nitsche_ring", "--cells", "4,8", "--method", "penalty", "--no-plot")
    assert penalty["errors"][1] > 4 * figures["errors"][1]
    fixed = run(
        "nitsche_ring", *["--cells", "4", "--penalty", "4", "--positions", "6", "--no-plot"]
    )
    assert fixed["least"] < 0
