# %% [markdown]
# # Your own stabilisation against the library's
#
# A stabilisation against small cuts is a term of the weak form: an integral over the facets
# beside cut cells, `points.dS`, or over whole active cells, `points.dC`. Both follow the body. A
# new one is a function of three or four lines of UFL. This script has some of them, and runs the
# tests of the built-in stabilisations with them. One table has the largest condition number and
# the smallest critical time step over many places of a block, and the error of a large
# deformation with a known solution. To try another penalty, add it to `OWN`.

# %%
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study

E, NU, RHO, AMPLITUDE = 1.0, 0.0, 1.0, 0.1
BUILT_IN = ("none", "ghost", "aggregation")

# %% [markdown]
# ## New penalties
# Each is a function of the step's increment $u$, the test function $v$, the size $h$ of the
# cells and a modulus $s$, which is Young's modulus for a stiffness and a multiple of
# $\rho h^2$ for a mass. They act on the increment, so that nothing accumulates, and they
# leave a linear motion free, or nearly free:
#
# - jumps of *all* first and second derivatives, $\sum_{k=1}^{2} \gamma s h^{2k-1}
#   \int [[\nabla^k u]] : [[\nabla^k v]]\,\mathrm dS$, which need not know the basis: the
#   first alone is the ghost penalty of linear functions, for the derivative along a facet
#   does not jump, and of quadratic splines only the second is left;
# - jumps of the traction that a linear elastic material would have,
#   $\gamma s h \int [[\varepsilon(u)\,n]] \cdot [[\varepsilon(v)\,n]]\,\mathrm dS$, after
#   the fluxes of Nitsche's method;
# - a share of a gradient's stiffness in whole cells, $\eta s \int \nabla u : \nabla v\,
#   \mathrm dC$, which is not consistent: it also resists a motion without any jump.


# %%
def derivative_jumps(points, u, v, h, s):
    """Jumps of all first and second derivatives."""
    Du, Dv = ufl.grad(u), ufl.grad(v)
    first = ufl.inner(ufl.jump(Du), ufl.jump(Dv))
    second = ufl.inner(ufl.jump(ufl.grad(Du)), ufl.jump(ufl.grad(Dv)))
    return args.factor * s / 90 * (h * first + h**3 * second) * points.dS


def traction_jumps(points, u, v, h, s):
    """Jumps of the traction of a linear elastic material with ν = 0."""
    n = ufl.FacetNormal(points.grid)
    strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    jumps = ufl.inner(ufl.jump(strain_u, n), ufl.jump(strain_v, n))
    return args.factor * s / 90 * h * jumps * points.dS


def cell_gradient(points, u, v, h, s):
    """A share of a gradient's stiffness in whole cells."""
    return args.eta * s * ufl.inner(ufl.grad(u), ufl.grad(v)) * points.dC


OWN = {
    "derivative jumps": derivative_jumps,
    "traction jumps": traction_jumps,
    "cell gradient": cell_gradient,
}


# %%
@dataclass
class Input(Options):
    """New penalties in UFL against the built-in stabilisations."""

    basis: str = option("gimp", choices=BASES)
    stabilisations: str = option(",".join((*BUILT_IN, *OWN)), "by commas")
    offsets: int = option(20, "number of places")
    factor: float = option(1.0, "factor of the new jumps")
    eta: float = option(1e-3, "share in whole cells")
    cells: str = option("8,16,32", "a unit of length, for the errors; by commas")
    points_per_cell: int = natural(3, "in each direction")

    def _check(self):
        for stabilisation in self.stabilisations.split(","):
            if stabilisation not in BUILT_IN and stabilisation not in OWN:
                raise ValueError(
                    f"stabilisation {stabilisation!r} must be one of {', '.join((*BUILT_IN, *OWN))}"
                )


args = Input.parse()
stabilisations = args.stabilisations.split(",")


def stabilised(form, stabilisation, points, u, v):
    """The form with a new penalty, if it is one, and what the solver adds by itself."""
    if stabilisation in OWN:
        h = mpm.cell_size(points.grid)
        return form + OWN[stabilisation](points, u, v, h, E), mpm.Stabilisation("none")
    return form, mpm.Stabilisation(stabilisation, E=E, nu=NU)


