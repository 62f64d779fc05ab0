"""What an implicit step of sand that yields costs a point and Newton iteration, and on what."""

from __future__ import annotations

import statistics
import time

import ufl
from dolfinx import fem
from grids import box_grid
from scene import say

import dolfinmpm as mpm

STEPS = 6


def block(cells, basis, kind):
    """A block of sand, 1.2 m by 1 m, that stands free on its right and slumps under its weight.

    Args:
        cells: A metre.
        basis: Its basis.
        kind: "newmark", by steps of 5 ms in which waves go through 10 cells of 80 a metre, or
            "static", part by part of the weight, with cohesion that lets it stand.

    Returns:
        The problem, and a function that takes its k-th step, k = 1, 2, ...
    """
    size = round(3 * cells), round(1.5 * cells)
    grid = box_grid([(0, 0), (3, 1.5)], size)
    points = mpm.fill(grid, mpm.Box((0, 0), (1.2, 1)), 2, 2000.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    law = mpm.materials.MohrCoulomb(
        E=1e6, nu=0.3, cohesion=100.0 if kind == "newmark" else 3000.0, friction_angle=25.0,
        dilation_angle=0.0,
    )  # fmt: skip
    g = fem.Constant(grid, (0.0, -10.0 if kind == "newmark" else 0.0))
    F = mpm.momentum(law, points, u, v) - ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    if kind == "newmark":
        moving = mpm.Newmark(F, u, points, bcs, stabilisation="ghost")
        return moving, lambda k: moving.step(5e-3 * k)
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")

    def load(k):
        g.value[1] = -3.5 - 0.5 * k
        problem.step()

    return problem, load


def measure(cells, basis, kind, steps=STEPS):
    """Processor time a point and Newton iteration (µs), of each stage too."""
    problem, step = block(cells, basis, kind)
    # what compiles, and what is searched for once, is in the first
    step(1)
    first = len(problem.history)
    started = time.process_time()
    for k in range(2, steps + 2):
        step(k)
    seconds = time.process_time() - started
    records = problem.history[first:]
    iterations, points = sum(r.iterations for r in records), problem.points.total
    share = {name: sum(r.stages[name] for r in records) for name in records[0].stages}
    every = sum(share.values())
    linear = [n for r in records for n in r.linear_iterations or []]
    return {
        "microseconds_per_point_and_iteration": 1e6 * seconds / points / iterations,
        "shares": {name: value / every for name, value in share.items()},
        "newton_iterations": iterations,
        "linear_iterations": statistics.fmean(linear) if linear else 0.0,
        "points": points,
        "unknowns": records[-1].unknowns,
        "yielding": float((problem.points["plastic_strain"] > 0).mean()),
        "method": str(problem.newton.linear.method),
    }


def time_plastic(args):
    """Medians of several runs in every basis, moving and at rest; none without a size."""
    figures: dict[str, dict] = {}
    for basis in args.bases.split(",") if args.plastic else ():
        for kind in ("newmark", "static"):
            measure(max(4, args.plastic // 8), basis, kind, 1)  # compiles
            runs = [measure(args.plastic, basis, kind) for _ in range(args.repeat)]
            name = "microseconds_per_point_and_iteration"
            runs.sort(key=lambda run: run[name])
            found = figures[f"{basis} {kind}"] = runs[len(runs) // 2]
            most = sorted(found["shares"].items(), key=lambda item: -item[1])[:4]
            say(
                f"{basis:9s} Mohr–Coulomb, {kind}: {found[name]:.2f} µs per point and iteration "
                f"({runs[0][name]:.2f} to {runs[-1][name]:.2f}), {found['points']} points, "
                f"{found['unknowns']} unknowns, {found['newton_iterations']} iterations, "
                f"{found['linear_iterations']:.0f} linear ones each; "
                + ", ".join(f"{stage} {value:.0%}" for stage, value in most)
            )
    return figures
