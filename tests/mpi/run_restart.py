"""Go on with a run until so many steps are done, as `run_restart.py FILE STEPS [--fresh]`."""

from __future__ import annotations

import sys

from cases.restart import block
from mpi4py import MPI

if __name__ == "__main__":
    path, steps = sys.argv[1], int(sys.argv[2])
    problem, step = block(tolerance=1e-13)
    if "--fresh" not in sys.argv:
        problem.load(path)
    while len(problem.history) < steps:
        step()
    problem.save(path)
    total = problem.points.total
    if MPI.COMM_WORLD.rank == 0:
        print(total)
