"""A run that goes on from its checkpoint: the column of demos/column_compaction.py.

The file is named by the environment variable CHECKPOINT. It is saved after each step, and loaded at
the start where it exists, on any number of ranks. A run that is killed loses its last step only.
"""

import os
from pathlib import Path

import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

STEPS = 40
checkpoint = Path(os.environ.get("CHECKPOINT", "checkpoint.npz"))

cells = mesh.CellType.quadrilateral
grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (1, 60)], (1, 60), cells)
points = mpm.fill(grid, mpm.Box((0, 0), (1, 50)), per_cell=2, density=80.0)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test

soil = mpm.materials.Hencky(E=10e3, nu=0.0)  # Pa
gravity = fem.Constant(grid, (0.0, 0.0))
F = mpm.momentum(soil, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
F += mpm.ghost(points, u, v, gamma=10e3 / 30)
bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs)

if checkpoint.exists():
    problem.load(checkpoint)
first = len(problem.history)
for k in range(first, STEPS):
    gravity.value[1] = -10.0 * (k + 1) / STEPS
    problem.step()
    problem.save(checkpoint)

top = grid.comm.allreduce(points["x"][:, 1].max(initial=0.0), op=MPI.MAX)
if grid.comm.rank == 0:
    print(f"{STEPS - first} of {STEPS} steps; the highest point is at {top:.9f} m")
