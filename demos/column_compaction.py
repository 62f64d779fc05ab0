"""A column of soft soil compacts to half its height under its own weight.

The grid stays as it is. The material points move down through it, and its upper cells become
empty. In one dimension equilibrium alone gives the stress, for each law: a point of first height Y
carries the weight above it,

    σ(Y) = −ρ₀ g (50 m − Y).

GIMP gives a point a domain. While the point crosses from cell to cell, its domain is in both cells,
and its force changes smoothly. Try basis="linear": forces jump there, and the error of the
stress is 8 % instead of 0.06 %. More cells do not help (Charlton, Coombs & Augarde 2017,
doi 10.1016/j.compstruc.2017.05.004).
"""

# mpirun -n 4 python3 demos/column_compaction.py
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

cells = mesh.CellType.quadrilateral
grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (1, 60)], (1, 60), cells)
points = mpm.fill(grid, mpm.Box((0, 0), (1, 50)), per_cell=2, density=80.0)  # 2² points per cell
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test  # the step's displacement increment, its test function

soil = mpm.materials.Hencky(E=10e3, nu=0.0)  # Pa
gravity = fem.Constant(grid, (0.0, 0.0))
F = mpm.momentum(soil, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
F += mpm.ghost(points, u, v, gamma=10e3 / 30)  # itself a few lines of UFL over points.dS

bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs)
for load in mpm.steps(40, label="gravity"):  # progress bar on rank 0
    gravity.value[1] = -10.0 * load
    problem.step()
mpm.plot(points, "output/column_compaction.png")

# the mean error of the vertical stress over the body, by the largest stress
Y, V0 = points["x0"][:, 1], points["V0"]
deviation = np.abs(points["stress"][:, 1, 1] + 800.0 * (50.0 - Y)) @ V0
error = grid.comm.allreduce(deviation) / (800.0 * 50.0 * grid.comm.allreduce(V0.sum()))
if grid.comm.rank == 0:
    print(f"error of the stress {error:.2e}")
assert error < 1e-3
