# %% [markdown]
# # A strip footing on saturated ground: settlement in time
#
# Ground of the depth 5B on a rigid rough base carries an even load q on a strip 2B wide. It
# drains at its top. A part of the settlement comes at once, without drainage, because the ground
# moves to the sides. The rest comes as water leaves. Half is computed, between smooth walls. Base
# and walls are sealed. Strains are small.
#
# For ν = 0.2, half width 10B and depth 5B the settlements and pressures are compared with those of
# conforming elements of quadratic displacement and linear pressure.

# %%
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import natural, option, other_default, positive
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

import dolfinmpm as mpm

TIMES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
# of conforming elements for the case above: T, E s/(qB) in the centre and at the edge, p/q at the
# depths B and 2B
CONFORMING = np.array([
    (0.03, 1.375, 0.792, 0.517, 0.328),
    (0.1, 1.493, 0.848, 0.521, 0.340),
    (0.3, 1.655, 0.940, 0.387, 0.346),
    (1.0, 1.879, 1.107, 0.186, 0.264),
    (3.0, 2.131, 1.332, 0.083, 0.144),
    (10.0, 2.453, 1.640, 0.026, 0.048),
])  # fmt: skip


# %%
@dataclass
class Input(InTime):
    """Consolidation under a strip footing."""

    poisson: float = 0.2
    width: float = option(10.0, "half of the ground's, by B")
    depth: float = option(5.0, "of the ground, by B")
    h: float = positive(0.125, "size of the cells, by B; divides all lengths")
    points_per_cell: int = natural(2)
    times: list[float] = other_default(InTime, "times", list(TIMES))
    steps: int = other_default(InTime, "steps", 60)


args = Input.parse()
comm, nu, B, E = MPI.COMM_WORLD, args.poisson, 1.0, MODULUS
q, c_v = SMALL * E, consolidation_coefficient(E, nu)
W, D, h = args.width, args.depth, args.h
cells = round(W / h), round(D / h)

# %%
grid = box_grid([(0, 0), (W, D + h)], (cells[0], cells[1] + 1))
points = mpm.fill(grid, mpm.Box((0, 0), (W, D)), args.points_per_cell, 1.0)
V, Q = mpm.Space(grid, "linear"), mpm.Space(grid, "linear", shape=())
u, v = V.increment, V.test
top = mpm.Surface(points, lambda x: x[1] > D * (1 - 1e-9), (0, 1), name="top")
strip = mpm.Surface(points, lambda x: (x[1] > D * (1 - 1e-9)) & (x[0] < B), (0, 1), name="strip")
F = mixture(args, points, V, Q, top)
load = fem.Constant(grid, (0.0, -q))
F += strip.traction(load, v)
bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
problem = mpm.Transient(F, [u, Q.increment], points, bcs, stabilisation=[args.stabilisation] * 2)
# what nodes of the top have moved: increments of all steps together
moved = {0.0: 0.0, B: 0.0}
measured = []
for T in instants(args.times, args.steps):
    problem.step(T * B**2 / c_v)
    for x in moved:
        moved[x] -= node_value(V, (x, D), 1)
    if T in args.times:
        settled = [E * moved[x] / (q * B) for x in moved]
        pressures = [node_value(Q, (0.0, D - depth)) / q for depth in (B, 2 * B)]
        measured.append((*settled, *pressures))
names = ("settlement_centre", "settlement_edge", "pressure_1b", "pressure_2b")
columns = dict(zip(names, np.array(measured).T))
compared = (nu, W, D) == (0.2, 10.0, 5.0) and set(args.times) <= set(CONFORMING[:, 0])
if compared:
    rows = CONFORMING[np.isin(CONFORMING[:, 0], args.times)]
    columns |= {f"{name}_exact": values for name, values in zip(names, rows.T[1:])}
report(args, problem, columns, compared=compared)
