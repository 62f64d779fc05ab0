"""Some steps of a column of quadratic splines between tied sides, whose mass is factorised."""

import numpy as np
from mpi4py import MPI

import dolfinmpm as mpm

grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 8.0), np.arange(0, 6.0)])
points = mpm.fill(grid, mpm.Box((3, 0), (4, 4)), per_cell=2, density=1.0)
V = mpm.Space(grid, "bspline2")
F = mpm.momentum(mpm.materials.Hencky(1e3, 0.3), points, V.increment, V.test)
sides = mpm.tied(V, period=1.0)
options = {"prolongation": sides, "ghost_mass": 1.0}
problem = mpm.Newmark(F, V.increment, points, mpm.fixed(V, "bottom"), **options)
points["velocity"] = (0.1, 0.0)
for t in mpm.times(0.1, dt=0.02):
    problem.step(t)
