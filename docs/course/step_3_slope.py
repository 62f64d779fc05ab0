"""Step 3. A slope that fails

A slope of clay, 4 m high at 45°, is loaded by its own weight until it slides. You meet plasticity,
F-bar against locking, and a run that goes on after failure.

Taylor (1937) found that a slope of 45° on deep clay stands as long as the stability number N = ρ g
H/c is below 5.53. A firm base at half the height below the toe, as here, helps a little.
"""

# %%
# The body is a polygon. It has its own shape: the squares of the grid do not follow the slope.

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

H, c, density = 4.0, 10e3, 1800.0  # m, Pa, kg/m³
corners, cells = [(0, 0), (20, 8)], (50, 20)
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, cells, mesh.CellType.quadrilateral)
ground = mpm.Polygon([(0, 0), (20, 0), (20, 2), (11, 2), (7, 2 + H), (0, 2 + H)])
points = mpm.fill(grid, ground, per_cell=3, density=density)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test

# %%
# Clay that cannot drain keeps its volume while it flows. Tresca's law says so, and ``fbar=True``
# lets the elements follow. The stabilisation is chosen by name. ``"ghost"`` takes its size from
# the tangent of the law at each facet.

clay = mpm.materials.Tresca(E=1000 * c, nu=0.3, cohesion=c)
gravity = fem.Constant(grid, (0.0, 0.0))
F = mpm.momentum(clay, points, u, v, fbar=True)
F -= ufl.inner(points.density * gravity, v) * points.dX
bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")

# %%
# The weight grows in 40 steps. ``mpm.animate`` makes a film: each ``film.write`` adds a picture.
# A probe follows the crest. A step that does not converge is halved
# by the solver, and nothing is written before it has converged.

crest = mpm.probe(points, (6.8, 5.8))
curve = mpm.History()
look = {"limits": (0, 1), "title": "share of the weight {time:.2f}", "size": (6.5, 3.0)}
with mpm.animate(points, "output/slope.gif", "plastic_strain", **look) as film:
    for share in mpm.steps(40, label="weight"):
        N = 7.5 * share
        gravity.value[1] = -N * c / (density * H)
        problem.step()
        curve.record(N=N, crest=crest)
        film.write(share)

# %%
# Failure is where the crest begins to run away.

moved = -curve["crest_y"]
limit = curve["N"][np.diff(moved, prepend=0.0) > 0.005 * H][0]
if grid.comm.rank == 0:
    print(f"fails at N = {limit:.2f}; the crest has sunk by {moved[-1]:.2f} m in the end")
assert 5.2 < limit < 6.0

# %%
# What it shows
# -------------
# The plastic strain marks the slip surface. A computation of small strains would end at the limit.
# Here the mass slides on until the heap at the toe carries the load.
#
# Try next
# --------
# - ``stabilisation="none"``: the run may fail, and it fails at another load for each position of
#   the grid.
# - ``fbar=False``: the slope stands up to a larger N. This is locking.
# - ``mpm.materials.MohrCoulomb(E, nu, cohesion=..., friction_angle=...)``: angles are in degrees.
# - :doc:`A factor of safety </studies/factor_of_safety>` reduces the strength in place of raising
#   the weight.
