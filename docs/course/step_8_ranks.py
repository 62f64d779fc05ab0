"""Step 8. Many ranks, checkpoints, clusters

A run that takes days must go on after an interruption, and on another number of ranks. Here a
footing is pressed into clay by half of its way. The state is saved, loaded by a second problem,
and taken to the end. The result has the same digits as a run without a stop.
"""

# %%
# A function builds the problem. A restart builds the problem in the same way, and then loads the
# state.

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

comm = MPI.COMM_WORLD


def build():
    """A strip footing on clay: problem, constant of the settlement, footing."""
    corners, cells = [(0, 0), (4, 2.125)], (32, 17)
    grid = mesh.create_rectangle(comm, corners, cells, mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=1000.0)
    V = mpm.Space(grid, basis="gimp")
    u, v = V.increment, V.test
    clay = mpm.materials.Tresca(E=1e8, nu=0.33, cohesion=10e3)
    F = mpm.momentum(clay, points, u, v, fbar=True)
    under = mpm.Surface(points, lambda x: np.isclose(x[1], 2) & (x[0] < 1), normal=(0, 1))
    settlement = fem.Constant(grid, 0.0)
    footing = mpm.RigidFooting(under, settlement, rough=False, E=1e8)
    F += footing.contact(u, v)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost"), settlement, footing


def press(problem, settlement, first, last):
    """The steps from ``first`` to ``last`` of ten."""
    for k in range(first, last):
        settlement.value = 2e-3 * (k + 1) / 10
        problem.step()


# %%
# Without a stop:

problem, settlement, footing = build()
press(problem, settlement, 0, 10)
whole = footing.load()

# %%
# With a stop after five steps. ``save`` writes one file from all ranks. ``load`` reads it on any
# number of ranks. The number of steps in ``problem.history`` tells where to go on.

problem, settlement, footing = build()
press(problem, settlement, 0, 5)
problem.save("footing.npz")

problem, settlement, footing = build()
problem.load("footing.npz")
press(problem, settlement, len(problem.history), 10)
again = footing.load()
if comm.rank == 0:
    print(f"load {again / 1e3:.4f} kN/m, without a stop {whole / 1e3:.4f} kN/m")
assert abs(again / whole - 1) < 1e-6

# %%
# Ranks
# -----
# ``docker/run mpirun -n 2 python3 step_8_ranks.py`` prints the same digits. Points and unknowns
# are distributed anew in each step, because the work follows the body and not the grid. Some
# thousand unknowns per rank are the least that is worth a rank.
#
# On a cluster ``packaging/slurm.sh`` asks for 64 ranks, goes back to the queue ten minutes before
# the end of its time, and goes on from the checkpoint. :doc:`Ways to install </install>` has the
# commands for Apptainer and Slurm.
#
# Try next
# --------
# - Save on two ranks, load on one.
# - ``problem.history[-1].imbalance``: the largest share of work of a rank over the mean.
# - ``print(problem)``: fields, terms, conditions, solver.
