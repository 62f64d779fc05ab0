"""The footing in three dimensions: factors beside iterations."""

from __future__ import annotations

import pytest
from test_studies import run


@pytest.mark.long
def test_factors_and_iterations_are_compared(tmp_path):
    options = "--compare", "--cells", "5,10", "--steps", "2"
    found = run("footing_3d", *options, "--output", str(tmp_path))
    assert [row["cells"] for row in found["rows"]] == [5, 10]
    for row in found["rows"]:
        assert row["apart"] < 1e-8
        assert row["ratio"] > 0
        assert min(row[name]["megabytes"] for name in ("factors", "iterations")) > 50
    coarse, fine = (row["error"] for row in found["rows"])
    assert fine == pytest.approx(0.5 * coarse)
    assert (tmp_path / "footing_3d_compared.png").stat().st_size > 0
