"""What all demos share: their command line, and how they hand over their figures."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from mpi4py import MPI

OUTPUT = Path(__file__).resolve().parent.parent / "output"


def parser(description: str) -> argparse.ArgumentParser:
    """A command line with the options that every demo takes."""
    result = argparse.ArgumentParser(
        description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    result.add_argument(
        "--json", metavar="PATH", help="write inputs and figures there; - for the last line printed"
    )
    result.add_argument("--no-plot", action="store_true", help="no picture, no ParaView file")
    result.add_argument("--output", type=Path, default=OUTPUT, help="folder for pictures and files")
    return result


def finish(arguments: argparse.Namespace, figures: dict[str, Any]) -> None:
    """Write the inputs and the figures where `--json` asks for them; on rank 0."""
    if arguments.json is None or MPI.COMM_WORLD.rank != 0:
        return
    inputs = {
        name: str(value) if isinstance(value, Path) else value
        for name, value in vars(arguments).items()
        if name not in ("json", "no_plot", "output")
    }
    text = json.dumps({**inputs, **figures})
    if arguments.json == "-":
        sys.stdout.flush()
        print(text, flush=True)
    else:
        Path(arguments.json).write_text(text + "\n")


def say(*words: Any) -> None:
    """Print on rank 0."""
    if MPI.COMM_WORLD.rank == 0:
        print(*words, flush=True)
