# %% [markdown]
# # The compacting column under every basis and every remedy
#
# The column of `column_compaction.py`, solved with each basis and each remedy against
# small cuts at several resolutions: error of the stress, Newton iterations and time. A
# run that does not finish is recorded as such.

# %%
from __future__ import annotations

import time

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scene import finish, parser, say

import dolfinmpm as mpm
from dolfinmpm.errors import DolfinMPMError

BASES = ("linear", "gimp", "bspline2", "bspline3")
REMEDIES = ("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft")


# %%
def column(elements, basis, remedy, per_cell, steps):
    """Solve; returns the figures of the run."""
    E, rho, g, height = 10e3, 80.0, 10.0, 50.0
    h = height / elements
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (h, height)], (1, elements), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (h, height)), per_cell, rho)
    V = mpm.Space(grid, basis)
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=0.0), points, V.increment, V.test)
    F -= ufl.inner(points.density * gravity, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=remedy, max_halvings=4)
    started = time.perf_counter()
    finished = True
    try:
        for k in range(steps):
            gravity.value[1] = -g * (k + 1) / steps
            problem.step()
    except DolfinMPMError:
        finished = False
    V0, Y = points["V0"], points["x0"][:, 1]
    deviation = np.abs(points["stress"][:, 1, 1] + rho * g * (height - Y)) @ V0
    total = grid.comm.allreduce(np.array([deviation, V0.sum()]))
    return {
        "basis": basis,
        "remedy": remedy,
        "elements": elements,
        "completed": finished,
        "error": float(total[0] / (rho * g * height * total[1])) if finished else None,
        "newton_iterations": sum(record.iterations for record in problem.history),
        "halvings": sum(record.halvings for record in problem.history),
        "seconds": time.perf_counter() - started,
    }


# %%
options = parser("The compacting column under every basis and every remedy.")
options.add_argument("--elements", default="4,8,16,32", help="cells over the height, by commas")
options.add_argument("--bases", default=",".join(BASES))
options.add_argument("--remedies", default=",".join(REMEDIES))
options.add_argument("--points-per-cell", type=int, default=2)
options.add_argument("--steps", type=int, default=40)
args = options.parse_args()

sizes = [int(n) for n in args.elements.split(",")]
runs = []
for basis in args.bases.split(","):
    for remedy in args.remedies.split(","):
        column(sizes[0], basis, remedy, args.points_per_cell, 1)  # compiles
        mine = [column(n, basis, remedy, args.points_per_cell, args.steps) for n in sizes]
        runs += mine
        errors = " ".join(f"{r['error']:.2e}" if r["completed"] else " stopped" for r in mine)
        last = mine[-1]
        say(
            f"{basis:9s} {remedy:17s} {errors}  {last['newton_iterations']:4d} iterations, "
            f"{last['seconds']:.2f} s at {sizes[-1]} elements"
        )

# %% [markdown]
# ## Picture

# %%
if not args.no_plot and MPI.COMM_WORLD.rank == 0:
    names = args.bases.split(",")
    path = args.output / "compaction_compared.png"
    with mpm.figure(path, 6.8, 2.4, ncols=len(names), sharey=True, squeeze=False) as (_, axes):
        for ax, basis in zip(axes[0], names):
            for remedy in args.remedies.split(","):
                done = [
                    r
                    for r in runs
                    if (r["basis"], r["remedy"]) == (basis, remedy) and r["completed"]
                ]
                ax.loglog([r["elements"] for r in done], [r["error"] for r in done], ".-",
                          label=remedy)  # fmt: skip
            ax.set(title=basis, xlabel="elements", xlim=(0.8 * sizes[0], 1.25 * sizes[-1]))
            ax.set_xticks(sizes, labels=[str(n) for n in sizes])
            ax.minorticks_off()
        axes[0][0].set_ylabel("stress error (-)")
        # where the standard method, whose error is large, leaves room
        axes[0][0].legend(loc="lower left")

finish(args, {"runs": runs, "ranks": MPI.COMM_WORLD.size})
