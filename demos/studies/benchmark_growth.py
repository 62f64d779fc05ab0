"""How time, memory and communication grow with points, with the grid around a body, with ranks.

Run alone it is one case, which the benchmark starts as often as it needs it, under `mpirun` too:
every case has a process of its own, whose largest memory is that of this case alone.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import Options, option
from petsc4py import PETSc
from scene import finish, say, stage_seconds

import dolfinmpm as mpm

# of the processor seconds per step, over the last decade of points
FITTED = 10.0
# of what is explicit, as a loop over `times(end, dt="auto")` takes them: in all sizes as many share
# what a call takes by itself
STEPS_A_CALL = 20
# times the grid that a body needs
ROOMS = (1, 4, 16)
KINDS = ("explicit", "implicit", "aggregated", "solid", "solid-gimp")
SOLIDS = KINDS[3:]
WITH = ("points", "unknowns", "cells", "ranks")


# -- one case --------------------------------------------------------------------------------


def block(kind: str, count: int, room: int):
    """A block of about so many points on a grid `room` times as large as it needs; a stepper.

    It is a square, or of kinds "solid" and "solid-gimp" a cube, whose steps are implicit too. Of
    kind "aggregated" its upper faces cut the cells.
    """
    d = 3 if kind in SOLIDS else 2
    cells = max(2, round(count ** (1 / d) / 2))
    h = 1.0 / cells
    # the grid that it needs, in cells, and that it gets
    needed = cells + 4
    side = round(needed * room ** (1 / d))
    low, high = [-2 * h] * d, [(side - 2) * h] * d
    grid = box_grid([low, high], [side] * d)
    aggregated = kind == "aggregated"
    points = mpm.fill(grid, mpm.Box((0,) * d, (1 + 0.3 * h * aggregated,) * d), 2, 1000.0)
    basis = {"explicit": "bspline2", "solid": "linear"}.get(kind, "gimp")
    V = mpm.Space(grid, basis)
    gravity = fem.Constant(grid, (0.0, -10.0 if kind == "explicit" else 0.0, 0.0)[:d])
    law = mpm.materials.NeoHookean if kind == "explicit" else mpm.materials.Hencky
    F = mpm.momentum(law(E=1e6, nu=0.3), points, V.increment, V.test)
    F -= ufl.inner(points.density * gravity, V.test) * points.dX
    bcs = mpm.fixed(V, lambda x: x[1] < 1e-6 * h)
    if kind == "explicit":
        explicit = mpm.Explicit(F, V.increment, points, bcs, scheme="usl", mapping="flip")
        dt = 0.8 * explicit.critical_step()

        def go() -> int:
            return explicit.step(explicit.time + (STEPS_A_CALL - 0.01) * dt).parts

        return explicit, go
    stabilisation = "aggregation" if aggregated else "none"
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)

    def load() -> int:
        gravity.value[1] -= 0.2
        problem.step()
        return 1

    return problem, load


def messages() -> np.ndarray:
    """Messages and bytes of PETSc in all stages so far, of this rank."""
    from dolfinmpm._platform import stages

    found = [getattr(stages, name).event.getPerfInfo() for name in stages.STEP]
    return np.array([[f["numMessages"], f["messageLength"]] for f in found]).sum(axis=0)


def memory(kind: str) -> float:
    """Memory of this process (bytes), now ("VmRSS") or at its most ("VmHWM")."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024.0 * next(int(line.split()[1]) for line in lines if line.startswith(kind))


class Timed:
    """A block whose steps are timed, some of them warm it up first. Collective.

    Attributes:
        problem: What takes its steps.
    """

    def __init__(self, case: str, points: int, room: int) -> None:
        self.problem, self._go = block(case, points, room)
        self._go()
        self._go()
        self._before = len(self.problem.history)
        self._of_calls: list[list[float]] = []
        self._steps, self._sent = 0, np.zeros(2)

    def call(self) -> None:
        """One call of as many steps as its kind takes at once. Collective."""
        comm = MPI.COMM_WORLD
        comm.barrier()
        sent = messages()
        started, processor = time.perf_counter(), time.process_time()
        own = self._go()
        processor = time.process_time() - processor
        comm.barrier()
        seconds = time.perf_counter() - started
        self._of_calls.append([seconds / own, comm.allreduce(processor, op=MPI.SUM) / own])
        self._steps += own
        self._sent += messages() - sent

    def figures(self) -> dict[str, Any]:
        """Seconds, stages and messages of a step so far. Collective."""
        comm, problem = MPI.COMM_WORLD, self.problem
        # others may use the machine in some of the calls
        seconds, processor = np.median(self._of_calls, axis=0)
        sent = comm.allreduce(self._sent, op=MPI.SUM)
        del problem.history[: self._before]
        stages = stage_seconds(problem)
        most = {
            name: comm.allreduce(value, op=MPI.MAX) / self._steps for name, value in stages.items()
        }
        return {
            "points": problem.points.total,
            "cells": problem.points.grid.topology.index_map(problem.points.gdim).size_global,
            "unknowns": problem.here.unknowns.total if problem.here is not None else 0,
            "steps": self._steps,
            "iterations": sum(record.iterations for record in problem.history),
            "seconds": float(seconds),
            "seconds_processor": float(processor),
            "petsc_messages": float(sent[0]) / self._steps,
            "petsc_bytes": float(sent[1]) / self._steps,
            "stages": most,
            "ranks": comm.size,
        }