# %% [markdown]
# ## Conditioning
# A free elastic block of four by four cells, moved and turned, as in `conditioning.py`.


# %%
def conditioning(stabilisation, offset, angle):
    """Condition numbers and critical step of the block at an offset (cells), turned (degrees)."""
    n = 10
    grid = box_grid([(0, 0), (n, n)], (n, n))
    corner = np.array([3 + offset, 3 + 0.7 * offset])
    points = mpm.fill(grid, mpm.TurnedBox(corner, corner + 4, angle), 2, RHO, aligned="body")
    V = mpm.Space(grid, args.basis)
    u, v = V.increment, V.test
    form = mpm.momentum(mpm.materials.Hencky(E=E, nu=NU), points, u, v)
    form, built_in = stabilised(form, stabilisation, points, u, v)
    problem = mpm.QuasiStatic(form, u, points, stabilisation=built_in)
    h = mpm.cell_size(grid)
    # 90/12: the mass gets as much of the jumps as from the library's ghost penalty
    own_mass = (
        OWN[stabilisation](points, u, v, h, 7.5 * RHO * h**2) if stabilisation in OWN else None
    )
    return study.conditioning(problem, RHO, extra=own_mass)


# %% [markdown]
# ## Error
# The cut block of `manufactured_solution.py`: with $\nu = 0$ and Hencky's law, the body
# force below stretches $[0, \tfrac12]^2$ by $u_i = A\,t \sin \pi X_i$, two edges roll on
# the grid's own, and the two free ones begin a thousandth of a cell beyond a grid line.


