"""A strip footing on clay carries 5.14 times the cohesion, and not more.

A smooth rigid strip of half-width 1 m is pressed into weightless clay of Tresca's law, c = 10 kPa.
Prandtl (1921) found the load at which the ground flows from below the strip to its side,

    q = (2 + π) c = 5.14 c,

for any stiffness. The ground keeps its volume while it flows. Each point in a cell is then a
constraint, and linear functions have fewer unknowns than constraints. The ground *locks*. Try
fbar=False: the load is 7 % too high here, and still rises. F-bar takes the change of volume from
the mean over a cell (de Souza Neto et al. 1996, doi 10.1016/0020-7683(95)00259-6).
"""

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

# Half of the ground. Above it the grid has a row of cells for what heaves beside the footing.
h = 0.0625  # m
corners, cells = [(0, 0), (4, 2 + h)], (64, 33)
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, cells, mesh.CellType.quadrilateral)
points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=1000.0)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test

# So stiff that the clay flows before its shape changes: the linear theory's limit is what we want.
E, c = 1e8, 10e3  # Pa
clay = mpm.materials.Tresca(E, 0.33, cohesion=c)
F = mpm.momentum(clay, points, u, v, fbar=True)

# The footing holds the faces of the points under it to its own motion. It is pressed down, not
# loaded: beyond the limit no load would have an equilibrium, but every settlement has one.
under = mpm.Surface(points, lambda x: np.isclose(x[1], 2) & (x[0] < 1), normal=(0, 1))
settlement = fem.Constant(grid, 0.0)
footing = mpm.RigidFooting(under, settlement, rough=False, E=E)
F += footing.contact(u, v)

bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="aggregation")
half = 1.0  # m, of the width
curve = mpm.History()
curve.record(settlement=0.0, pressure=0.0)
for share in mpm.steps(10, label="settlement"):
    settlement.value = 2e-3 * share
    problem.step()
    curve.record(settlement=1e3 * settlement.value, pressure=footing.load() / half / 1e3)

factor = 1e3 * curve["pressure"][-1] / c
if grid.comm.rank == 0:
    print(f"bearing factor {factor:.3f}, Prandtl {2 + np.pi:.3f}")
mpm.plot(points, "output/footing.png", "plastic_strain", limits=(0, 0.005), size=(5.5, 3.5))
with mpm.figure("output/footing_curve.png") as (_, axes):
    axes.axhline((2 + np.pi) * c / 1e3, color="0.6", lw=1, ls="--", label="Prandtl")
    axes.plot(curve["settlement"], curve["pressure"], "o-", ms=3, label="material points")
    axes.set(xlabel="settlement (mm)", ylabel="pressure of the footing (kPa)", ylim=(0, 60))
    axes.legend(loc="lower right")
assert abs(factor / (2 + np.pi) - 1) < 0.03
