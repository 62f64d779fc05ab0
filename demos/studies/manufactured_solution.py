# %% [markdown]
# # A manufactured solution: how fast errors fall, in full cells and in cut ones
#
# Choose a motion, work out the body force that it takes, apply that force, and see how far
# the material points end from where they should. The motion is that of Wallstedt &
# Guilkey (2008, doi 10.1016/j.jcp.2008.07.019) without its inertia. Every coordinate is
# stretched by itself,
#
# $$u_i(X, t) = A\,t \sin \pi X_i, \qquad F_{ii} = 1 + A\,t\,\pi \cos \pi X_i, \qquad
#   J = F_{11} F_{22},$$
#
# where $t$ runs from 0 to 1 and nothing is sheared. With the Kirchhoff stresses
#
# $$\tau_{ii} = \lambda \ln J + \mu\,(F_{ii}^2 - 1) \;\text{(neo-Hooke)}, \qquad
#   \tau_{ii} = \lambda \ln J + 2\mu \ln F_{ii} \;\text{(Hencky)}$$
#
# and $P_{ii} = \tau_{ii} / F_{ii}$, equilibrium $\partial P_{ii} / \partial X_i + f_i = 0$
# asks for a force per initial volume of
#
# $$f_i = \pi^2 u_i \Bigl[ \frac{\lambda\,(1 - \ln J)}{F_{ii}^2}
#   + \mu\,\Bigl(1 + \frac{1}{F_{ii}^2}\Bigr) \Bigr], \qquad
#   f_i = \frac{\pi^2 u_i}{F_{ii}^2}\,
#   \bigl[ \lambda\,(1 - \ln J) + 2\mu\,(1 - \ln F_{ii}) \bigr].$$
#
# **Full cells.** The body is the unit square and fills its grid. The displacement across
# each edge and the traction along it are zero: rollers on all sides.
#
# **Cut cells.** The body is $[0, \tfrac12]^2$ with rollers at the left and at the bottom, in
# a larger grid. With $\nu = 0$ there is no traction at $X_i = \tfrac12$, where
# $F_{ii} = 1$: these two edges are free, lie anywhere in their cells, and move by $A$, so
# that every step has another cut. At first they cut off a given share of a cell, down to
# a thousandth.

# %%
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option, switch
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study

E, RHO = 1e3, 1.0


# %%
@dataclass
class Input(Options):
    """A manufactured solution in full and in cut cells: observed orders."""

    basis: str = option("all", choices=(*BASES, "all"))
    averaged: str = switch("on", "whether splines are averaged over the points' domains")
    scene: str = option("both", choices=("full", "cut", "both"))
    cells: list[int] = option([8, 16, 32, 64], "a unit of length, by commas", least=2)
    cuts: list[float] = option(
        [1e-3, 0.37],
        "share of its first cell that the free edge fills, by commas",
        least=0,
        below=1,
    )
    points_per_cell: int = natural(4, "in each direction")
    amplitude: float = option(0.1, "A (m), below 1/π")
    nu: float = option(0.3, "Poisson's ratio, full cells only")
    law: str = option("neo-hookean", choices=("neo-hookean", "hencky"))
    steps: int | None = natural(
        None,
        "of load; by default so many that a step moves no point further than a fifth of a cell",
    )
    aligned: str = option("body", choices=("body", "grid"))
    stabilisation: str = option(
        "ghost", choices=("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft")
    )

    def _check(self):
        if not 0 < abs(self.amplitude) < 1 / np.pi:
            raise ValueError(f"amplitude = {self.amplitude} must be between 0 and 1/π in size")


args = Input.parse()

# %% [markdown]
# ## The solution
# The same lines serve UFL, which makes the load of them at every point, and NumPy, which
# gives the exact positions and stresses. In UFL the share $t$ of the load is a constant, so
# that a step that fails can be halved.


# %%
class Solution:
    """Displacement, body force and Cauchy stress at X, shape (2,) or (2, n), and load t."""

    def __init__(self, nu, X, t, maths):
        self.lmbda, self.mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
        self.u = [args.amplitude * t * maths.sin(np.pi * X[i]) for i in range(2)]
        self.F = [1 + args.amplitude * t * np.pi * maths.cos(np.pi * X[i]) for i in range(2)]
        self.ln = np.log if maths is np else ufl.ln
        self.J = self.F[0] * self.F[1]

    def force(self):
        """Force per initial volume (N/m³)."""
        lmbda, mu, ln, J = self.lmbda, self.mu, self.ln, self.J
        if args.law == "hencky":
            inside = [(lmbda * (1 - ln(J)) + 2 * mu * (1 - ln(F))) / F**2 for F in self.F]
        else:
            inside = [lmbda * (1 - ln(J)) / F**2 + mu * (1 + 1 / F**2) for F in self.F]
        return [np.pi**2 * u * f for u, f in zip(self.u, inside)]

    def stress(self):
        """Cauchy stresses along the axes and across the plane (Pa)."""
        pressure = self.lmbda * self.ln(self.J)
        if args.law == "hencky":
            tau = [pressure + 2 * self.mu * self.ln(F) for F in self.F]
        else:
            tau = [pressure + self.mu * (F**2 - 1) for F in self.F]
        return [t / self.J for t in (*tau, pressure)]


