# %% [markdown]
# # A square footing on saturated ground in three dimensions
#
# A quarter of a block of ground, 1 m wide and deep, carries an even load on a square of 0.3 m in
# its corner, drains at its top, and is pressed in deeply: displacement and pore pressure are
# solved for together, by GMRES with a field split. Its iterations should depend neither on the
# number of unknowns nor on the permeability.

# %%
from __future__ import annotations

import time

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI
from scene import finish, numbers, parser, say, solver_figures

import dolfinmpm as mpm


# %%
def arguments():
    """The command line."""
    options = parser("A square footing on saturated ground in 3D.")
    add = options.add_argument
    add("--cells", type=numbers(int), default=[14, 20], help="in each direction, by commas")
    add("--permeability", type=numbers(float), default=[1e-6], help="k (m/s), by commas")
    add("--steps", type=int, default=4, help="in which the load is put on, 1 s each")
    add("--load", type=float, default=0.1, help="by Young's modulus")
    add("--basis", choices=("linear", "gimp", "bspline2"), default="gimp")
    add("--points-per-cell", type=int, default=2)
    add("--direct", action="store_true", help="factors in place of iterations")
    return options.parse_args()


args = arguments()
comm, E, nu = MPI.COMM_WORLD, 1e7, 0.3


def run(cells: int, permeability: float):
    """Take the steps; figures of the run, and the problem."""
    h = 1 / cells
    grid = mesh.create_box(
        comm, [(0, 0, 0), (1, 1, 1 + h)], (cells, cells, cells + 1), mesh.CellType.hexahedron
    )
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 1)), args.points_per_cell, 2000.0)
    V, Q = mpm.Space(grid, args.basis), mpm.Space(grid, args.basis, shape=())
    top = mpm.Surface(points, lambda x: x[2] > 1 - 1e-9, (0, 0, 1), "top")
    square = mpm.Surface(
        points, lambda x: (x[2] > 1 - 1e-9) & (x[0] < 0.3) & (x[1] < 0.3), (0, 0, 1), "square"
    )
    F = mpm.poromechanics(
        mpm.materials.Hencky(E=E, nu=nu), points, (V.increment, Q.increment), (V.test, Q.test),
        permeability=permeability, porosity=0.4, drained=top,
    )  # fmt: skip
    load = fem.Constant(grid, (0.0, 0.0, 0.0))
    F -= square.traction(load, V.test)
    bcs = mpm.rollers(V, "left", "right", "front", "back") + mpm.fixed(V, "bottom")
    own = {"pc_type": "lu", "ksp_type": "preonly"} if args.direct else {}
    problem = mpm.Transient(
        F, [V.increment, Q.increment], points, bcs, stabilisation=["ghost", "ghost"],
        petsc_options=own,
    )  # fmt: skip
    started = time.perf_counter()
    for share in mpm.steps(args.steps, f"{cells}³ cells"):
        load.value[2] = -args.load * E * share
        problem.step(share * args.steps)
    linear = [count for record in problem.history for count in record.linear_iterations]
    figures = {
        "cells": cells,
        "permeability": permeability,
        "settlement": float(-square.mean_displacement()[2]),
        "linear_iterations": linear,
        "mean_iterations": float(np.mean(linear)) if linear else None,
        "seconds_a_step": (time.perf_counter() - started) / args.steps,
        "largest_pressure": comm.allreduce(points["pressure"].max(initial=0.0), op=MPI.MAX),
        **solver_figures(problem),
    }
    return figures, problem


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
            + f", {figures['seconds_a_step']:.1f} s a step; settled by "
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
