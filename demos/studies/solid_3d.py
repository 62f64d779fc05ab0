# %% [markdown]
# # Three dimensions: what a step takes, and how many iterations
#
# In three dimensions factors of the tangent take most of the time, so that iterations solve the
# linear systems. This study counts them. Two bodies:
#
# - `block`: an elastic cube of side 1 m that compacts under its weight, on rollers, in two steps.
#   Its upper and outer faces cut the cells where `--cuts` says (shares of a cell), or at random;
# - `slope`: a slope of Mohr–Coulomb soil at 45°, as high as wide, between smooth walls, under its
#   weight in steps until it yields at its toe, where its strength gives way at one end.
#
# Conjugate gradients have multigrid on the grid's own levels, or with `--solver gamg` algebraic
# multigrid; a plastic tangent that is not symmetric takes GMRES.

# %%
from __future__ import annotations

import resource
import time
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option
from scene import finish, say

import dolfinmpm as mpm

GRAVITY = 10.0


@dataclass
class Input(Options):
    """A block or a slope in three dimensions: iterations, seconds and memory."""

    scene: str = option("block", choices=("block", "slope"))
    cells: list[int] = option([8, 12], "along the body's edge")
    cuts: list[float] = option([0.3], "shares of a cell")
    random: int = option(0, "so many draws instead: cells, cut from 1e-6 on, nu", least=0)
    nu: float = option(0.3, "Poisson's ratio; of draws the largest", least=0, below=0.5)
    levels: int = option(0, "halvings of the cells towards the block's upper corner", least=0)
    basis: str = option("linear", choices=BASES)
    stabilisation: str = option("ghost", "a stabilisation against small cuts")
    points_per_cell: int = natural(2, "in each direction")
    steps: int | None = natural(None, "2 of the block, 10 of the slope by default")
    solver: str = option("own", "or factors, or GAMG", choices=("own", "direct", "gamg"))
    rtol: float | None = option(None, "of linear systems; what Newton can use by default")


args = Input.parse()


# %%
def block(n, cut, nu):
    """The elastic block; returns grid, body, density (kg/m³) and law."""
    h = 1.0 / n
    side = (n + 4) * h
    grid = box_grid([(0, 0, 0), (side,) * 3], (n + 4,) * 3)
    body = mpm.Box((0, 0, 0), (1 + cut * h,) * 3)
    return grid, body, 1000.0, mpm.materials.Hencky(E=1e6, nu=nu)


def slope(n, cut, nu):
    """A slope, weaker at one end of it, 10 m high."""
    h = 10.0 / n
    cells = 2 * n + 2, n, n + 1
    grid = box_grid([(0, 0, 0), tuple(h * k for k in cells)], cells)
    high, foot = 10.0 + cut * h, 2.0
    body = mpm.Where(
        lambda x: (x[2] <= high) & ((x[2] <= foot) | (x[0] + x[2] <= 10 + foot + cut * h))
    )
    soil = mpm.materials.MohrCoulomb(
        E=20e6, nu=nu, cohesion=lambda x: np.where(x[1] < 5, 11e3, 20e3),
        friction_angle=20.0, dilation_angle=0.0,
    )  # fmt: skip
    return grid, body, 2000.0, soil


