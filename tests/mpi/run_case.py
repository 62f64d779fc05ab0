"""Run one of `cases` on all ranks and print its figures, as `run_case.py NAME`."""

from __future__ import annotations

import json
import sys

from cases import CASES
from mpi4py import MPI

if __name__ == "__main__":
    figures = CASES[sys.argv[1]]()
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(figures))
