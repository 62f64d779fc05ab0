# %% [markdown]
# # Mandel's problem: the pressure in the middle rises before it falls
#
# A slab of saturated soil is 2a wide. Two rigid smooth plates press it with a force 2F (per
# length). It drains at its sides. The rim drains first and becomes softer. So the core must carry
# more, and its pressure rises above the first value, although no load is added (Mandel 1953;
# Cheng & Detournay 1988). The exact solution for an incompressible fluid is a series over the
# roots of $\tan\alpha = \frac{2(1 - \nu)}{1 - 2\nu}\,\alpha$.
#
# A quarter is computed. A membrane without bending stiffness stands for the plate. Its tension is
# so large that it stays flat.

# %%
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import natural, option, other_default
from poroelastic import (
    MODULUS,
    SMALL,
    InTime,
    consolidation_coefficient,
    instants,
    mixture,
    node_value,
    report,
)
from scipy.optimize import brentq

import dolfinmpm as mpm

TIMES = (0.01, 0.05, 0.1, 0.3, 0.5, 1.0, 2.0)


# %%
@dataclass
class Input(InTime):
    """Mandel's problem."""

    poisson: float = 0.2
    width: float = option(1.0, "a, half of the slab's (m)")
    height: float = option(0.25, "b, half of the slab's (m)")
    cells: int = option(32, "over the half width")
    points_per_cell: int = natural(2)
    times: list[float] = other_default(InTime, "times", list(TIMES))
    steps: int = other_default(InTime, "steps", 150)


args = Input.parse()
comm, nu, a = MPI.COMM_WORLD, args.poisson, args.width
E = MODULUS
G, c_v = E / (2 * (1 + nu)), consolidation_coefficient(E, nu)
force = SMALL * E * a
h = a / args.cells
rows = max(2, round(args.height / h))
b = rows * h


# %%
def series(times, count=200):
    """Pressure in the middle and half way (by F/a), u_x at the rim and −u_z (by F/G, F b/(G a))."""
    ratio = 2 * (1 - nu) / (1 - 2 * nu)
    roots = np.array([
        brentq(lambda x: np.sin(x) - ratio * x * np.cos(x),
               k * np.pi + (1e-9 if k else 0.1), (k + 0.5) * np.pi - 1e-12)
        for k in range(count)
    ])  # fmt: skip
    s, c = np.sin(roots), np.cos(roots)
    found = []
    for T in times:
        decay = np.exp(-(roots**2) * T) / (roots - s * c)

        def pressure(x, decay=decay):
            return np.sum(decay * s * (np.cos(roots * x) - c))

        # with ν_u = 1/2
        u_x = nu / 2 - np.sum(decay * s * c) / 2 + np.sum(decay * c * s)
        u_z = (1 - nu) / 2 - np.sum(decay * s * c) / 2
        found.append((pressure(0.0), pressure(0.5), u_x, u_z))
    return np.array(found).T


# %%
grid = box_grid([(0, 0), (a + h, b + h)], (args.cells + 1, rows + 1))
points = mpm.fill(grid, mpm.Box((0, 0), (a, b)), args.points_per_cell, 1.0)
V, Q = mpm.Space(grid, "linear"), mpm.Space(grid, "linear", shape=())
u, v = V.increment, V.test
top = mpm.Surface(points, lambda x: x[1] > b * (1 - 1e-9), (0, 1))
side = mpm.Surface(points, lambda x: x[0] > a * (1 - 1e-9), (1, 0))
F = mixture(args, points, V, Q, side)
# a membrane that stays flat, loaded by all of the force
tension = fem.Constant(grid, 1e4 * E * a)
F += top.density * tension * ufl.grad(u)[1, 0] * ufl.grad(v)[1, 0] * points.dX
load = fem.Constant(grid, (0.0, 0.0))
F += top.traction(load, v)
load.value[1] = -force / a
problem = mpm.Transient(
    F, [u, Q.increment], points, mpm.rollers(V, "left", "bottom"),
    stabilisation=[args.stabilisation] * 2,
)  # fmt: skip
measured = []
for T in instants(args.times, args.steps):
    problem.step(T * a**2 / c_v)
    if T in args.times:
        measured.append((
            node_value(Q, (0.0, 0.0)) * a / force,
            node_value(Q, (0.5 * a, 0.0)) * a / force,
            side.mean_displacement()[0] * G / force,
            -top.mean_displacement()[1] * G * a / (force * b),
        ))  # fmt: skip
names = ("pressure_centre", "pressure_half", "u_x", "u_z")
columns = {}
for name, ours, exact in zip(names, np.array(measured).T, series(args.times)):
    columns |= {name: ours, f"{name}_exact": exact}
errors = {
    f"{name}_error": float(np.abs(columns[name] - columns[f"{name}_exact"]).max()
                           / np.abs(columns[f"{name}_exact"]).max())
    for name in names
}  # fmt: skip
report(args, problem, columns, **errors)
