"""Run the studies, and write their figures to benchmarks.json and benchmarks.md beside this file.

    docker/run python3 docs/benchmarks.py                  all rows, which takes hours
    docker/run python3 docs/benchmarks.py --quick          those of some seconds
    docker/run python3 docs/benchmarks.py --only prandtl   one row, or several by commas
    docker/run python3 docs/benchmarks.py --list           what there is
    docker/run python3 docs/benchmarks.py --render         benchmarks.md anew, nothing is run

A row that is not run keeps the figures that it had, with a mark that tells where and at which
commit they were taken. Files are written after every row, so that a run may be interrupted and goes
on with `--missing`, which leaves out what was taken at the present commit on this machine.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import benchmark_rows
import benchmark_rows_laws
import benchmark_rows_soil
import benchmark_rows_speed
from benchmark_rows import Row

ROWS = tuple(
    row
    for module in (benchmark_rows, benchmark_rows_speed, benchmark_rows_soil, benchmark_rows_laws)
    for row in module.ROWS
)

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
HEAD = """\
# Benchmarks

Written by `docker/run python3 docs/benchmarks.py` from the JSON of `demos/studies`, not by hand.
Every command stands behind `docker/run python3` (`docker/run` where it begins with `mpirun`) and
takes `--help`. Times are for one process on a machine with nothing else to do.
"""


@dataclass(frozen=True)
class Taken:
    """Figures of a row, and where they come from.

    Attributes:
        figures: The numbers, in the order in which the row shows them.
        commit: Commit that they were taken at.
        machine: Processor and versions of what computes.
    """

    figures: list[float]
    commit: str
    machine: str


@functools.cache
def run(command: str, fresh: bool = False, picture: str = "") -> dict[str, Any]:
    """The JSON of a study, with the seconds that it took from start to end as `seconds_whole`.

    Args:
        command: File and options, perhaps behind `mpirun -n N python3`.
        fresh: Whether it must compile everything anew.
        picture: Name of a picture that it draws and that is to be kept beside this file.

    Raises:
        RuntimeError: It did not end well.
    """
    launch, _, rest = command.rpartition("python3 ")
    script, *options = rest.split()
    environment = dict(os.environ)
    with tempfile.TemporaryDirectory() as empty:
        if fresh:
            environment |= {"NUMBA_CACHE_DIR": f"{empty}/numba", "XDG_CACHE_HOME": empty}
        started = time.perf_counter()
        done = subprocess.run(
            [*launch.split(), sys.executable, str(ROOT / script), *options, "--json", "-",
             *(["--output", empty] if picture else ["--no-plot"])],
            env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        seconds = time.perf_counter() - started
        if picture and done.returncode == 0:
            shutil.copy(Path(empty, picture), HERE)
    if done.returncode != 0:
        raise RuntimeError(f"{command}: {done.stdout[-1000:]}{done.stderr[-3000:]}")
    return {**json.loads(done.stdout.strip().splitlines()[-1]), "seconds_whole": seconds}


def commit() -> str:
    """Short name of the commit that is checked out, or "unknown". Needs no git."""
    folder = ROOT / ".git"
    try:
        if folder.is_file():
            folder = Path(folder.read_text().split(": ")[1].strip())
        head = (folder / "HEAD").read_text().strip()
        if not head.startswith("ref: "):
            return head[:7]
        if (folder / "commondir").exists():
            folder = folder / (folder / "commondir").read_text().strip()
        name = head.removeprefix("ref: ")
        if (folder / name).exists():
            return (folder / name).read_text()[:7]
        packed = (folder / "packed-refs").read_text().splitlines()
        return next(line[:7] for line in packed if line.endswith(f" {name}"))
    except (OSError, StopIteration):
        return "unknown"


def machine() -> str:
    """Processor and versions, in a line without a date."""
    import dolfinx
    from petsc4py import PETSc

    model = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.exists() else []
    model = next((line.split(": ")[1] for line in lines if line.startswith("model name")), model)
    version = ".".join(map(str, PETSc.Sys.getVersion()))
    return (
        f"{model}, {os.cpu_count()} processors; Python {platform.python_version()}, DOLFINx "
        f"{dolfinx.__version__}, PETSc {version}"
    )


def load(path: Path) -> dict[str, Taken]:
    """Figures by the name of their row, those of rows that are no more left out."""
    if not path.exists():
        return {}
    known = {row.name for row in ROWS}
    stored = json.loads(path.read_text())
    return {name: Taken(**values) for name, values in stored.items() if name in known}


def shown(row: Row, figures: list[float]) -> str:
    """The figures as they are printed, powers of ten without needless signs and zeros."""
    return re.sub(r"e(-?)\+?0*(\d)", r"e\1\2", row.shown.format(*figures))


def origin(commit: str, machine: str) -> str:
    """Where figures come from, in a sentence."""
    at = "a commit that was not recorded," if commit == "unknown" else commit
    return f"Taken at {at} on {machine}."


def render(taken: dict[str, Taken], latest: str | None = None) -> str:
    """The page.

    Args:
        taken: Figures by the name of their row.
        latest: Commit of the rows that need no mark; the one that most rows have by default, and
            where it is not known.
    """
    latest = None if latest == "unknown" else latest
    origins = [(t.commit, t.machine) for t in taken.values()]
    counted = sorted(set(origins), key=lambda o: (o[0] != latest, -origins.count(o), o))
    marks = {one: "" if k == 0 else f" [{k}]" for k, one in enumerate(counted)}
    text = HEAD
    for k, (at, on) in enumerate(counted):
        text += f"\n[{k}] {origin(at, on)}\n" if k else f"\n{origin(at, on)}\n"
    part = ""
    parts = list(dict.fromkeys(row.part for row in ROWS))
    for row in sorted(ROWS, key=lambda row: parts.index(row.part)):
        if row.part != part:
            part = row.part
            text += f"\n## {part}\n\n| claim | ours | reference | command |\n|---|---|---|---|\n"
        ours = "not taken yet"
        if row.name in taken:
            one = taken[row.name]
            ours = shown(row, one.figures) + marks[one.commit, one.machine]
        first, *others = row.commands
        commands = [f"`{first}`", *(f"`{_shortened(c)}`" for c in others)]
        text += f"| {row.claim} | {ours} | {row.reference} | {', '.join(commands)} |\n"
    return text


def _shortened(command: str) -> str:
    """A further command of a row: its options, unless it is launched otherwise."""
    return command if command.startswith("mpirun") else f"… {command.partition(' ')[2]}"


def measure(row: Row) -> list[float]:
    """Run a row's commands and read its figures from them."""
    answers = [run(command, row.fresh, row.picture) for command in row.commands]
    return [float(figure) for figure in row.read(*answers)]