# %%
def error(stabilisation, cells):
    """Relative error of the displacement, and what it took."""
    h = 0.5 / (cells // 2 + 1e-3)
    across = int(np.ceil((0.5 + 1.5 * AMPLITUDE) / h)) + 1
    grid = box_grid([(0, 0), (across * h, across * h)], (across, across))
    body = mpm.Box((0, 0), (0.5, 0.5))
    points = mpm.fill(grid, body, args.points_per_cell, RHO, aligned="body")
    V = mpm.Space(grid, args.basis)
    u, v, X, t = V.increment, V.test, points.x0, fem.Constant(grid, 0.0)
    stretches = [1 + AMPLITUDE * t * np.pi * ufl.cos(np.pi * X[i]) for i in range(2)]
    force = ufl.as_vector([
        np.pi**2 * AMPLITUDE * t * ufl.sin(np.pi * X[i]) * E * (1 - ufl.ln(F)) / F**2
        for i, F in enumerate(stretches)
    ])  # fmt: skip
    form = mpm.momentum(mpm.materials.Hencky(E=E, nu=NU), points, u, v)
    form -= ufl.inner(force, v) * points.dX
    form, built_in = stabilised(form, stabilisation, points, u, v)
    bcs = mpm.rollers(V, "left", "bottom")
    problem = mpm.QuasiStatic(form, u, points, bcs, stabilisation=built_in)
    finished = True
    try:
        for share in mpm.steps(int(np.ceil(AMPLITUDE / (0.2 * h))), label=f"{cells} cells"):
            t.value = share
            problem.step()
    except mpm.errors.DolfinMPMError as stopped:
        say(f"{stabilisation} with {cells} cells stopped: {stopped}")
        finished = False
    x0, V0 = points["x0"], points["V0"]
    exact = AMPLITUDE * np.sin(np.pi * x0)
    squares = [V0 @ (w**2).sum(axis=1) for w in (points["x"] - x0 - exact, exact)]
    off, all_of_it = grid.comm.allreduce(np.array(squares))
    return {
        "h": h,
        "cells": cells,
        "error": float(np.sqrt(off / all_of_it)) if finished else None,
        "newton_iterations": sum(record.iterations for record in problem.history),
    }


# %%
golden = (np.sqrt(5) - 1) / 2
places = [(k * golden % 1, k * (np.sqrt(2) - 1) % 1 * 90) for k in range(args.offsets)]
# places where next to nothing is in the outer cells
places[: min(3, args.offsets)] = [(1e-6, 0.0), (1e-3, 0.0), (0.02, 0.0)][: args.offsets]
sizes = [1 / int(n) for n in args.cells.split(",")]
table, swept, curves = [], {}, {}
say(f"{args.basis:17s}    κ(K)     κ(M)  Δt c/h   error of displacement (order)")
for stabilisation in stabilisations:
    swept[stabilisation] = study.sweep(
        lambda place, stabilisation=stabilisation: conditioning(stabilisation, *place),
        places,
        label=stabilisation,
    )
    curves[stabilisation] = study.convergence(
        lambda h, stabilisation=stabilisation: error(stabilisation, round(1 / h)),
        sizes,
        label=stabilisation,
        errors=["error"],
    )
    worst = study.worst(swept[stabilisation])
    rows = curves[stabilisation]
    table.append({
        "stabilisation": stabilisation, "own": stabilisation in OWN, **worst,
        "errors": [row["error"] for row in rows],
        "orders": [row["error_order"] for row in rows[1:]],
        "newton_iterations": [row["newton_iterations"] for row in rows],
    })  # fmt: skip
    errors = (
        "stopped" if row["error"] is None
        else f"{row['error']:.2e}" + (f" ({p:.2f})" if (p := row["error_order"]) else "")
        for row in rows
    )  # fmt: skip
    say(
        f"{stabilisation:17s} {worst['kappa_K']:8.3g} {worst['kappa_M']:8.3g} "
        f"{worst['dt_consistent']:7.3g}  ", *errors,
    )  # fmt: skip

# %% [markdown]
# ## What comes out
# With GIMP and nothing else half of the matrices are singular in floating-point numbers, and
# every stabilisation bounds them. The jumps of all derivatives give half the condition number of
# the ghost penalty, from the same facets. The jumps of traction see only half of a jump of
# shear and give four times that of the ghost penalty. The errors of these three are the same
# to two digits, and smaller than without stabilisation. The gradient in cells is the simplest and
# bounds both matrices too, at the price of almost twice their error on the finest grid.
# Aggregation has by far the smallest condition numbers, and one and a half to two times the
# error of the ghost penalty. Under splines tractions do not jump: with `--basis bspline2` a
# penalty on them does nothing, and the table says so. There the jumps of all derivatives do
# as well as the library's ghost penalty but for a condition number three times as large, and
# the gradient in cells costs more than twice its error.
#
# ## Picture and table

# %%
if not args.no_plot:
    name = f"new_stabilisation_{args.basis}"
    study.write_table(table, args.output / f"{name}.csv")
    if MPI.COMM_WORLD.rank == 0:
        with mpm.figure(args.output / f"{name}.png", 6.6, 3.0, ncols=2) as (whole, (left, right)):
            for k, stabilisation in enumerate(stabilisations):
                kappa = np.array([row["kappa_K"] for row in swept[stabilisation]])
                found = kappa[np.isfinite(kappa)]
                left.semilogx(found, np.full(found.size, k), "|", markersize=9)
                if found.size < kappa.size:
                    left.annotate(
                        f"{kappa.size - found.size} of {kappa.size} singular", (1, k),
                        xycoords=("axes fraction", "data"), xytext=(-4, 9), va="center",
                        ha="right", textcoords="offset points", fontsize=7,
                    )  # fmt: skip
            left.set_yticks(range(len(stabilisations)), labels=stabilisations)
            left.set(xlabel="condition number κ(K), a stroke for each place")
            left.set_ylim(len(stabilisations) - 0.5, -0.7)
            study.draw_convergence(right, curves, nested=True)
            right.set(xlabel="cell size h (m)", ylabel="relative error of displacement")
            whole.legend(
                *right.get_legend_handles_labels(),
                loc="outside upper center",
                ncols=len(stabilisations),
            )

finish(args, {"table": table, "places": len(places), "ranks": MPI.COMM_WORLD.size})