# %% [markdown]
# ## The problem
# With `aligned="body"` equal parts of the body are the points' first domains, wherever the
# grid's lines are; `--aligned grid` divides the grid's cells and trims what the edge cuts.


# %%
def block(basis, cells, cut=None):
    """Solve with a number of cells a unit of length; the errors and what they cost.

    The body fills its grid if there is no cut, else the free edges start at that share
    of a cell.
    """
    full = cut is None
    side, nu = (1.0, args.nu) if full else (0.5, 0.0)
    h = side / (cells if full else cells // 2 + cut)
    across = cells if full else int(np.ceil((side + 1.5 * max(args.amplitude, 0.0)) / h)) + 1
    grid = box_grid([(0, 0), (across * h, across * h)], (across, across))
    body = mpm.Box((0, 0), (side, side))
    points = mpm.fill(grid, body, args.points_per_cell, RHO, aligned=args.aligned)
    V = mpm.Space(grid, basis, averaged=args.averaged == "on" or basis == "gimp")
    t = fem.Constant(grid, 0.0)
    law = mpm.materials.Hencky if args.law == "hencky" else mpm.materials.NeoHookean
    form = mpm.momentum(law(E=E, nu=nu), points, V.increment, V.test)
    force = ufl.as_vector(Solution(nu, points.x0, t, ufl).force())
    form -= ufl.inner(force, V.test) * points.dX
    bcs = mpm.rollers(V, *(("left", "right", "bottom", "top") if full else ("left", "bottom")))
    stabilisation = mpm.Stabilisation(args.stabilisation, E=E, nu=nu)
    problem = mpm.QuasiStatic(form, V.increment, points, bcs, stabilisation=stabilisation)
    number = args.steps or max(5, int(np.ceil(abs(args.amplitude) / (0.2 * h))))
    figures = {
        "h": h,
        "cells": cells,
        "steps": number,
        "points": points.total,
        **dict.fromkeys(("displacement", "displacement_absolute", "stress")),
    }
    try:
        for share in mpm.steps(number, label=f"{basis}, {cells} cells"):
            t.value = share
            problem.step()
        figures |= errors(points, nu)
    except mpm.errors.DolfinMPMError as stopped:
        say(f"{basis} with {cells} cells stopped: {stopped}")
    figures["newton_iterations"] = sum(record.iterations for record in problem.history)
    figures["halvings"] = sum(record.halvings for record in problem.history)
    return figures


# %% [markdown]
# The errors are root mean squares over the body, $\sqrt{\sum_p V^0_p\,|e_p|^2 / \sum_p
# V^0_p}$, relative to that of the exact field: that of the displacement of the points, and
# that of all components of their stress.


# %%
def errors(points, nu):
    """Errors of displacement and stress of all points."""
    x0, V0 = points["x0"], points["V0"]
    exact = Solution(nu, x0.T, 1.0, np)
    u = np.column_stack(exact.u)
    stress = np.zeros((len(points), 3, 3))
    for i, values in enumerate(exact.stress()):
        stress[:, i, i] = values

    def mean_square(values):
        square = values**2
        parts = square.sum(axis=tuple(range(1, square.ndim)))
        return points.comm.allreduce(V0 @ parts) / volume

    volume = points.comm.allreduce(V0.sum())
    off = np.sqrt(mean_square(points["x"] - x0 - u))
    return {
        "displacement": float(off / np.sqrt(mean_square(u))),
        "displacement_absolute": float(off),
        "stress": float(np.sqrt(mean_square(points["stress"] - stress) / mean_square(stress))),
    }


# %%
scenes = {}
if args.scene != "cut":
    scenes["full cells"] = None
if args.scene != "full":
    scenes |= {f"cut cells, first {cut:g} h": cut for cut in args.cuts}
bases = BASES if args.basis == "all" else (args.basis,)
keys = ("displacement", "stress")

curves, runs, overall = {}, [], {}
for name, cut in scenes.items():
    curves[name] = {}
    for basis in bases:
        rows = study.convergence(
            lambda h, basis=basis, cut=cut: block(basis, round(1 / h), cut),
            [1 / n for n in args.cells],
            errors=keys,
        )
        curves[name][basis] = rows
        runs += [{"scene": name, "cut": cut, "basis": basis, **row} for row in rows]
        h = [row["h"] for row in rows]
        fitted = {key: study.overall_order(h, [row[key] for row in rows]) for key in keys}
        overall[f"{name}, {basis}"] = {k: p if np.isfinite(p) else None for k, p in fitted.items()}
        for key in keys:
            columns = (
                f"{'stopped' if row[key] is None else format(row[key], '.2e')}"
                + (f" ({row[key + '_order']:.2f})" if row[f"{key}_order"] is not None else "")
                for row in rows
            )
            say(f"{name:24s} {basis:9s} {key:13s}", *columns, f" overall {fitted[key]:.2f}")

# %% [markdown]
# ## What to expect
# In one step the points do not move through the grid, and GIMP is a finite element method
# with a simple quadrature: `--basis gimp --steps 1` shows the orders 2.00 in displacement
# and 1.00 in stress, cut or not.
#
# In many steps it does better than that. In each cell the gradient of the increment is
# too large on one side and too small on the other, and a point that travels through the
# cell adds up both. With steps of at most a fifth of a cell the overall orders are about 2.7
# and 1.9, in full and in cut cells alike, and 64 cells have an error of $9\cdot10^{-6}$ in
# place of $2\cdot10^{-4}$. Points that stay in their cells gain nothing: `--amplitude 0.003`
# has the orders 1.9 to 2.3 and 1.0 to 1.1. And the steps must become smaller with the
# cells: with ten of them (`--steps 10`) points jump across two thirds of the smallest cells,
# the errors no longer cancel, and the last orders are 2.0 to 2.2 and 0.7 to 0.9.
#
# Splines start from smaller errors: an eighth (quadratic) and a thirtieth (cubic) of
# GIMP's on eight full cells. On 64 both have the same, $1.6\cdot10^{-6}$, a sixth of GIMP's:
# the stress is taken to be constant over the domain of a point, an error of second order in
# the size of the domains, whatever the degree. Cubic splines on 16 cells with 3, 4 and 8
# points per direction have the errors 3.9, 2.2 and $0.57\cdot10^{-5}$, which fall as the
# squares of the domains' sizes. Overall orders in displacement are therefore 2.6 to 3.0 for
# quadratic splines, which reach that error on the finest grid only, and for cubic ones 1.94
# in full and 2.4 in cut cells. More steps add a little to it, so that orders are somewhat
# below 2 where finer grids take more of them: with 3 points 1.91 and 1.89, but 2.04 and 2.00
# with `--steps 32` on all grids. In stress the orders are 2.3 in full cells. In cut ones they
# are 1.4 to 1.8, for few points weigh what the free edge leaves of a cell; quadratic splines
# with 8 points have 2.6.
#
# With 2 points per cell and direction (`--points-per-cell 2`) quadrature begins to show for
# GIMP too at 32 cells: an edge of the body that lies within a cell has no more than one or
# two points to weigh it with. Orders scatter between 1.4 and 2.6, overall 1.9 to 2.3, and
# errors are up to seven times as large. With 8 points the orders in cut cells are 2.9 and 2.0.
#
# Points that are not averaged over their domains have a floor. Linear functions err by a
# tenth whenever points have crossed cells, and more on finer grids, where they cross more.
# Splines evaluated at points alone (`--averaged off`) stay at errors of
# $1.4\cdot10^{-3}$ to $2.5\cdot10^{-3}$ in displacement and $7\cdot10^{-3}$ in stress: they
# cross smoothly, but the sum over points is no exact integral of their gradients, so that
# not even a constant stress is in equilibrium.

# %% [markdown]
# ## Picture and table

# %%
if not args.no_plot:
    study.write_table(runs, args.output / "manufactured_solution.csv")
    path = args.output / "manufactured_solution.png"
    if MPI.COMM_WORLD.rank == 0:
        with mpm.figure(
            path, 2.2 * len(scenes) + 0.4, 4.4, nrows=2, ncols=len(scenes), sharex="col",
            sharey="row", squeeze=False,
        ) as (whole, axes):  # fmt: skip
            for column, (name, by_basis) in zip(axes.T, curves.items()):
                for ax, key in zip(column, keys):
                    study.draw_convergence(ax, by_basis, key=key, orders=(1, 2, 3))
                column[0].set_title(name)
                column[1].set_xlabel("cell size h (m)")
            for ax, key in zip(axes[:, 0], keys):
                ax.set_ylabel(f"relative error of {key}")
            handles, labels = axes[0, 0].get_legend_handles_labels()
            whole.legend(handles, labels, loc="outside upper center", ncols=len(labels))

finish(args, {"runs": runs, "overall": overall, "ranks": MPI.COMM_WORLD.size})
