"""A column of dry sand collapses, explicitly, and comes to rest as it did in the laboratory.

Bui, Fukagawa, Sako & Ohno (2008, doi 10.1002/nag.688) piled up small bars, 0.2 m wide and 0.1 m
high, took the wall away and measured the surface at rest. The weak form is that of a quasi-static
problem. `Explicit` takes as many steps from one time to the next as stability asks for.

Two properties matter. The sand has no cohesion: at the apex of Mohr–Coulomb's pyramid the stress is
zero, and points there fly freely until they are compressed again. And sand keeps its volume while
it is sheared. Linear functions are too stiff for this, and leave the crest too high. They need
fbar=True. Quadratic splines do not.
"""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

# Cells below the base and left of the wall, where points' domains may reach; base and wall are in
# the middle of cells, where the splines' centres are, and those up to there are held.
grid = mesh.create_rectangle(
    MPI.COMM_WORLD, [(-0.025, -0.025), (0.605, 0.155)], (63, 18), mesh.CellType.quadrilateral
)
sand_box = mpm.Box((0, 0), (0.2, 0.1))
points = mpm.fill(grid, sand_box, per_cell=3, density=2040.0, aligned="body")
V = mpm.Space(grid, basis="bspline2")
u, v = V.increment, V.test

# a sixth of the sand's stiffness: the surface is the same, at less than half of the steps
sand = mpm.materials.MohrCoulomb(E=0.84e6, nu=0.3, cohesion=0.0, friction_angle=21.9)
gravity = fem.Constant(grid, (0.0, -10.0))
F = mpm.momentum(sand, points, u, v)
F -= ufl.inner(points.density * gravity, v) * points.dX

bcs = mpm.fixed(V, lambda x: x[1] < 1e-9) + mpm.prescribed(V, lambda x: x[0] < 1e-9, 0)
problem = mpm.Explicit(F, u, points, bcs)
for t in mpm.times(0.607, dt=0.01, label="collapse"):
    problem.step(t)
mpm.plot(
    points, "output/column_collapse.png", "plastic_strain", limits=(0, 3), size=(6.5, 2.5),
    draw="dots", view=((0, 0.5), (0, 0.12)), grid=False,
)  # fmt: skip

# heights where the surface was measured: the area that lies in columns 2 cm wide, each point's
# spread over its first width
places = np.array([0.04, 0.08, 0.12, 0.16, 0.20, 0.241, 0.282, 0.322, 0.362, 0.402, 0.442])
measured = np.array([95.9, 84.4, 72.2, 61.6, 47.4, 34.8, 26.5, 18.9, 10.9, 3.7, 1.5]) / 1000
x, l0 = points["x"][:, :1], points["l0"][:, :1]
inside = np.minimum(x + l0, places + 0.01) - np.maximum(x - l0, places - 0.01)
heights = grid.comm.allreduce(points["V0"] @ (np.clip(inside, 0, None) / (2 * l0))) / 0.02
error = float(np.sqrt(np.mean((heights - measured) ** 2)))
if grid.comm.rank == 0:
    print(f"off the measured surface by {1000 * error:.1f} mm (root mean square)")
assert error < 0.005, error
