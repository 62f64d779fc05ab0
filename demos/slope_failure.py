"""A slope of clay stands up to Taylor's height, then slides.

A cutting of 60° is 6 m high, in clay of the undrained strength c = 20 kPa. By slip circles Taylor
(1937) found that such a slope stands as long as

    N = ρ g H / c  is below  1 / 0.191 = 5.24.

Here gravity grows until N = 7. A computation of small strains ends at the limit, where no
equilibrium is left. At large strain the slope slides until the heap in front of it supports it. On
the way points enter new cells, and first fill a very small part of them. The nodes of these cells
have almost no stiffness. The ghost penalty ties these nodes to their neighbours.
"""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

H, c, density = 6.0, 20e3, 1800.0  # m, Pa, kg/m³
grid = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), (26, 9)], (52, 18), mesh.CellType.quadrilateral
)
crest = 14 - H / np.tan(np.radians(60))
ground = mpm.Polygon([(0, 0), (26, 0), (26, 2), (14, 2), (crest, 2 + H), (0, 2 + H)])
points = mpm.fill(grid, ground, per_cell=3, density=density)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test

# Clay that has no time to drain keeps its volume while it flows: Tresca's law, and F-bar, without
# which linear functions are too stiff for that.
E = 1000 * c
clay = mpm.materials.Tresca(E, 0.3, cohesion=c)
gravity = fem.Constant(grid, (0.0, 0.0))
F = mpm.momentum(clay, points, u, v, fbar=True)
F -= ufl.inner(points.density * gravity, v) * points.dX
F += mpm.ghost(points, u, v, gamma=E / 30)

bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs)
curve = mpm.History()
for share in mpm.steps(35, label="gravity"):
    N = 7 * share
    gravity.value[1] = -N * c / (density * H)
    problem.step()
    farthest = np.abs(points["x"] - points["x0"]).max(initial=0.0)
    curve.record(N=N, moved=grid.comm.allreduce(farthest, MPI.MAX))

# It has failed in the first step in which some point moves by a hundredth of the height.
jumps = np.diff(curve["moved"], prepend=0.0) > 0.01 * H
limit = curve["N"][jumps][0]
if grid.comm.rank == 0:
    print(f"fails at N = {limit:.2f}, Taylor 5.24; moves by {curve['moved'][-1]:.2f} m in the end")
mpm.plot(points, "output/slope_failure.png", "plastic_strain", limits=(0, 1), size=(6.5, 3.5))
assert abs(limit - 1 / 0.191) < 0.2
