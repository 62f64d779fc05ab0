"""Runs the studies of the gallery at a small size, and writes their pages."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cards
import programs
from assemble import BUILD, ROOT, SOURCE, digest, write

sys.path.insert(0, str(ROOT / "docs"))


def run_studies(run: bool = True) -> None:
    """Runs each study that has not run with these sources, and writes its page."""
    sources = digest((BUILD / "package").read_text(), *map(Path.read_text, _files()))
    entries = cards.entries()["studies"]

    def renew(name: str) -> None:
        arguments, folder = entries[name]["arguments"], BUILD / "studies" / name
        stamp, key = folder / "stamp", digest(sources, arguments)
        if not stamp.exists() or stamp.read_text() != key:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            print(f"running the study {name} {arguments}", flush=True)
            _run(name, arguments, folder)
            stamp.write_text(key)

    if run:
        # each study is a process of its own, so threads of this one only wait
        with ThreadPoolExecutor(os.process_cpu_count()) as several:
            list(several.map(renew, entries))
    for name, card in entries.items():
        folder = BUILD / "studies" / name
        if (folder / "stamp").exists():
            write_page(name, card, folder)


def _files() -> list[Path]:
    return sorted((ROOT / "demos" / "studies").glob("*.py"))


def _run(name: str, arguments: str, folder: Path) -> None:
    program = programs.file_of("studies", name)
    began = time.monotonic()
    result = subprocess.run(
        [sys.executable, str(program), *shlex.split(arguments), "--output", str(folder)],
        capture_output=True,
        text=True,
        cwd=folder,
        check=False,
    )
    if result.returncode:
        raise SystemExit(f"{program} {arguments} failed:\n{result.stderr[-3000:]}")
    (folder / "printed.txt").write_text(result.stdout.replace(f"{folder}/", "output/"))
    (folder / "seconds").write_text(f"{time.monotonic() - began:.0f}")


def pictures(name: str) -> list[Path]:
    """Pictures and films that the study has drawn."""
    files = (BUILD / "studies" / name).glob("*")
    return sorted(file for file in files if file.suffix in {".png", ".gif", ".mp4"})


def printed(name: str, card: dict[str, Any]) -> str:
    """What the study has printed of itself at its small size, where no row measures it.

    Raises
    ------
    SystemExit
        It has not printed what the card's `printed` describes.
    """
    file = BUILD / "studies" / name / "printed.txt"
    if "printed" not in card or not file.exists():
        return ""
    found = re.search(card["printed"], file.read_text())
    if not found:
        raise SystemExit(f"docs/site/gallery.toml: {name} has not printed {card['printed']!r}")
    return "at a small size: " + "; ".join(found.groups())


def measured(card: dict[str, Any]) -> list[str]:
    """The rows of docs/benchmarks.md that the study measures: claim, figures, reference."""
    from benchmarks import ROWS, shown
    from measured import claim

    rows = {row.name: row for row in ROWS}
    kept = json.loads((ROOT / "docs" / "benchmarks.json").read_text())
    lines = []
    for place, name in enumerate(card["rows"]):
        row = rows[name]
        reference = f" ({row.reference})" if row.reference else ""
        told = claim(row, ROWS, card["rows"][:place])
        lines.append(f"{told}: **{shown(row, kept[name]['figures'])}**{reference}")
    return lines


def write_page(name: str, card: dict[str, Any], folder: Path) -> None:
    """Writes the page of a study: its text, its figures, its pictures, its program."""
    file = programs.file_of("studies", name)
    shown = []
    for picture in pictures(name):
        target = SOURCE / "studies" / "pictures" / picture.name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(picture, target)
        shown.append(f"![{picture.stem.replace('_', ' ')}](pictures/{picture.name})\n")
    figures = "\n".join(f"- {line}" for line in measured(card))
    if figures:
        figures = f"Measured at full size, see [the benchmarks](../benchmarks.md):\n\n{figures}\n"
    seconds = (folder / "seconds").read_text()
    arguments = f" {card['arguments']}" if card["arguments"] else ""
    page = f"""{programs.introduction(file)}
Judged by: {card["judged"]}.

{figures}
## At a small size

```sh
docker/run python3 demos/studies/{name}.py{arguments}
```

This takes {seconds} s, and prints:

```text
{(folder / "printed.txt").read_text().rstrip()}
```

{"".join(shown)}
`--help` lists all options. {{download}}`The program </files/demos/studies/{name}.py>` needs the
other files of `demos/studies/`.
"""
    write(SOURCE / "studies" / f"{name}.md", page)
    write(SOURCE / "files" / "demos" / "studies" / f"{name}.py", file.read_text())
