"""Press a tool in, as `run_penetration.py save FILE` and `... load FILE`; prints the figures then.

The first saves half of the way and goes on, the second goes on from there.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

# what cases share with the other tests is in the folder above
sys.path.append(str(Path(__file__).resolve().parents[1]))

from cases.contact import figures, ploughed
from mpi4py import MPI

HALF, STEPS = 3, 6

if __name__ == "__main__":
    what, path = sys.argv[1:3]
    problem, step = ploughed(tolerance=1e-12)
    if what == "load":
        problem.load(path)
        assert len(problem.history) == HALF
    while len(problem.history) < STEPS:
        if what == "save" and len(problem.history) == HALF:
            problem.save(path)
        step()
    found = figures(problem)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
