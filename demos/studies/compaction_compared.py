# %% [markdown]
# # The compacting column under every basis and every stabilisation
#
# The column of `column_compaction.py` with each basis and each stabilisation against small cuts,
# at several resolutions: error of the stress, Newton iterations and time. A run that does not
# come to the end is listed as such. Soft stiffness is in the tangent only, so its errors are
# those without stabilisation. Cubic splines have 3² points per cell. The column is one cell wide,
# and with 2² points some of their functions across the column have no stiffness.

# %%
from __future__ import annotations

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
from dolfinmpm import study

STABILISATIONS = ("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft")


# %%
def column(elements, basis, stabilisation, per_cell, steps):
    """Solve; returns the figures of the run."""
    E, rho, g, height = 10e3, 80.0, 10.0, 50.0
    h = height / elements
    grid = box_grid([(0, 0), (h, height)], (1, elements))
    points = mpm.fill(grid, mpm.Box((0, 0), (h, height)), per_cell, rho)
    V = mpm.Space(grid, basis)
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=0.0), points, V.increment, V.test)
    F -= ufl.inner(points.density * gravity, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(
        F, V.increment, points, bcs, stabilisation=stabilisation, max_halvings=4
    )
    started = time.perf_counter()
    finished = True
    try:
        for k in range(steps):
            gravity.value[1] = -g * (k + 1) / steps
            problem.step()
    except mpm.errors.DolfinMPMError:
        finished = False
    V0, Y = points["V0"], points["x0"][:, 1]
    deviation = np.abs(points["stress"][:, 1, 1] + rho * g * (height - Y)) @ V0
    total = grid.comm.allreduce(np.array([deviation, V0.sum()]))
    return {
        "basis": basis,
        "stabilisation": stabilisation,
        "elements": elements,
        "h": h,
        "completed": finished,
        "error": float(total[0] / (rho * g * height * total[1])) if finished else None,
        "newton_iterations": sum(record.iterations for record in problem.history),
        "halvings": sum(record.halvings for record in problem.history),
        "seconds": time.perf_counter() - started,
    }


# %%
@dataclass
class Input(Options):
    """The compacting column under every basis and every stabilisation."""

    elements: str = option("4,8,16,32", "cells over the height, by commas")
    bases: str = ",".join(BASES)
    stabilisations: str = ",".join(STABILISATIONS)
    points_per_cell: int | None = natural(None, "2, and 3 for cubic splines")
    steps: int = natural(40)


args = Input.parse()

sizes = [int(n) for n in args.elements.split(",")]
runs = []
for basis in args.bases.split(","):
    per_cell = args.points_per_cell or (3 if basis == "bspline3" else 2)
    for stabilisation in args.stabilisations.split(","):
        column(sizes[0], basis, stabilisation, per_cell, 1)  # compiles
        mine = [column(n, basis, stabilisation, per_cell, args.steps) for n in sizes]
        runs += mine
        errors = " ".join(f"{r['error']:.2e}" if r["completed"] else " stopped" for r in mine)
        last = mine[-1]
        say(
            f"{basis:9s} {stabilisation:17s} {errors}  {last['newton_iterations']:4d} iterations, "
            f"{last['seconds']:.2f} s at {sizes[-1]} elements"
        )

# %% [markdown]
# ## Picture

# %%
if not args.no_plot and MPI.COMM_WORLD.rank == 0:
    names, stabilisations = args.bases.split(","), args.stabilisations.split(",")
    path = args.output / "compaction_compared.png"
    with mpm.figure(path, 6.8, 2.8, ncols=len(names), sharey=True, squeeze=False) as (whole, axes):
        for ax, basis in zip(axes[0], names):
            curves = {
                stabilisation: [
                    r for r in runs if (r["basis"], r["stabilisation"]) == (basis, stabilisation)
                ]
                for stabilisation in stabilisations
            }
            # some stabilisations end in the same state
            study.draw_convergence(ax, curves, nested=True)
            h = [r["h"] for r in curves[stabilisations[0]]]
            ax.set(title=basis, xlabel="cell size h (m)", xlim=(0.75 * min(h), 1.33 * max(h)))
        axes[0][0].set_ylabel("relative error of stress")
        handles, labels = axes[0][0].get_legend_handles_labels()
        whole.legend(handles, labels, loc="outside upper center", ncols=len(labels))

finish(args, {"runs": runs, "ranks": MPI.COMM_WORLD.size})
