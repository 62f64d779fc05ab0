"""Run some of `cases` on all ranks and print the figures of each, as `run_case.py NAME ...`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

# what cases share with the other tests is in the folder above
sys.path.append(str(Path(__file__).resolve().parents[1]))

from cases import CASES
from mpi4py import MPI

if __name__ == "__main__":
    for name in sys.argv[1:]:
        figures = CASES[name]()
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps({"case": name, "figures": figures}), flush=True)
