# %% [markdown]
# # A square footing on saturated ground in three dimensions
#
# A quarter of a block of ground, 1 m wide and deep, carries an even load on a square of 0.3 m in
# its corner. It drains at its top, and the load presses it in deeply. GMRES with a field split
# solves for displacement and pore pressure together. The number of its iterations should depend
# neither on the number of unknowns nor on the permeability.
#
# `--compare` also solves each size with the factors of MUMPS, each run in its own process to
# measure its memory. It compares the cost of a step and the error of the settlement.

# %%
from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import Options, natural, option
from scene import finish, say, solver_figures

import dolfinmpm as mpm


# %%
@dataclass
class Input(Options):
    """A square footing on saturated ground in 3D."""

    cells: list[int] = option([14, 20], "in each direction, by commas")
    permeability: list[float] = option([1e-6], "k (m/s), by commas")
    steps: int = natural(4, "in which the load is put on, 1 s each")
    load: float = option(0.1, "by Young's modulus")
    basis: str = option("gimp", choices=("linear", "gimp", "bspline2"))
    points_per_cell: int = natural(2)
    direct: bool = option(False, "factors in place of iterations")
    compare: bool = option(
        False, "with factors and with iterations, one rank; cells in multiples of 5"
    )


args = Input.parse()
comm, E, nu = MPI.COMM_WORLD, 1e7, 0.3


def run(cells: int, permeability: float):
    """Take the steps; figures of the run, and the problem."""
    h = 1 / cells
    grid = box_grid([(0, 0, 0), (1, 1, 1 + h)], (cells, cells, cells + 1))
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 1)), args.points_per_cell, 2000.0)
    V, Q = mpm.Space(grid, args.basis), mpm.Space(grid, args.basis, shape=())
    top = mpm.Surface(points, lambda x: x[2] > 1 - 1e-9, (0, 0, 1), name="top")
    square = mpm.Surface(
        points, lambda x: (x[2] > 1 - 1e-9) & (x[0] < 0.3) & (x[1] < 0.3), (0, 0, 1), name="square"
    )
    F = mpm.poromechanics(
        mpm.materials.Hencky(E=E, nu=nu), points, (V.increment, Q.increment), (V.test, Q.test),
        permeability=permeability, porosity=0.4, drained=top,
    )  # fmt: skip
    load = fem.Constant(grid, (0.0, 0.0, 0.0))
    F += square.traction(load, V.test)
    bcs = mpm.rollers(V, "left", "right", "front", "back") + mpm.fixed(V, "bottom")
    own = {"pc_type": "lu", "ksp_type": "preonly"} if args.direct else {}
    problem = mpm.Transient(
        F, [V.increment, Q.increment], points, bcs, stabilisation=["ghost", "ghost"],
        petsc_options=own,
    )  # fmt: skip
    clocks = [(time.perf_counter(), time.process_time())]
    for share in mpm.steps(args.steps, label=f"{cells}³ cells"):
        load.value[2] = -args.load * E * share
        problem.step(share * args.steps)
        clocks.append((time.perf_counter(), time.process_time()))
    # the first step compiles
    first = clocks[min(1, args.steps - 1)]
    own = (np.array(clocks[-1]) - first) / max(args.steps - 1, 1)
    linear = [count for record in problem.history for count in record.linear_iterations]
    figures = {
        "cells": cells,
        "permeability": permeability,
        "settlement": float(-square.mean_displacement()[2]),
        "linear_iterations": linear,
        "mean_iterations": float(np.mean(linear)) if linear else None,
        "seconds_a_step": float(own[0]),
        "seconds_processor": comm.allreduce(float(own[1])),
        "megabytes": comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "largest_pressure": comm.allreduce(points["pressure"].max(initial=0.0), op=MPI.MAX),
        **solver_figures(problem),
    }
    return figures, problem


# %% [markdown]
# ## Factors beside iterations
# The error is that of the settlement against the limit of fine cells, which the two largest sizes
# tell if it is of first order, as the square's edge makes it. The loaded points have the square's
# area in numbers of cells that are multiples of 5.


