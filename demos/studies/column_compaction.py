# %% [markdown]
# # An elastic column compacts under its own weight
#
# A column of height $l_0$ stands on a fixed base between smooth walls, and its
# weight is applied in equal steps. With Hencky's law and $\nu = 0$ it compacts to
# less than half its height, so that material points cross many cells.
#
# Equilibrium in one dimension gives the Cauchy stress at a point of original height
# $Y$, whatever the law,
#
# $$\sigma_a(Y) = -\rho_0 g\,(l_0 - Y),$$
#
# and the error of a computation is its mean deviation (Charlton, Coombs & Augarde
# 2017, doi 10.1016/j.compstruc.2017.05.004)
#
# $$e = \frac{\sum_p |\sigma_{yy,p} - \sigma_a(Y_p)|\,V^0_p}{\rho_0 g\, l_0 \sum_p V^0_p}.$$
#
# With the constrained modulus $M = E(1-\nu)/((1+\nu)(1-2\nu))$, Lambert's function
# $W$ and $s = \rho_0 g (l_0 - Y)/M$ the exact height at which the point $Y$ ends is
#
# $$y(Y) = \frac{M}{\rho_0 g}\,\bigl(\Phi(s_0) - \Phi(s)\bigr), \qquad
#   \Phi(s) = W(s) + \tfrac12 W(s)^2 .$$

# %%
import time
from dataclasses import dataclass

started = time.perf_counter()

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option, positive
from scene import finish, say, solver_figures, stabilisation
from scipy.special import lambertw

import dolfinmpm as mpm

# %% [markdown]
# ## The problem
# Square or cubic cells of side $l_0/N$. The last axis is the vertical one.


# %%
def exact_position(Y, height, modulus, weight):
    """Final height (m) of the points that were at Y."""

    def phi(s):
        w = np.real(lambertw(s))
        return w + 0.5 * w**2

    s0, s = weight * height / modulus, weight * (height - Y) / modulus
    return modulus / weight * (phi(s0) - phi(s))


def picture(path, x0, x, stress, height, weight, modulus):
    """Stress and position of the points over their original height, beside the exact ones."""
    up = x.shape[1] - 1
    Y = np.linspace(0, height, 200)
    with mpm.figure(path, width=6.5, height=2.8, ncols=2) as (_, (left, right)):
        left.plot(stress[:, up, up] / 1e3, x0[:, up], ".", label="material points")
        left.plot(-weight * (height - Y) / 1e3, Y, label="exact")
        left.set(xlabel="vertical Cauchy stress (kPa)", ylabel="original height Y (m)")
        right.plot(x[:, up], x0[:, up], ".", label="material points")
        right.plot(exact_position(Y, height, modulus, weight), Y, label="exact")
        right.set(xlabel="final height y (m)", ylabel="original height Y (m)")
        for axes in (left, right):
            axes.legend()


@dataclass
class Input(Options):
    """Self-weight compaction of an elastic column."""

    elements: int = natural(64, "cells over the height")
    columns: int = natural(1, "cells across")
    basis: str = option("gimp", choices=BASES)
    points_per_cell: int | None = natural(None, "in each direction; 2, and 3 for cubic splines")
    steps: int = natural(40)
    modulus: float = positive(10e3, "Young's modulus (Pa)")
    poisson: float = option(0.0, above=-1, below=0.5)
    density: float = positive(80.0, "kg/m³")
    gravity: float = option(10.0, "m/s²")
    initial_height: float = positive(50.0, "l0 (m), at first", flag="--height")
    dimension: int = option(2, choices=(2, 3))
    stabilisation: str | None = option(
        None,
        "none by default, ghost for splines, whose last functions hardly feel the body",
        choices=("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft"),
    )
    ghost: str | None = option(
        None, "ghost penalty of that scaling", choices=("none", "literal", "scaled")
    )
    factor: float | None = option(
        None, "ghost penalty in units of E/30; that of the basis by default"
    )
    points_file: str | None = option(
        None, "CSV of all points at the end", flag="--points", metavar="PATH"
    )

    def _check(self):
        splines = self.basis.startswith("bspline")
        self.fill(points_per_cell=3 if self.basis == "bspline3" else 2)
        if self.ghost is not None:
            self.stabilisation = "none" if self.ghost == "none" else "ghost"
        self.fill(stabilisation="ghost" if splines else "none")
        if self.gravity == 0 or not np.isfinite(self.gravity):
            raise ValueError(f"gravity = {self.gravity} must be finite and not zero")


