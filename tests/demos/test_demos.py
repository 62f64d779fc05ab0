"""Every demo runs, some on two ranks, ends with its own assertion, and leaves its picture."""

from __future__ import annotations

import re
import runpy
import statistics
from pathlib import Path

import pytest
from conftest import ROOT, start

DEMOS = sorted((ROOT / "demos").glob("*.py"))
# what each asserts of an exact or published value, and the value that it has had
NUMBERS = {
    "cantilever": ("down", 0.8262),
    "cone": ("found", 10.031),
    "consolidation": ("degree", 0.7650),
    "coupled_slope": ("limit", 5.231),
    "column_collapse": ("error", 2.609e-3),
    "column_compaction": ("error", 5.56e-4),
    "debris_flow": ("volume", 698.417),
    "diffusion": ("amplitude", 0.36958),
    "footing": ("factor", 5.242),
    "gmsh_slope": ("factor", 1.3828),
    "incline": ("way", 2.4285),
    "layered_ground": ("P", 68131.4),
    "paraview_and_checkpoint": ("difference", 0.0),
    # rounding decides which corners touch first: two processors differ by 0.013
    "pipe": ("factor", 5.145),
    "plough": ("ratio", 5.876),
    "published_law": ("settlement", 0.11531),
    "refined_cone": ("found", 10.031),
    "growing_strip": ("angle", 2.3617),
    "new_stabilisation": ("worst", 0.5749),
    "runout": ("push", 3.559e6),
    "slope_failure": ("limit", 5.4),
    "thick_cylinder": ("p", 0.9952),
    "vibrating_bar": ("period", 10.0028),
    "your_own_law": ("top", 16.6279),
}


# tests of studies have what they show at smaller sizes, and `paraview_and_checkpoint` has its own
_LONG = (
    "column_collapse", "cone", "coupled_slope", "debris_flow", "footing",
    "paraview_and_checkpoint", "plough", "published_law", "refined_cone", "runout",
)  # fmt: skip


@pytest.mark.parametrize(
    "demo",
    [
        pytest.param(path.stem, marks=[pytest.mark.long] if path.stem in _LONG else [])
        for path in DEMOS
    ],
)
def test_alone(demo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if demo == "gmsh_slope":
        pytest.importorskip("gmsh")
    # as a user runs it: Numba remembers the name of the module in which a kernel was compiled
    names = runpy.run_path(str(ROOT / "demos" / f"{demo}.py"), run_name="__main__")
    name, value = NUMBERS[demo]
    found = names[name]
    found = found["dt_consistent"] if demo == "new_stabilisation" else found
    found = found[-1] if demo == "thick_cylinder" else found
    assert found == pytest.approx(value, rel=2e-3)
    pictures = list((tmp_path / "output").glob("*.png"))
    # a footing also has a curve of its load
    assert f"{demo}.png" in [picture.name for picture in pictures]
    for picture in pictures:
        assert picture.name.startswith(demo)
        assert picture.read_bytes().startswith(b"\x89PNG")


# tests/mpi has every part of them on several ranks, and so have the studies that go with them
_TWO_RANKS = (
    "consolidation", "diffusion", "gmsh_slope", "incline", "layered_ground",
    "paraview_and_checkpoint", "pipe", "runout", "slope_failure", "vibrating_bar",
)  # fmt: skip


@pytest.mark.parametrize(
    "demo",
    ["column_compaction", *(pytest.param(name, marks=pytest.mark.long) for name in _TWO_RANKS)],
)
def test_on_two_ranks(demo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if demo == "gmsh_slope":
        pytest.importorskip("gmsh")
    done = start(f"demos/{demo}.py", ranks=2)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    assert (tmp_path / "output" / f"{demo}.png").stat().st_size > 0


def test_files_for_paraview_are_complete(tmp_path, monkeypatch):
    """Every series of the run and of its restart lists the times that it should, and files."""
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(ROOT / "demos/paraview_and_checkpoint.py"), run_name="__main__")
    assert names["difference"] == 0.0
    folder = tmp_path / "output" / "paraview_and_checkpoint"
    for run, count in (("whole", 40), ("rest", 21)):
        for kind in ("", "_grid", "_bodies"):
            listed = re.findall(r'file="(.*?)"', (folder / f"{run}{kind}.pvd").read_text())
            assert len(listed) == count
            assert all((folder / name).stat().st_size > 0 for name in listed)


def test_demos_are_short():
    texts = [path.read_text() for path in DEMOS]
    assert statistics.median(text.count("\n") for text in texts) < 80
    for text in texts:
        assert "argparse" not in text
        assert text.splitlines()[-1].startswith("assert ")


def test_the_script_of_readme_is_the_first_demo():
    script, *_ = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    code = [line for line in script.splitlines() if line and not line.startswith("#")]
    assert 15 <= len(code) <= 25
    assert set(code) <= set(Path(ROOT / "demos/column_compaction.py").read_text().splitlines())
