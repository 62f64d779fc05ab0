"""A cantilever bends under a dead load until its tip almost points down.

The beam, 10 m by 1 m, carries P = 100 kN at its free end: PL²/EI = 10. Its points turn by 80° and
pass through many cells. The exact shape of a thin beam is Euler's elastica,

    EI θ″ = −P cos θ,  θ(0) = 0,  θ′(L) = 0,

with the slope θ along the arc. Its tip falls by 0.811 L, and comes 0.555 L closer to the support
(Bisshopp & Drucker 1945, doi 10.1090/qam/13360). This beam is only ten times as long as deep, so it
also shears and stretches. Conforming elements give a fall of 0.828 L.
"""

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.integrate import solve_bvp

import dolfinmpm as mpm

# The grid must have room for the whole motion; cells that the beam does not reach cost nothing.
corners, cells = [(0, -10), (10.5, 1.5)], (42, 46)
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, cells, mesh.CellType.quadrilateral)
points = mpm.fill(grid, mpm.Box((0, -0.5), (10, 0.5)), per_cell=6, density=1.0)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test

# A load acts on the faces of points, for at their centres it would have another lever arm.
# A traction is dead: it keeps its direction and acts per area as it was at first.
end = mpm.Surface(points, lambda x: np.isclose(x[0], 10), normal=(1, 0))
P = fem.Constant(grid, (0.0, 0.0))  # N/m
rubber = mpm.materials.Hencky(E=12e6, nu=0.2)
F = mpm.momentum(rubber, points, u, v) + end.force(P, v)
# Without it a point that just enters a cell gives its nodes almost no stiffness.
F += mpm.ghost(points, u, v, gamma=12e6 / 30)

# Rollers let the support shrink and swell; a single node, on the axis, keeps the beam from falling.
on_axis = mpm.prescribed(V, lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0), 1)
problem = mpm.QuasiStatic(F, u, points, bcs=mpm.rollers(V, "left") + on_axis)
for share in mpm.steps(25, label="tip load"):
    P.value[1] = -100e3 * share
    problem.step()

# The elastica, with s = x/L and α = PL²/EI: slope, curvature, and the place of the tip.
alpha = 100e3 * 10**2 / (12e6 / 12)
s = np.linspace(0, 1, 101)
elastica = solve_bvp(
    lambda s, y: [y[1], -alpha * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])],
    lambda a, b: np.array([a[0], b[1], a[2], a[3]]),
    s, [s, 1 - s, s, s],
)  # fmt: skip
exact = elastica.sol(1)[3]
down = -end.mean_displacement()[1] / 10
if grid.comm.rank == 0:
    print(f"the tip is {down:.4f} L down, that of the elastica {exact:.4f} L")
mpm.plot(points, "output/cantilever.png", "stress", component="mises")
assert abs(down - exact) < 0.02
