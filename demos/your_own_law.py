"""A law of one's own: soil that grows stiffer the more it is compressed.

A law takes three principal logarithmic strains. It gives three principal Kirchhoff stresses and
their nine derivatives. Numba compiles it. The library does the rest: rotation into principal axes,
kinematics of large strain, tangent, state of the points. Here the mean stress grows exponentially
with the volume strain ε_v, as e–log p lines of soils do,

    τ_m = −p₀ (exp(−ε_v/κ) − 1),  dev τ = 2 G dev ε.

The test is a column of 20 m under its own weight. Equilibrium alone gives the Cauchy stress,
σ(Y) = −ρ₀ g (20 m − Y), and the law then gives the strain at each height.

demos/studies/your_own_law.py has a law that yields and hardens, and one that needs no kernel,
because UFL derives it from an energy and a yield function.
"""

import math

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.materials import Law, Parameter, law_kernel


@law_kernel
def stiffening(parameters, strain, old, new, stress, tangent):
    p0, kappa, G = parameters[0], parameters[1], parameters[2]
    volume = strain[0] + strain[1] + strain[2]
    growth = math.exp(-volume / kappa)
    for i in range(3):
        stress[i] = -p0 * (growth - 1) + 2 * G * (strain[i] - volume / 3)
        for j in range(3):
            tangent[3 * i + j] = p0 / kappa * growth - 2 * G / 3
        tangent[4 * i] += 2 * G
    return 0  # anything else: the strain admits no stress


class Stiffening(Law):
    """What the kernel's parameters are called, and what they may be."""

    parameters = {
        "p0": Parameter("Pa", low=0),
        "kappa": Parameter("", low=0),
        "G": Parameter("Pa", low=0),
    }
    kernel = stiffening


# A wrong tangent still converges, but slowly, and is hard to find in a whole computation. A law
# can be asked without a grid: compare with differences of its stress.
soil = Stiffening(p0=20e3, kappa=0.1, G=100e3)
strain, small = np.array([-0.2, -0.1, 0.05]), 1e-6
ahead, behind = (soil.respond(strain + s * np.eye(3)).stress for s in (small, -small))
np.testing.assert_allclose(soil.respond(strain).tangent[0], (ahead - behind).T / (2 * small), 1e-6)

# The column: the grid is a line, all else is as in two and three dimensions.
height, weight = 20.0, 20e3  # m, N/m³
grid = mesh.create_interval(MPI.COMM_WORLD, 40, [0, height])
points = mpm.fill(grid, mpm.Box(0, height), per_cell=3, density=2000.0)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test
gravity = fem.Constant(grid, (0.0,))
F = mpm.momentum(soil, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
F += mpm.ghost(points, u, v, gamma=1e4)
problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "left"))
for share in mpm.steps(20, label="gravity"):
    gravity.value[0] = -weight / 2000 * share
    problem.step()

# The exact strain ε(Y), read from a table of the law's own σ = τ/J with J = exp(ε)
table = np.linspace(-0.5, 0, 2001)
sigma = soil.respond(table[:, None] * [1, 0, 0]).stress[:, 0] / np.exp(table)
Y = np.linspace(0, height, 1001)
exact = np.interp(-weight * (height - Y), sigma, table)
exact_height = np.trapezoid(np.exp(exact), Y)
top = points["x"][:, 0] + points["F"][:, 0, 0] * points["l0"][:, 0]
top = grid.comm.allreduce(top.max(initial=0.0), MPI.MAX)
rows = points.gather("x0", "F")  # None but on rank 0
if rows is not None:
    print(f"height {top:.4f} m, exact {exact_height:.4f} m")
    with mpm.figure("output/your_own_law.png") as (_, axes):
        axes.plot(np.log(rows[1][:, 0, 0]), rows[0][:, 0], ".", label="material points")
        axes.plot(exact, Y, label="exact", zorder=1)
        axes.set(xlabel="logarithmic strain", ylabel="initial height $Y$ (m)")
        axes.legend()
assert abs(top / exact_height - 1) < 1e-3