# %%
def alone(cells: int, direct: bool):
    """One run in a process of its own; None where there is no memory for it."""
    words = ["--cells", cells, "--permeability", args.permeability[0], "--steps", args.steps]
    words += ["--load", args.load, "--basis", args.basis, "--points-per-cell", args.points_per_cell]
    words += ["--json", "-", "--no-plot", *(["--direct"] if direct else [])]
    # what this process's own MPI put into the environment is not for others
    own = {k: v for k, v in os.environ.items() if not k.startswith(("PMIX_", "OMPI_COMM_"))}
    command = [sys.executable, __file__, *map(str, words)]
    done = subprocess.run(command, env=own, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        say(f"{cells}³ cells, {'factors' if direct else 'iterations'}: code {done.returncode}")
        return None
    return json.loads(done.stdout.splitlines()[-1])["runs"][0]


def compare():
    """Rows of all sizes, by both methods."""
    rows = []
    for cells in args.cells:
        row = {"cells": cells, "iterations": alone(cells, False), "factors": alone(cells, True)}
        both = [row[name] for name in ("iterations", "factors") if row[name]]
        if both:
            rows.append(row | {"unknowns": both[0]["unknowns"], "settled": both[0]["settlement"]})
    limit = None
    if len(rows) > 1:
        (n, s), (m, t) = ((row["cells"], row["settled"]) for row in rows[-2:])
        limit = (m * t - n * s) / (m - n)
    say("unknowns   error  CPU s per step: factors  iterations  ratio  MB: factors  iterations")
    for row in rows:
        row["error"] = None if limit is None else abs(row["settled"] / limit - 1)
        factors, found = row["factors"], row["iterations"]
        text = f"{row['unknowns']:8d} {row['error'] or 0:7.4f}"
        if factors and found:
            row["ratio"] = factors["seconds_processor"] / found["seconds_processor"]
            row["apart"] = abs(factors["settlement"] / found["settlement"] - 1)
            text += f" {factors['seconds_processor']:22.2f} {found['seconds_processor']:11.2f}"
            text += f" {row['ratio']:6.2f} {factors['megabytes']:12.0f} {found['megabytes']:11.0f}"
        say(text)
    return rows, limit


def draw_comparison(rows):
    """Time and memory of a step against the error and the unknowns."""
    with mpm.figure(args.output / "footing_3d_compared.png", 6.4, 2.6, ncols=2) as (_, axes):
        left, right = axes
        for name, mark in (("factors", "s-"), ("iterations", "o-")):
            own = [row for row in rows if row[name]]
            cpu = [row[name]["seconds_processor"] for row in own]
            left.loglog(cpu, [row["error"] for row in own], mark, ms=3, label=name)
            memory = [row[name]["megabytes"] / 1e3 for row in own]
            right.loglog([row["unknowns"] for row in own], memory, mark, ms=3, label=name)
        left.set(xlabel="processor seconds per step", ylabel="error of the settlement")
        right.set(xlabel="unknowns", ylabel="memory (GB)")
        left.legend()


if args.compare:
    if comm.size > 1:
        raise SystemExit("--compare is for one rank")
    rows, limit = compare()
    if not args.no_plot and limit is not None:
        draw_comparison(rows)
    finish(args, {"rows": rows, "limit": limit})
    raise SystemExit

# %%
runs = []
for permeability in args.permeability:
    for cells in args.cells:
        figures, problem = run(cells, permeability)
        runs.append(figures)
        mean = figures["mean_iterations"]
        say(
            f"{cells:3d}³ cells, {figures['unknowns']:7d} unknowns, k = {permeability:g} m/s: "
            f"{figures['newton_iterations']} Newton iterations"
            + (f", {mean:.1f} linear ones each" if mean else "")
            + f", {figures['seconds_a_step']:.1f} s per step; settled by "
            f"{figures['settlement']:.4f} m, pressure at most {figures['largest_pressure']:.4g} Pa"
        )

# %%
if not args.no_plot:
    points = problem.points
    x, p = points["x"], points["pressure"]
    # the points next to one of the planes of symmetry
    near = points["x0"][:, 1] < 0.51 / runs[-1]["cells"]
    x, p = (np.concatenate(comm.gather(a[near]) or [a[near]]) for a in (x, p))
    if comm.rank == 0:
        with mpm.figure(args.output / "footing_3d.png", 4.2, 3.4) as (figure, axes):
            drawn = axes.scatter(x[:, 0], x[:, 2], s=4, c=p / 1e3, cmap="viridis", linewidths=0)
            axes.set(aspect="equal", xlabel="$x$ (m)", ylabel="$z$ (m)")
            figure.colorbar(drawn, label="pore pressure (kPa)")
finish(args, {"runs": runs, "ranks": comm.size})
