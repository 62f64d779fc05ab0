"""The page of figures: its rows, what is stored, and that README says the same."""

from __future__ import annotations

import json
import re
import shutil

import pytest
from conftest import ROOT, start

DOCS = ROOT / "docs"


@pytest.fixture
def benchmarks(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    import benchmarks

    return benchmarks


def test_rows_name_studies_that_there_are(benchmarks):
    names = [row.name for row in benchmarks.ROWS]
    assert len(set(names)) == len(names) > 30
    for row in benchmarks.ROWS:
        for command in row.commands:
            assert (ROOT / command.rpartition("python3 ")[2].split()[0]).is_file()


def test_every_row_has_figures_and_the_page_shows_them(benchmarks):
    stored = json.loads((DOCS / "benchmarks.json").read_text())
    page = (DOCS / "benchmarks.md").read_text()
    taken = benchmarks.load(DOCS / "benchmarks.json")
    assert taken.keys() == stored.keys()
    for row in benchmarks.ROWS:
        if row.name in taken:
            assert f"| {benchmarks.shown(row, taken[row.name].figures)}" in page
        else:
            assert f"| {row.claim} | not taken yet |" in page
    for one in taken.values():
        assert benchmarks.origin(one.commit, one.machine) in page


def test_a_part_of_the_page_has_one_table(benchmarks):
    parts = re.findall("^## (.*)$", (DOCS / "benchmarks.md").read_text(), re.MULTILINE)
    assert len(parts) == len(set(parts)) > 10


def test_readme_has_at_most_eight_figures_and_they_are_those_of_the_page(benchmarks):
    taken = benchmarks.load(DOCS / "benchmarks.json")
    part = (ROOT / "README.md").read_text().split("## Measured")[1].split("\n## ")[0]
    lines = [line.split(" | ") for line in part.splitlines() if line.startswith("| ")][1:]
    assert 0 < len(lines) <= 8
    for _, ours, _, command in lines:
        command = re.findall("`(.*)`", command)[0]
        rows = [row for row in benchmarks.ROWS if command in row.commands and row.name in taken]
        assert any(ours in benchmarks.shown(row, taken[row.name].figures) for row in rows), ours


def test_one_row_is_run_and_the_others_stay(tmp_path, benchmarks):
    for name in ("benchmarks.json", "benchmarks.md"):
        shutil.copy(DOCS / name, tmp_path)
    before = benchmarks.load(tmp_path / "benchmarks.json")
    options = "--only", "cuts-ghost", "--commit", "abcdef0", "--folder", str(tmp_path)
    done = start("docs/benchmarks.py", *options)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("cuts-ghost: 286.8, 37.2, 0.575 (")
    after = benchmarks.load(tmp_path / "benchmarks.json")
    one = after.pop("cuts-ghost")
    assert one.figures == pytest.approx(before.pop("cuts-ghost").figures, rel=1e-2)
    assert (one.commit, one.machine) == ("abcdef0", benchmarks.machine())
    assert after == before
    page = (tmp_path / "benchmarks.md").read_text()
    assert f"\nTaken at abcdef0 on {one.machine}.\n" in page
    assert "| 286.8, 37.2, 0.575 |" in page
    assert " [1] |" in page


def test_a_row_that_fails_is_told_and_leaves_what_was_there(tmp_path, benchmarks, monkeypatch):
    shutil.copy(DOCS / "benchmarks.json", tmp_path)
    row = benchmarks.ROWS[0]
    broken = benchmarks.Row(row.name, "", "", ("demos/none.py",), row.read, row.shown)
    monkeypatch.setattr(benchmarks, "ROWS", (broken,))
    monkeypatch.setattr("sys.argv", ["benchmarks.py", "--folder", str(tmp_path)])
    text = (tmp_path / "benchmarks.json").read_text()
    assert benchmarks.main() == 1
    assert (tmp_path / "benchmarks.json").read_text() == text


def test_what_is_unknown_is_refused():
    done = start("docs/benchmarks.py", "--only", "nothing")
    assert done.returncode == 2
    assert "no row is called nothing" in done.stderr