def main() -> int:
    """The command line; returns how many rows failed."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--quick", action="store_true", help="rows of some seconds only")
    options.add_argument("--only", metavar="NAMES", help="these rows only, by commas")
    options.add_argument("--missing", action="store_true", help="only what is not up to date")
    options.add_argument("--list", action="store_true", help="print the rows' names")
    options.add_argument("--render", action="store_true", help="run nothing")
    options.add_argument("--commit", default=commit(), help="what the figures are marked with")
    options.add_argument("--folder", type=Path, default=HERE, help="where the two files are")
    given = options.parse_args()
    wanted = given.only.split(",") if given.only else [row.name for row in ROWS]
    unknown = set(wanted) - {row.name for row in ROWS}
    if unknown:
        options.error(f"no row is called {', '.join(sorted(unknown))}; see --list")
    rows = [r for r in ROWS if r.name in wanted and (r.quick or not given.quick)]
    if given.list:
        for row in rows:
            print(f"{row.name:24s} {'quick' if row.quick else '     '} {row.claim}")
        return 0

    path, here, failed = given.folder / "benchmarks.json", machine(), 0
    taken = load(path)
    if given.missing:
        now = given.commit, here
        rows = [r for r in rows if (t := taken.get(r.name)) is None or (t.commit, t.machine) != now]
    for row in [] if given.render else rows:
        started = time.perf_counter()
        try:
            figures = measure(row)
        except Exception as error:  # whatever it is, the other rows are to be run
            failed += 1
            print(f"{row.name}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
            continue
        taken[row.name] = Taken(figures, given.commit, here)
        print(
            f"{row.name}: {shown(row, figures)} ({time.perf_counter() - started:.0f} s)",
            flush=True,
        )
        text = {name: asdict(taken[name]) for name in sorted(taken)}
        path.write_text(json.dumps(text, indent=1, ensure_ascii=False) + "\n")
        (given.folder / "benchmarks.md").write_text(render(taken, given.commit))
    if given.render:
        (given.folder / "benchmarks.md").write_text(render(taken, given.commit))
    return failed


if __name__ == "__main__":
    sys.exit(main())
