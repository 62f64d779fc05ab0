"""Run some of `cases` on all ranks and print the figures of each, as `run_case.py NAME ...`."""

from __future__ import annotations

import json
import sys

from cases import CASES
from mpi4py import MPI

if __name__ == "__main__":
    for name in sys.argv[1:]:
        figures = CASES[name]()
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps({"case": name, "figures": figures}), flush=True)
