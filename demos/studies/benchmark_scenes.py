"""Scenes with a known result, each as one function: what it errs by, and what that took.

They are those of the studies of the same names, at any size, with any basis and stabilisation.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import cantilever as beams
import column_collapse as collapses
import footing as footings
import numpy as np
import ufl
import vortex as vortices
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from scene import say, stage_seconds

import dolfinmpm as mpm

BASES = ("linear", "gimp", "bspline2", "bspline3")


@dataclass
class Run:
    """One run of a scene.

    Attributes:
        scene, basis, level, per_cell, stabilisation: What was run; the level is the study's own
            measure
            of refinement, cells or their size (m).
        error: Relative error, None where the run did not come to its end.
        seconds: Processor time of the steps, the median of repetitions (s).
        seconds_all: That of each repetition (s).
        stages: Wall time of each stage in the last repetition (s).
        points, unknowns, iterations, steps: What was solved.
        reason: Why a run did not come to its end.
    """

    scene: str
    basis: str
    level: float
    per_cell: int
    stabilisation: str
    error: float | None = None
    seconds: float = 0.0
    seconds_all: list[float] = field(default_factory=list)
    stages: dict[str, float] = field(default_factory=dict)
    points: int = 0
    unknowns: int = 0
    iterations: int = 0
    steps: int = 0
    reason: str = ""

    def take(self, problem: Any, go: Callable[[], float]) -> None:
        """Let a problem run to its error, and note what that took. Collective."""
        started = time.process_time()
        try:
            error = go()
        except mpm.errors.DolfinMPMError as stopped:
            # which stabilisation carries a run to its end is part of what is asked
            self.reason = f"{type(stopped).__name__}: {str(stopped)[:160]}"
        else:
            self.error = abs(float(error))
        self.seconds_all.append(time.process_time() - started)
        self.note(problem)

    def note(self, problem: Any) -> None:
        """What a problem's history says."""
        self.stages = stage_seconds(problem)
        self.points = problem.points.total
        self.steps = sum(record.parts for record in problem.history)
        self.iterations = sum(record.iterations for record in problem.history)
        self.unknowns = max((record.unknowns for record in problem.history), default=0)

    def figures(self) -> dict[str, Any]:
        """All of it."""
        return asdict(self)


# -- the scenes ------------------------------------------------------------------------------


def compaction(columns, elements, basis, per_cell=2, stabilisation="none", law=None, ghost=None):
    """The column of `column_compaction.py`: its problem, and its gravity (m/s²)."""
    h, E = 50.0 / elements, 10e3
    grid = box_grid([(0, 0), (columns * h, 50)], (columns, elements))
    body = mpm.Box((0, 0), (columns * h, 50))
    points = mpm.fill(grid, body, per_cell=per_cell, density=80.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law or mpm.materials.Hencky(E=E, nu=0.0), points, u, v)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    if ghost:
        F += mpm.ghost(points, u, v, gamma=E / 30, scaling=ghost)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation), gravity


def compaction_error(points: Any) -> float:
    """Mean deviation of the stress from the exact one, by weight and height. Collective."""
    Y, V0, weight = points["x0"][:, 1], points["V0"], 800.0
    off = np.abs(points["stress"][:, 1, 1] + weight * (50 - Y))
    sums = points.comm.allreduce(np.array([off @ V0, V0.sum()]), op=MPI.SUM)
    return float(sums[0] / (weight * 50 * sums[1]))


def column(run: Run) -> None:
    """Self-weight compaction; error of the stress."""
    problem, gravity = compaction(1, int(run.level), run.basis, run.per_cell, run.stabilisation)

    def go() -> float:
        for k in range(40):
            gravity.value[1] = -10.0 * (k + 1) / 40
            problem.step()
        return compaction_error(problem.points)

    run.take(problem, go)


def cantilever(run: Run) -> None:
    """Large deflection; distance of the tip from that of conforming elements, by the length."""
    steps = 25
    words = ["--h", str(run.level), "--points-per-cell", str(run.per_cell)]
    beam = beams.Beam(beams.Input.parse([*words, "--basis", run.basis]), run.stabilisation)

    def go() -> float:
        for k in range(steps):
            tip = beam.step((k + 1) / steps)
        # tests/verification/test_cantilever.py, biquadratic elements
        return float(np.hypot(tip[0] - 0.5534, tip[1] - 0.8264))

    run.take(beam.problem, go)


def footing(run: Run) -> None:
    """Prandtl's limit load."""
    words = ["--law", "tresca-perfect", "--h", str(run.level), "--basis", run.basis]
    words += ["--points-per-cell", str(run.per_cell), "--stabilisation", run.stabilisation]
    args = footings.Input.parse(words)
    scene = footings.Scene(args)

    def go() -> float:
        for k in range(args.steps):
            scene.press((k + 1) / args.steps)
        return scene.load() / footings.LIMIT - 1

    run.take(scene.problem, go)


