"""Go on with a run until so many steps are done, as `run_restart.py FROM TO STEPS [--fresh]`.

Prints how far the load that varies in space is from what it was in the step that was saved.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

# what cases share with the other tests is in the folder above
sys.path.append(str(Path(__file__).resolve().parents[1]))

from cases.restart import block, varying
from mpi4py import MPI

if __name__ == "__main__":
    source, target, steps = sys.argv[1], sys.argv[2], int(sys.argv[3])
    problem, step, body = block(body=True, tolerance=1e-13)
    apart = 0.0
    if "--fresh" not in sys.argv:
        problem.load(source)
        space = body.function_space
        expected = varying(space.tabulate_dof_coordinates().T, len(problem.history)).T
        apart = float(np.abs(body.x.array.reshape(-1, 2) - expected).max())
    while len(problem.history) < steps:
        step()
    problem.save(target)
    apart = MPI.COMM_WORLD.allreduce(apart, op=MPI.MAX)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(apart))
