"""The study of a slope's factor of safety, in a process of its own."""

from __future__ import annotations

import csv

import pytest
from conftest import figures_of


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_factor_of_safety(tmp_path, ranks):
    options = ["--h", "2", "--low", "1.35", "--high", "1.55", "--tolerance", "0.1"]
    study, folder = "demos/studies/factor_of_safety.py", ("--output", str(tmp_path))
    figures = figures_of(study, *options, *folder, "--json", "-", ranks=ranks)
    # 2 m are coarse: five cells over the height
    assert figures["bracket"] == pytest.approx([1.35, 1.45])
    assert figures["factor"] == pytest.approx(1.4)
    assert figures["error"] == pytest.approx(figures["factor"] / 1.4 - 1)
    assert figures["ranks"] == ranks
    with (tmp_path / "factor_of_safety.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(figures["trials"]) == 3
    assert (tmp_path / "factor_of_safety.png").stat().st_size > 0