def collapse(run: Run) -> None:
    """Explicit collapse of sand; the surface at rest against the measured one, by the height."""
    words = ["--h", str(run.level), "--basis", run.basis, "--stabilisation", run.stabilisation]
    args = collapses.Input.parse([*words, "--points-per-cell", str(run.per_cell)])
    points, problem = collapses.problem_of(args, "explicit", run.basis, True, "large")

    def go() -> float:
        problem.step(args.duration)
        off = collapses.surface(points, collapses.PLACES) - collapses.MEASURED
        return float(np.sqrt(np.mean(off**2)) / args.height)

    run.take(problem, go)


def vortex(run: Run) -> None:
    """A ring turns within itself, by the implicit consistent mass or explicitly; positions."""
    words = ["--points-per-cell", str(run.per_cell), "--cells", str(int(run.level))]
    explicit = run.stabilisation == "explicit"
    args = vortices.Input.parse(
        words + ([] if explicit else ["--stabilisation", run.stabilisation])
    )
    kind = "explicit" if explicit else "implicit"
    figures, _ = vortices.ring(args, kind, run.basis, int(run.level))
    run.error, run.stages = figures["displacement"], figures["stages"]
    run.reason = "" if run.error is not None else "stopped"
    run.points, run.steps = figures["points"], figures["substeps"]
    run.seconds_all.append(figures["seconds_processor"])


@dataclass(frozen=True)
class Scene:
    """A scene and the sizes it is run at.

    Attributes:
        act: The function.
        error: What its error is of.
        levels: Refinements, coarse to fine.
        bases, per_cell, stabilisations: What is varied.
        quick: Refinements of a quick run.
    """

    act: Callable[[Run], None]
    error: str
    levels: Sequence[float]
    bases: Sequence[str]
    per_cell: Sequence[int]
    stabilisations: Sequence[str]
    quick: Sequence[float]


SCENES = {
    "column": Scene(column, "stress", (8, 16, 32, 64, 128), BASES, (2, 3),
                    ("none", "ghost", "aggregation"), (8, 16)),
    "cantilever": Scene(cantilever, "tip / length", (0.5, 0.25, 0.125), BASES[:3], (3, 4),
                        ("none", "ghost", "aggregation"), (0.5,)),
    "footing": Scene(footing, "limit load", (0.4, 0.2, 0.1, 0.05), BASES[:3], (2, 3),
                     ("none", "ghost", "aggregation"), (0.4,)),
    "collapse": Scene(collapse, "surface / height", (0.02, 0.01, 0.005), BASES[:3], (2, 3),
                      ("none",), (0.02, 0.01)),
    "vortex": Scene(vortex, "positions / amplitude", (8, 16, 32), BASES, (2, 3),
                    ("ghost", "aggregation", "explicit"), (8,)),
}  # fmt: skip


def runs_of(
    names: Sequence[str],
    quick: bool,
    bases: Sequence[str] | None,
    refinements: int | None = None,
    densities: int | None = None,
) -> list[Run]:
    """All runs of some scenes, coarse to fine.

    Args:
        names: Scenes.
        quick: Whether each is to take seconds.
        bases: Which bases, those of the scene by default.
        refinements: How many of them, from the coarsest; all by default.
        densities: How many numbers of points a cell, from the least; all by default.
    """
    found = []
    for name in names:
        scene = SCENES[name]
        levels = (scene.quick if quick else scene.levels)[:refinements]
        chosen = [b for b in scene.bases if bases is None or b in bases]
        if quick and bases is None:
            chosen = ["gimp", "bspline2"]
        for level in levels:
            for basis in chosen:
                for per_cell in scene.per_cell[: 1 if quick else densities]:
                    # three functions of a cubic spline's cell need three points
                    at_least = max(per_cell, 3) if basis == "bspline3" else per_cell
                    for stabilisation in scene.stabilisations:
                        found.append(Run(name, basis, level, at_least, stabilisation))
    return list(
        {(r.scene, r.basis, r.level, r.per_cell, r.stabilisation): r for r in found}.values()
    )


def measure(runs: Sequence[Run], repeat: int) -> None:
    """Run all, in turn so that what else the machine does meets all of them alike. Collective."""
    # what compiles, or loads what is compiled, is not counted
    first: dict[tuple, Run] = {}
    for run in runs:
        first.setdefault((run.scene, run.basis, run.stabilisation, run.per_cell), run)
    for run in first.values():
        SCENES[run.scene].act(Run(run.scene, run.basis, run.level, run.per_cell, run.stabilisation))
    for turn in range(repeat):
        for run in runs:
            if turn and run.error is None:
                # what did not come to its end once does not the next time
                continue
            SCENES[run.scene].act(run)
            if turn == repeat - 1 or run.error is None:
                say(describe(run))
    for run in runs:
        run.seconds = float(np.median(run.seconds_all))


def describe(run: Run) -> str:
    """A line on a run."""
    name = f"{run.scene:10s} {run.basis:8s} {run.level:g}, {run.per_cell}², {run.stabilisation:11s}"
    seconds = float(np.median(run.seconds_all))
    if run.error is None:
        return f"{name} stopped after {seconds:.2f} s: {run.reason[:90]}"
    whole = sum(run.stages.values()) or 1.0
    shares = ", ".join(f"{k} {v / whole:.0%}" for k, v in run.stages.items() if v > 0.005 * whole)
    return f"{name} error {run.error:.2e} in {seconds:7.3f} s of {run.points} points ({shares})"
