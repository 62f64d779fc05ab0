"""A strip curls up because one half of it grows: an energy of one's own, in UFL.

A strip is 16 m long and 1 m thick. Its lower half grows along its axis by ε = 10 %. Its upper half
does not grow. So the strip bends, with the curvature of two bonded layers that are equally thick
and stiff (Timoshenko 1925, doi 10.1364/JOSA.11.000233),

    κ = 3/2 · ε / (1 m).

Its end turns by 2.4, or 137°. The grid stays as it is.

Growth and elasticity are UFL in this program, and not part of the library. The library splits the
form into its parts at points and at nodes, derives flux and tangent, compiles them, and moves the
points.
"""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

n, length = 6, 16  # cells over the thickness; m
corners, cells = [(0, -1), (17, 13)], (17 * n, 14 * n)
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, cells, mesh.CellType.quadrilateral)
points = mpm.fill(grid, mpm.Box((0, -0.5), (length, 0.5)), per_cell=3, density=1.0)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test

# Growth is a field of the points, which they take with them. The constant takes it from nothing
# to its end, step by step.
points.add_field("growth")
points["growth"] = 0.1 * (points["x0"][:, 1] < 0)
progress = fem.Constant(grid, 0.0)

# points.F is the deformation gradient at the start of the step, (I + ∇u) F that at its end.
# Growth is a stress-free part of it, and only the rest stores energy (Rodriguez, Hoger &
# McCulloch 1994, doi 10.1016/0021-9290(94)90021-3): F = Fe Fg.
E, nu = 1e3, 0.3  # Pa
mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
g = 1 + progress * points.growth
Fe = (ufl.Identity(2) + ufl.grad(u)) * points.F * ufl.as_matrix([[1 / g, 0], [0, 1]])
J = ufl.det(Fe)
psi = mu / 2 * (ufl.inner(Fe, Fe) - 2) - mu * ufl.ln(J) + lmbda / 2 * ufl.ln(J) ** 2
F = ufl.derivative(g * psi * points.dX, u, v) + mpm.ghost(points, u, v, gamma=E / 30)

# Nothing pulls: rollers at the left, and one node on the axis that keeps the strip from floating.
on_axis = mpm.prescribed(V, lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0), 1)
points.add_field("energy", unit="J/m^3")
problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left") + on_axis, updates={"energy": psi})
for share in mpm.steps(20, label="growth"):
    progress.value = share
    problem.step()

# How far the strip's end has turned, from the rotations of its last points.
a = points["F"][points["x0"][:, 0] > length - 0.5]
turned = np.arctan2(a[:, 1, 0] - a[:, 0, 1], a[:, 0, 0] + a[:, 1, 1])
angle = grid.comm.allreduce(turned.sum()) / grid.comm.allreduce(turned.size)
exact = 1.5 * 0.1 * (length - 0.25)
if grid.comm.rank == 0:
    print(f"the end has turned by {angle:.4f}, Timoshenko {exact:.4f}")
mpm.plot(points, "output/growing_strip.png", "energy", size=(5.5, 4.5))
assert abs(angle / exact - 1) < 0.02
