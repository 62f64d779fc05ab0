"""Rows of docs/benchmarks.md on other pages: the figures stay those of the last measurement."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive

DOCS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(DOCS))


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
        for name in self.arguments[0].split():
            if name not in rows or name not in kept:
                raise self.error(f"docs/benchmarks.json has no row {name!r}")
            row = rows[name]
            text = nodes.paragraph("", f"{row.claim[0].upper()}{row.claim[1:]}: ")
            text += nodes.strong("", shown(row, kept[name]["figures"]))
            text += nodes.Text(f". Reference: {row.reference}." if row.reference else ".")
            launch = "" if row.commands[0].startswith("mpirun") else "python3 "
            text += [nodes.Text(" "), nodes.literal("", f"docker/run {launch}{row.commands[0]}")]
            found += nodes.list_item("", text)
        return [found]
