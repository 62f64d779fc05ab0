"""Options of studies: a command line from the fields of a dataclass."""
# ruff: noqa: RUF009 (fields of a dataclass)

from __future__ import annotations

import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

import dolfinmpm as mpm

FILE = Path(__file__).resolve().parents[2] / "demos" / "studies" / "options.py"
SPEC = importlib.util.spec_from_file_location("study_options", FILE)
sys.modules["study_options"] = options = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(options)
Options, option, other_default = options.Options, options.option, options.other_default
natural, positive, switch = options.natural, options.positive, options.switch


@dataclass
class Input(Options):
    """A block."""

    h: float | None = positive(None, "size of the cells (m)")
    steps: int = natural(4)
    poisson: float = option(0.3, least=0, below=0.5)
    cells: list[int] = option([8, 16], "by commas", least=2)
    bases: list[str] = option(["gimp"], choices=("linear", "gimp"))
    stages: list[float] = option([1.0], nargs="+")
    drainage: str | None = option(None, one_of={"drained": "slow", "undrained": "fast"})
    force: float | None = option(None, either="load")
    depth: float | None = option(None, either="load")
    wide: float = option(1.0, flag="--width")
    fbar: str = switch("on")
    fast: bool = False

    def _check(self):
        self.fill(h=0.5 * self.wide)


@dataclass
class Finer(Input):
    """A block in finer cells."""

    h: float | None = other_default(Input, "h", 0.1)


@pytest.fixture(autouse=True)
def unmeasured():
    """A command line lets stages be measured."""
    yield
    mpm.measure_stages(False)


def test_fields_are_options():
    words = "--steps 7 --cells 4,5 --bases linear,gimp --stages 2 3 --undrained --width 3 --fast"
    words += " --force 2e3 --fbar off --output there"
    given = Input.parse(words.split())
    assert (given.h, given.steps, given.wide, given.fast) == (1.5, 7, 3.0, True)
    assert (given.cells, given.bases, given.stages) == ([4, 5], ["linear", "gimp"], [2.0, 3.0])
    assert (given.drainage, given.force, given.depth) == ("undrained", 2e3, None)
    assert (given.fbar, given.output, given.json) == ("off", Path("there"), None)


def test_defaults_are_no_one_elses():
    first, second = Input.parse([]), Input.parse([])
    first.cells.append(32)
    assert second.cells == [8, 16]
    assert Finer.parse([]).h == 0.1
    assert Input.parse(["--bases="]).bases == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--h 0", "h = 0 must be above 0"),
        ("--steps 0", "steps = 0 must be at least 1"),
        ("--poisson 0.5", "poisson = 0.5 must be below 0.5"),
        ("--cells 8,1", "cells = 1 must be at least 2"),
        ("--cells=", "invalid"),
        ("--bases cubic", "cubic is not one of linear, gimp"),
        ("--force 1 --depth 2", "not allowed with"),
        ("--fbar maybe", "invalid choice"),
    ],
)
def test_bad_words_are_refused(words, message, capsys):
    with pytest.raises(SystemExit) as end:
        Input.parse(words.split())
    assert end.value.code == 2
    assert message in capsys.readouterr().err