def run(n, cut, nu):
    """Load a body with its weight; returns figures and points."""
    grid, body, density, law = (block if args.scene == "block" else slope)(n, cut, nu)
    V, refine = mpm.Space(grid, args.basis), None
    if args.levels:

        def size(x):
            return 0.3 * np.linalg.norm(x.T - 1.0, axis=1)

        own = {"refine": size, "levels": args.levels, "per_cell": args.points_per_cell}
        V = refine = mpm.Space(grid, args.basis, **own)
    points = mpm.fill(grid, body, args.points_per_cell, density, refine=refine)
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0, 0.0))
    F = mpm.momentum(law, points, u, v)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    sides = ("left", "front") if args.scene == "block" else ("left", "front", "back")
    bcs = mpm.rollers(V, *sides) + mpm.fixed(V, "bottom")
    given = {} if args.rtol is None else {"ksp_rtol": args.rtol}
    if args.solver == "direct":
        given |= {"ksp_type": "preonly", "pc_type": "lu"}
    elif args.solver == "gamg":
        given |= {"pc_type": "gamg"}
    problem = mpm.QuasiStatic(
        F, u, points, bcs, tolerance=1e-8, stabilisation=args.stabilisation, petsc_options=given
    )
    steps = args.steps or (2 if args.scene == "block" else 10)
    started, used = time.perf_counter(), time.process_time()
    for k in range(steps):
        gravity.value[2] = -GRAVITY * (k + 1) / steps
        record = problem.step()
        say(
            f"  step {k + 1}: {record.seconds:.2f} s, {record.iterations} Newton iterations, "
            f"linear {record.linear_iterations}"
        )
    seconds, used = time.perf_counter() - started, time.process_time() - used
    history, comm = problem.history, points.comm
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    linear = [its for r in history for its in r.linear_iterations]
    yielding = 0
    if args.scene == "slope":
        yielding = comm.allreduce(int(np.count_nonzero(points["plastic_strain"] > 1e-6)))
    figures = {
        "cells": n,
        "cut": cut,
        "nu": nu,
        "points": points.total,
        "unknowns": history[-1].unknowns,
        "seconds_a_step": seconds / steps,
        "seconds_first": history[0].seconds,
        "seconds_later": float(np.median([r.seconds for r in history[1:] or history])),
        "seconds_processor": comm.allreduce(used / steps, op=MPI.MAX),
        "newton_iterations": [r.iterations for r in history],
        "linear_iterations": linear,
        "halvings": sum(r.halvings for r in history),
        "yielding": yielding,
        "settlement": comm.allreduce(float((points["x0"] - points["x"])[:, 2].max()), op=MPI.MAX),
        "megabytes": comm.allreduce(megabytes),
        "method": str(problem.newton.linear.method),
    }
    say(
        f"{n:4d} cells, cut {cut:<8g} {figures['points']:8d} points {figures['unknowns']:8d} "
        f"unknowns, first step {figures['seconds_first']:.2f} s, later steps "
        f"{figures['seconds_later']:.2f} s, at most "
        f"{max(linear, default=0)} iterations, {figures['megabytes']:.0f} MB"
    )
    return figures, points


# %%
draws = np.random.default_rng(0)
cases = [(n, cut, args.nu) for n in args.cells for cut in args.cuts]
if args.random:
    cases = [
        (int(draws.integers(min(args.cells), max(args.cells) + 1)), 10 ** draws.uniform(-6, 0),
         draws.uniform(0, args.nu))
        for _ in range(args.random)
    ]  # fmt: skip
runs, last = [], None
for case in cases:
    figures, last = run(*case)
    runs.append(figures)
finish(args, {"runs": runs, "ranks": MPI.COMM_WORLD.size})

# %% [markdown]
# ## Picture
# Iterations over unknowns, and of the slope a section through the weak end with the plastic strain.

# %%
if not args.no_plot:
    fields = last.gather("x", "plastic_strain") if args.scene == "slope" else None
    iterated = [r for r in runs if r["linear_iterations"]]
    iterated = iterated if len(iterated) > 1 else []
    count = bool(iterated) + (fields is not None) or 1
    path = args.output / f"solid_3d_{args.scene}.png"
    with mpm.figure(path, 4.8 * count, 3.6, ncols=count, squeeze=False) as (figure, axes):
        first, other = axes[0, 0], axes[0, -1]
        if iterated or fields is None:
            for cut in args.cuts:
                mine = [r for r in iterated if r["cut"] == cut]
                unknowns = [r["unknowns"] for r in mine]
                most = [max(r["linear_iterations"]) for r in mine]
                first.plot(unknowns, most, "o-", label=f"cut at {cut:g} of a cell")
            first.set(xlabel="unknowns", ylabel="most iterations of a solution")
            first.set(xscale="log", ylim=(0, None))
            first.legend()
        if fields is not None:
            x, strain = fields
            at = x[:, 1] < 10.0 / args.cells[-1]
            look = {"s": 6, "cmap": "viridis"}
            drawn = other.scatter(x[at, 0], x[at, 2], c=100 * strain[at], **look)
            other.set(xlabel="$x$ (m)", ylabel="$z$ (m)", aspect="equal")
            figure.colorbar(drawn, ax=other, label="plastic strain (%)")
