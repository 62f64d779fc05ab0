"""The table of run times: what each example took when the site was built."""

from __future__ import annotations

import re
from pathlib import Path

import cards
import programs
from assemble import BUILD, SOURCE
from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList

TOTAL = re.compile(
    r"\*\*Total running time of the script:\*\* \((\d+) minutes (\d+\.\d+) seconds\)"
)


def times() -> list[tuple[str, str, float]]:
    """Page, title and seconds of each example that has run."""
    found = []
    for folder in ("course", "demos"):
        for page in sorted((SOURCE / folder).glob("*.rst")):
            text = page.read_text()
            if total := TOTAL.search(text):
                source = BUILD / "programs" / folder / f"{page.stem}.py"
                title = source.read_text().removeprefix('"""').partition("\n")[0]
                found.append(
                    (f"/{folder}/{page.stem}", title, 60 * int(total[1]) + float(total[2]))
                )
    for name in cards.entries()["studies"]:
        seconds = BUILD / "studies" / name / "seconds"
        if seconds.exists():
            title = programs.title("studies", name)
            found.append((f"/studies/{name}", title, float(Path(seconds).read_text())))
    return found


class RunTimes(Directive):
    """The table."""

    def run(self) -> list[nodes.Node]:
        rows = [
            f"   * - :doc:`{title} <{page}>`\n     - {seconds:.1f}"
            for page, title, seconds in times()
        ]
        head = ".. list-table::\n   :header-rows: 1\n   :widths: 80 20\n\n"
        head += "   * - program\n     - seconds\n"
        lines = [*head.split("\n"), *"\n".join(rows).split("\n")]
        node = nodes.container()
        self.state.nested_parse(StringList(lines, "runtimes"), self.content_offset, node)
        return node.children
