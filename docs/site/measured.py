"""Rows of docs/benchmarks.md on other pages: the figures stay those of the last measurement."""

from __future__ import annotations

import json
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive

DOCS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(DOCS))


def claim(row: Any, rows: Sequence[Any], before: Collection[str] = ()) -> str:
    """What a row claims. Of "the same, ..." it tells also of what, unless this row stands before.

    Parameters
    ----------
    row
        The row.
    rows
        All rows in the order of the page of benchmarks.
    before
        Names of the rows that the reader has just seen.
    """
    if not row.claim.startswith("the same"):
        return str(row.claim)
    earlier = rows[: [other.name for other in rows].index(row.name)]
    base = next(r for r in reversed(earlier) if not r.claim.startswith("the same"))
    if base.name in before:
        return str(row.claim)
    return f"{row.claim} (the first of these is: {base.claim})"


class Measured(Directive):
    """``{measured} name name``: a list of rows, each with its figures and its first command."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        from benchmarks import ROWS, shown

        self.state.document.settings.env.note_dependency(str(DOCS / "benchmarks.json"))
        rows = {row.name: row for row in ROWS}
        kept = json.loads((DOCS / "benchmarks.json").read_text())
        found = nodes.bullet_list(classes=["measured"])
        names = self.arguments[0].split()
        for place, name in enumerate(names):
            if name not in rows or name not in kept:
                raise self.error(f"docs/benchmarks.json has no row {name!r}")
            row = rows[name]
            told = claim(row, ROWS, names[:place])
            text = nodes.paragraph("", f"{told[0].upper()}{told[1:]}: ")
            text += nodes.strong("", shown(row, kept[name]["figures"]))
            text += nodes.Text(f". Reference: {row.reference}." if row.reference else ".")
            launch = "" if row.commands[0].startswith("mpirun") else "python3 "
            text += [nodes.Text(" "), nodes.literal("", f"docker/run {launch}{row.commands[0]}")]
            found += nodes.list_item("", text)
        return [found]
