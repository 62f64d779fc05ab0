# %% [markdown]
# # How long it takes, and how much memory
#
# The elastic column of `column_compaction.py` in 40 steps, one element wide and 64 high,
# and 16 wide and 256 high, each solved several times after a first time that
# loads all compiled kernels. Time is that of the steps; memory is the largest that
# the process ever held less what it held after a small run, for each point.

# %%
from __future__ import annotations

import gc
import statistics
import time
from pathlib import Path

import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scene import finish, parser, say

import dolfinmpm as mpm


# %%
def column(columns, elements, basis, ghost=None, steps=40):
    """Solve the column; returns seconds, Newton iterations and points."""
    h, E = 50.0 / elements, 10e3
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD,
        [(0, 0), (columns * h, 50)],
        (columns, elements),
        mesh.CellType.quadrilateral,
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (columns * h, 50)), per_cell=2, density=80.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=0.0), points, u, v)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    if ghost:
        F += mpm.ghost(points, u, v, gamma=E / 30, scaling=ghost)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs)
    started = time.perf_counter()
    for k in range(steps):
        gravity.value[1] = -10.0 * (k + 1) / steps
        problem.step()
    seconds = time.perf_counter() - started
    return seconds, sum(record.iterations for record in problem.history), points.total


def memory(kind):
    """Resident memory of this process (kB), now ("VmRSS") or at its most ("VmHWM")."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(kind))


# %%
options = parser(__doc__ or "Times and memory of the elastic column.")
options.add_argument("--repeat", type=int, default=5, help="counted runs of each case")
options.add_argument("--cases", default="1x64,16x256", help="columns x elements, by commas")
options.add_argument("--bases", default="gimp,linear")
options.add_argument("--ghost", choices=("none", "literal", "scaled"), default="none")
args = options.parse_args()
ghost = None if args.ghost == "none" else args.ghost

figures: dict[str, dict] = {}
for basis in args.bases.split(","):
    column(1, 16, basis, ghost)  # compiles, or loads what was compiled before
    for case in args.cases.split(","):
        columns, elements = (int(n) for n in case.split("x"))
        gc.collect()
        before = memory("VmRSS")
        # from here on the peak is counted anew
        Path("/proc/self/clear_refs").write_text("5")
        runs = [column(columns, elements, basis, ghost)]
        most = memory("VmHWM")
        for _ in range(args.repeat - 1):
            gc.collect()
            runs.append(column(columns, elements, basis, ghost))
        seconds = statistics.median(run[0] for run in runs)
        _, iterations, points = runs[0]
        figures[f"{basis} {case}"] = {
            "seconds": seconds,
            "seconds_least": min(run[0] for run in runs),
            "seconds_most": max(run[0] for run in runs),
            "newton_iterations": iterations,
            "points": points,
            "microseconds_per_point_and_iteration": 1e6 * seconds / points / iterations,
            "bytes_per_point": 1024 * (most - before) / points,
        }
        f = figures[f"{basis} {case}"]
        say(
            f"{basis:7s} {case:>7s}: {seconds:7.3f} s ({f['seconds_least']:.3f} to "
            f"{f['seconds_most']:.3f}), {iterations} iterations, "
            f"{f['microseconds_per_point_and_iteration']:.2f} µs a point and iteration, "
            f"{f['bytes_per_point']:.0f} bytes a point"
        )

finish(args, {"cases": figures, "ranks": MPI.COMM_WORLD.size})
