"""Other codes on scenes of the benchmark, in turn with ours, for the machine's sake."""

from __future__ import annotations

import importlib.util
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmark_costs import column as compact
from benchmark_scenes import Run, column
from scene import say

HERE = Path(__file__).parent
# where pip put other codes, if not where Python looks by itself
FOLDER = "PEERS"


def environment() -> dict[str, str]:
    """What a peer's process is to see; it need not have our versions of libraries."""
    own = {**os.environ, "OMP_NUM_THREADS": "1"}
    if FOLDER in own:
        own["PYTHONPATH"] = own[FOLDER]
    return own


def there(package: str) -> bool:
    """Whether a package is installed."""
    folder = os.environ.get(FOLDER)
    if folder is not None:
        return Path(folder, package).is_dir()
    return importlib.util.find_spec(package) is not None


def kratos(elements: int, columns: int = 1) -> dict[str, Any]:
    """One run of the column in Kratos."""
    command = [sys.executable, str(HERE / "kratos_column.py")]
    command += ["--elements", str(elements), "--columns", str(columns)]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=True)
    found = [line for line in done.stdout.splitlines() if line.startswith("{")]
    return json.loads(found[-1])


def _missing() -> bool:
    """Whether there is no Kratos to compare with; says so."""
    if there("KratosMultiphysics"):
        return False
    say(
        "Kratos is not installed: pip install KratosMPMApplication "
        f"KratosLinearSolversApplication, and with --target FOLDER say {FOLDER}=FOLDER"
    )
    return True


def whole(elements: int) -> float:
    """Seconds of a process of ours that starts, solves the column in GIMP, and ends."""
    command = [sys.executable, str(HERE / "column_compaction.py"), "--elements", str(elements)]
    started = time.perf_counter()
    subprocess.run([*command, "--no-plot"], capture_output=True, check=True)
    return time.perf_counter() - started


def cases(sizes: list[str], repeat: int) -> dict[str, Any]:
    """Columns of several elements across in Kratos and here, in turn; medians of ratios.

    Args:
        sizes: As "16x256", elements across and high; of those that are one across the whole
            processes are timed too.
        repeat: How often.
    """
    found: dict[str, Any] = {}
    if not sizes or _missing():
        return found
    for case in sizes:
        columns, elements = (int(n) for n in case.split("x"))
        seconds: dict[str, list[float]] = {"kratos": [], "gimp": [], "linear": []}
        for _ in range(repeat):
            started = time.perf_counter()
            seconds["kratos"].append(kratos(elements, columns)["seconds"])
            if columns == 1:
                seconds.setdefault("kratos, whole", []).append(time.perf_counter() - started)
                seconds.setdefault("gimp, whole", []).append(whole(elements))
            for basis in ("gimp", "linear"):
                seconds[basis].append(compact(columns, elements, basis)[0])
        found[case] = {name: statistics.median(values) for name, values in seconds.items()}
        found[case]["ratios"] = {
            name: statistics.median(
                k / own
                for k, own in zip(seconds["kratos, whole" if "whole" in name else "kratos"], values)
            )
            for name, values in seconds.items()
            if "kratos" not in name
        }
        say(f"column {case}: Kratos {found[case]['kratos']:.3f} s; times as fast: " + ", ".join(
            f"{name} {ratio:.2f}" for name, ratio in found[case]["ratios"].items()
        ))  # fmt: skip
    return found


def compare(levels: tuple[int, ...], repeat: int) -> list[dict[str, Any]]:
    """The column in Kratos, and in GIMP and linear functions here, in turn; medians."""
    if _missing():
        return []
    rows = []
    for elements in levels:
        ours = {basis: Run("column", basis, elements, 2, "none") for basis in ("gimp", "linear")}
        theirs = []
        for _ in range(repeat):
            theirs.append(kratos(elements))
            for run in ours.values():
                column(run)
        one = theirs[-1]
        seconds = statistics.median(run["seconds"] for run in theirs)
        row = {
            "code": "kratos", "scene": "column", "level": elements, "error": one["error"],
            "seconds": seconds, "iterations": one["iterations"], "points": one["points"],
            "ours": {
                basis: {
                    "error": run.error,
                    "seconds": statistics.median(run.seconds_all),
                    "iterations": run.iterations,
                    "ratio": statistics.median(
                        k["seconds"] / s for k, s in zip(theirs, run.seconds_all)
                    ),
                }
                for basis, run in ours.items()
            },
        }  # fmt: skip
        rows.append(row)
        say(
            f"column {elements}: Kratos error {row['error']:.2e} in {seconds:.3f} s, "
            f"{row['iterations']} iterations; "
            + "; ".join(
                f"{basis} {o['error']:.2e} in {o['seconds']:.3f} s, {o['iterations']} iterations, "
                f"{o['ratio']:.2f} times as fast"
                for basis, o in row["ours"].items()
            )
        )
    return rows