# %%
args = Input.parse()
d, up = args.dimension, args.dimension - 1
h, height = args.initial_height / args.elements, args.initial_height
weight = args.density * args.gravity
modulus = args.modulus * (1 - args.poisson) / ((1 + args.poisson) * (1 - 2 * args.poisson))
rise = 0
if weight * height / modulus <= -np.exp(-1):
    raise SystemExit(
        f"no equilibrium: density * gravity * height / M = {weight * height / modulus:.4g} must be "
        "above -1/e; a longer or heavier hanging column tears under Hencky's law"
    )
if weight < 0:
    # a hanging column grows; the grid must hold it
    top = exact_position(np.array(height), height, modulus, weight)
    rise = int(np.ceil((1.05 * top - height) / h))

cells = [args.columns] * up + [args.elements + rise]
grid = box_grid([(0.0,) * d, tuple(h * n for n in cells)], cells)
body = mpm.Box((0.0,) * d, (h * args.columns,) * up + (height,))
points = mpm.fill(grid, body, per_cell=args.points_per_cell, density=args.density)

V = mpm.Space(grid, basis=args.basis)
u, v = V.increment, V.test

# %% [markdown]
# ## The weak form
# Internal forces minus weight, both summed over the material points, and if asked for
# a stabilisation against small cuts: the ghost penalty, say, acts on the step's increment across
# the facets of cells at the body's boundary.

# %%
soil = mpm.materials.Hencky(E=args.modulus, nu=args.poisson)
gravity = fem.Constant(grid, (0.0,) * d)
F = mpm.momentum(soil, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
stabilisation = stabilisation(
    args.stabilisation, E=args.modulus, factor=args.factor, scaling=args.ghost or "scaled"
)

sides = ("left", "right") if d == 2 else ("left", "right", "front", "back")
bcs = mpm.rollers(V, *sides) + mpm.fixed(V, "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs=bcs, stabilisation=stabilisation)

# %% [markdown]
# ## Forty steps

# %%
ready = time.perf_counter()
for load in mpm.steps(args.steps, label="gravity"):
    gravity.value[up] = -args.gravity * load
    problem.step()
solved = time.perf_counter()

# %% [markdown]
# ## Error and figures

# %%
comm = grid.comm
Y, V0 = points["x0"][:, up], points["V0"]
sigma, exact = points["stress"][:, up, up], -weight * (height - Y)
deviation = comm.allreduce(np.sum(np.abs(sigma - exact) * V0))
error = deviation / (abs(weight) * height * comm.allreduce(np.sum(V0)))
tops = points["x"][:, up] + points["F"][:, up, up] * points["l0"][:, up]
iterations = [record.iterations for record in problem.history]
figures = {
    "error": float(error),
    "height": float(comm.allreduce(tops.max(initial=0.0), op=MPI.MAX)),
    "height_exact": float(exact_position(np.array(height), height, modulus, weight)),
    **solver_figures(problem),
    "seconds_setup": ready - started,
    "seconds_solve": solved - ready,
}
say(
    f"{args.basis}, {args.elements} elements high, {figures['points']} points, "
    f"{comm.size} rank(s): "
    f"error {error:.5e}, height {figures['height']:.4f} m (exact {figures['height_exact']:.4f} m), "
    f"{sum(iterations)} Newton iterations in {args.steps} steps, "
    f"{figures['seconds_solve']:.2f} s after {figures['seconds_setup']:.2f} s of set-up"
)

# %% [markdown]
# ## Points, picture and ParaView file
# The stress of the points lies on the exact line but for the cells at the top, where
# few points carry little stress, and the base.

# %%
if args.points_file:
    rows = points.gather("x0", "x", "stress")
    if rows is not None:
        x0, x, stress = rows
        # the order of rows must not depend on the number of ranks
        order = np.lexsort(x0.T)
        table = np.hstack([x0, x, stress.reshape(-1, 9)])[order]
        names = [f"{a}{i}" for a in ("X", "x") for i in "xyz"[:d]]
        names += [f"stress_{i}{j}" for i in "xyz" for j in "xyz"]
        np.savetxt(args.points_file, table, delimiter=",", header=",".join(names), comments="")

if not args.no_plot:
    with mpm.ParaView(args.output / "column_compaction.pvd", points) as file:
        file.write(1.0)
    mpm.plot(points, args.output / "column_compaction_points.png")
    rows = points.gather("x0", "x", "stress")
    if rows is not None:
        picture(args.output / "column_compaction.png", *rows, height, weight, modulus)

finish(args, figures)