def one_case(args: Any) -> dict[str, Any]:
    """Figures of a case with every room, in turn with each other, and memory. Collective.

    Memory is that beyond a small case, of all rooms together.
    """
    PETSc.Log.begin()
    small, go_small = block(args.case, 400, 1)
    go_small()  # compiles, or loads what was compiled before
    del small, go_small
    gc.collect()
    least = memory("VmRSS")
    # from here on the peak is counted anew
    Path("/proc/self/clear_refs").write_text("5")
    blocks = [Timed(args.case, args.points, room) for room in args.room]
    for _ in range(args.calls):
        for one in blocks:
            one.call()
    beyond = MPI.COMM_WORLD.allreduce(memory("VmHWM") - least, op=MPI.SUM)
    return {"rows": [one.figures() for one in blocks], "memory": beyond}


# -- many cases ------------------------------------------------------------------------------


def started(
    case: str, points: int, calls: int, room: Sequence[int] = (1,), ranks: int = 1
) -> list[dict[str, Any]]:
    """One case in processes of its own, a row for every room; `failed` if memory did not do.

    Messages are those of PETSc: what counts all of them in Open MPI fails on the neighbourhood
    collectives of DOLFINx.
    """
    words = ["--case", case, "--points", str(points), "--calls", str(calls)]
    command = [sys.executable, __file__, *words, "--room", ",".join(map(str, room))]
    command += ["--json", "-"]
    if ranks > 1:
        command = ["mpirun", "-n", str(ranks), *command]
    # ranks beyond the processors must let each other have them
    own = {**os.environ, "OMPI_MCA_mpi_yield_when_idle": "1"}
    done = subprocess.run(command, env=own, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        say(f"{case}, {points} points, {ranks} rank(s): ended with code {done.returncode}")
        return [{"points": points, "ranks": ranks, "failed": done.returncode}]
    found = json.loads(done.stdout.splitlines()[-1])
    if len(room) == 1:
        found["rows"][0]["memory"] = found["memory"]
    for row in found["rows"]:
        held = (
            f"{row['memory'] / row['points'] / 1e3:.2f} kB per point, " if "memory" in row else ""
        )
        say(
            f"{case}, {row['points']} points in {row['cells']} cells, {ranks} rank(s): "
            f"{row['seconds_processor']:.4g} s of processors a step, {row['seconds']:.4g} s, "
            f"{held}{row['petsc_messages']:.0f} messages of {row['petsc_bytes']:.3g} bytes by PETSc"
        )
    return found["rows"]


def exponent(rows: Sequence[dict[str, Any]], by: str, of: str) -> float | None:
    """Exponent p of the fit of ∝ size^p over the largest sizes; None of less than two."""
    known = [(row[by], row[of]) for row in rows if row.get(of)]
    if len(known) < 2:
        return None
    x, y = np.log(np.array(sorted(known)).T)
    last = (x >= x[-1] - np.log(FITTED) - 0.1) if len(x) > 2 else np.ones(len(x), bool)
    return float(np.polyfit(x[last], y[last], 1)[0]) if last.sum() > 1 else None


def growth(args: Any) -> dict[str, Any]:
    """All series that `args.growth` names; on one rank."""
    found: dict[str, Any] = {}
    sizes = [
        ("points", "explicit", args.explicit_points), ("points", "implicit", args.implicit_points),
        *(("unknowns", case, args.solid_points) for case in SOLIDS),
    ]  # fmt: skip
    for by, case, counts in sizes:
        if by in args.growth:
            # about as long in all of them, but at least three calls
            rows = [r for n in counts for r in started(case, n, max(3, min(15, int(1e6 / n))))]
            found[f"{by}, {case}"] = {
                "rows": rows,
                "exponent": exponent(rows, by, "seconds_processor"),
                "exponent_memory": exponent(rows, "points", "memory"),
            }
    if "cells" in args.growth:
        for case in ("explicit", "implicit", "aggregated"):
            rows = started(case, args.fixed_points, 15, ROOMS)
            least, most = (row.get("seconds_processor") for row in (rows[0], rows[-1]))
            found[f"cells, {case}"] = {
                "rows": rows,
                "exponent": exponent(rows, "cells", "seconds_processor"),
                "ratio": most / least if least and most else None,
            }
    if "ranks" in args.growth:
        for case in ("explicit", "implicit"):
            for kind in ("strong", "weak"):
                rows = []
                for ranks in args.ranks:
                    points = args.fixed_points * (ranks if kind == "weak" else 1)
                    rows += started(case, points, 5, ranks=ranks)
                found[f"ranks, {case}, {kind}"] = {
                    "rows": rows,
                    # of a share of work that does not depend on ranks: 0 if strong, 1 if weak
                    "exponent": exponent(rows, "ranks", "seconds_processor"),
                    "exponent_bytes": exponent(rows[1:], "ranks", "petsc_bytes"),
                }
    for name, series in found.items():
        powers = {k: v for k, v in series.items() if k != "rows" and v is not None}
        say(f"{name}: " + ", ".join(f"{k} {v:.2f}" for k, v in powers.items()))
    return found


@dataclass
class Input(Options):
    """One case of the growth of time with points, cells and ranks."""

    case: str = option("explicit", choices=KINDS)
    points: int = option(10_000, "about so many")
    room: list[int] = option([1], "times the grid that the body needs; in turn")
    calls: int = option(5, "that are timed, see STEPS_A_CALL")


if __name__ == "__main__":
    args = Input.parse()
    finish(args, one_case(args))
