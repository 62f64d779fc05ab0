# %% [markdown]
# # Does the same script give the same bits?
#
# Two scenes that are large enough for the solver to choose between its methods, and to keep factors
# or hierarchies for later tangents:
#
# - `solid`: an elastic block in 3D, multigrid;
# - `sand`: a block of Mohr–Coulomb soil in 2D that begins to yield, incomplete factors or LU.
#
# Each runs `--count` times in an interpreter of its own, and `--within` times in one. All bytes of
# all fields of the points are hashed. With `--busy` a neighbour takes a core on and off meanwhile,
# as on a machine that others use. On several ranks only the runs within one process are taken.

# %%
from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from dataclasses import dataclass

import benchmark_plastic
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import Options, natural, option
from scene import finish, say

import dolfinmpm as mpm


@dataclass
class Input(Options):
    """Whether repeated runs end with the same bits."""

    scene: str = option("solid", choices=("solid", "sand"))
    cells: int | None = option(None, "15 along a solid's edge, 50 a metre of sand")
    count: int = option(3, "runs in interpreters of their own")
    within: int = option(2, "runs in this one")
    steps: int = natural(3)
    busy: bool = option(False, "beside a process that works on and off")


args = Input.parse()

BUSY = """
import time
while True:
    until = time.perf_counter() + 0.7
    while time.perf_counter() < until:
        pass
    time.sleep(0.3)
"""


# %%
def solid(n):
    """An elastic block on rollers, and a function that takes its k-th step."""
    h, side = 1.0 / n, 1.0 + 4.0 / n
    grid = box_grid([(0, 0, 0), (side,) * 3], (n + 4,) * 3)
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 1 - 0.7 * h)), 2, 1000.0)
    V = mpm.Space(grid)
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.3), points, u, v)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.rollers(V, "left", "front") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, tolerance=1e-8, stabilisation="ghost")

    def load(k):
        gravity.value[2] = -10.0 * k / args.steps
        problem.step()

    return problem, load


def run():
    """One run: the hash of all fields of the points on all ranks, and what solved."""
    if args.scene == "solid":
        problem, step = solid(args.cells or 15)
    else:
        problem, step = benchmark_plastic.block(args.cells or 50, "linear", "static")
    for k in range(1, args.steps + 1):
        step(k)
    found = hashlib.sha256()
    for _, values in sorted(problem.points.fields.items()):
        found.update(values.tobytes())
    every = hashlib.sha256("".join(problem.comm.allgather(found.hexdigest())).encode())
    linear = [n for record in problem.history for n in record.linear_iterations or []]
    return {
        "hash": every.hexdigest(),
        "unknowns": problem.history[-1].unknowns,
        "newton_iterations": sum(record.iterations for record in problem.history),
        "linear_iterations": linear,
        "method": str(problem.newton.linear.used),
    }


def apart():
    """The same run in an interpreter of its own."""
    words = ["--scene", args.scene, "--steps", str(args.steps), "--count", "0", "--within", "1"]
    words += [] if args.cells is None else ["--cells", str(args.cells)]
    done = subprocess.run(
        [sys.executable, __file__, *words, "--json", "-"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return json.loads(done.stdout.splitlines()[-1])["runs"][0]


# %%
neighbour = subprocess.Popen([sys.executable, "-c", BUSY]) if args.busy else None
try:
    runs = [run() for _ in range(args.within)]
    alone = MPI.COMM_WORLD.size == 1
    runs += [apart() for _ in range(args.count if alone else 0)]
finally:
    if neighbour is not None:
        neighbour.kill()
        neighbour.wait()
results = len({one["hash"] for one in runs})
say(f"{args.scene}: {runs[0]['unknowns']} unknowns, {len(runs)} runs, {results} result(s)")
say(f"  {runs[0]['method']}; iterations {runs[0]['linear_iterations']}")
finish(args, {"runs": runs, "results": results, "ranks": MPI.COMM_WORLD.size})
