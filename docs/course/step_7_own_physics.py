"""Step 7. Physics of your own in UFL

A layer of swelling clay takes up water and heaves between smooth walls. The library knows nothing
of swelling. You write an energy in UFL with a field of your own, and the library derives forces
and tangent from it.
"""

# %%
# Grid, points and space are as before.

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.optimize import brentq

import dolfinmpm as mpm

corners, cells = [(0, 0), (1, 1.5)], (8, 12)
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, cells, mesh.CellType.quadrilateral)
points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), per_cell=2, density=1800.0)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test

# %%
# A field of the points moves with them. Here it is the stretch by which the clay would swell if it
# were free. A DOLFINx constant brings it from nothing to its end.

points.add_field("swelling")
points["swelling"] = 0.1
wet = fem.Constant(grid, 0.0)

# %%
# ``points.F`` is the deformation gradient at the start of the step. ``(I + ∇u) F`` is the one at
# the end. Only the elastic part stores energy: the whole deformation without the swelling. The
# energy is neo-Hookean. ``ufl.derivative`` gives the weak form.

E, nu = 1e6, 0.3  # Pa
mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
g = 1 + wet * points.swelling
Fe = (ufl.Identity(2) + ufl.grad(u)) * points.F / g
J = ufl.det(Fe)
psi = mu / 2 * (ufl.inner(Fe, Fe) - 2) - mu * ufl.ln(J) + lmbda / 2 * ufl.ln(J) ** 2
F = ufl.derivative(g**2 * psi * points.dX, u, v)

# %%
# Your own stabilisation is UFL too: jumps of the gradient on the facets next to cut cells.

n, h = ufl.FacetNormal(grid), mpm.cell_size(grid)
jumps = ufl.inner(ufl.jump(ufl.grad(u), n), ufl.jump(ufl.grad(v), n))
F += 0.1 * E * h * jumps * points.dS

problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "right", "bottom"))
for share in mpm.steps(10, label="swelling"):
    wet.value = share
    problem.step()

# %%
# The exact height: the vertical stress is zero in a layer that cannot become wider.

exact = brentq(lambda s: mu * ((s / 1.1) ** 2 - 1) + lmbda * np.log(s / 1.1**2), 1.0, 1.5)
x, rows = points["x"], points["V0"]
height = 2 * grid.comm.allreduce(rows @ x[:, 1]) / grid.comm.allreduce(rows.sum())
if grid.comm.rank == 0:
    print(f"height {height:.6f} m, exact {exact:.6f} m")
mpm.plot(points, "output/swelling.png", "swelling", size=(3.5, 3.5))
assert abs(height / exact - 1) < 1e-6

# %%
# What it shows
# -------------
# The form is split into what is done at points and at nodes, differentiated, and compiled. No line
# of the library was changed.
#
# Try next
# --------
# - Let only the upper half swell: ``points["swelling"] = 0.1 * (points["x0"][:, 1] > 0.5)``. The
#   assertion is of the whole layer: leave it out.
# - :doc:`A strip that curls </demos/growing_strip>` has such a field.
# - :doc:`A law of one's own </demos/your_own_law>` with internal variables, compiled by Numba.
