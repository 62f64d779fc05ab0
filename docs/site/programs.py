"""Titles and texts of the programs of demos/ and demos/studies/."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def file_of(kind: str, name: str) -> Path:
    folder = "demos" if kind == "demos" else "demos/studies"
    return ROOT / folder / f"{name}.py"


def introduction(file: Path) -> str:
    """The first cell of text of a study, in Markdown, its title included."""
    cell = re.match(r"(?:#!.*\n)?# %% \[markdown\]\n((?:#.*\n)+)", file.read_text())
    if not cell:
        raise ValueError(f"{file} begins with no cell of text: # %% [markdown]")
    return re.sub(r"^# ?", "", cell[1], flags=re.MULTILINE)


def title(kind: str, name: str) -> str:
    file = file_of(kind, name)
    if kind == "demos":
        text = ast.get_docstring(ast.parse(file.read_text())) or name
        return text.partition("\n")[0].rstrip(".")
    return introduction(file).partition("\n")[0].removeprefix("# ")
