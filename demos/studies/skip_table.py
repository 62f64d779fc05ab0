# %% [markdown]
# # What is not used costs nothing
#
# Every optional feature, off and on, by the instructions that a processor goes through in a step
# (`instructions.py`), which do not depend on what else the machine does:
#
# - **off**: a step that does not use it, against the same step with the places stubbed out where
#   the code asks for the feature. Where there is no such place in a step, none of the feature's
#   functions may be called: their calls are counted, and the step is compared with a twin,
#   which tells what differences mean nothing.
# - **on**: the step with the feature against the step without.
#
# Two problems take the same steps in turn, one as it is and one stubbed; the figure is the median
# of their ratios. The scene is a block of elastic soil under its weight, 2² points per cell, GIMP.

# %%
from __future__ import annotations

import contextlib
import cProfile
import json
import os
import pstats
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import instructions
import numpy as np
from mpi4py import MPI
from options import Options, natural, option
from scene import finish, say
from skip_block import Block, block

import dolfinmpm as mpm
from dolfinmpm._platform import stages
from dolfinmpm.assembly import evaluation, region
from dolfinmpm.cut import activation
from dolfinmpm.study.tape import Tape, record

PACKAGE = Path(mpm.__file__).parent


@dataclass
class Input(Options):
    """What optional features cost, off and on."""

    cells: int = option(8, "of the block, in each direction")
    steps: int = natural(3, "counted pairs of steps")
    only: str | None = option(None, "features, by commas; all by default")
    calls: bool = option(False, "count Python calls in any case")


# %% [markdown]
# ## The features


# %%
@dataclass(frozen=True)
class Feature:
    """An optional feature.

    Attributes:
        name: Its name.
        on: Makes a block that uses it, from the number of cells; None of stages, which are
            switched on and off in one problem.
        stub: Takes away the places that ask for it, or None where there are none.
        own: Files and functions that only it calls: "file.py" or "file.py:function".
        plain: Makes the block it is compared with.
    """

    name: str
    on: Callable[[int], Block] | None
    stub: Callable[[], Any] | None = None
    own: tuple[str, ...] = ()
    plain: Callable[[int], Block] = block


def without_ties():
    """No field is asked whether a stabilisation ties its nodes."""
    return mock.patch.object(activation.Field, "constrains_nodes", False)


def without_means():
    """No region looks for laws that take means over cells."""

    def prepare(self) -> None:
        self._current.clear()

    return mock.patch.object(region.Region, "prepare", prepare)


@contextlib.contextmanager
def without_stages() -> Iterator[None]:
    """Functions are called as they are written; what enters a stage by name calls what is empty."""
    places = [place for name, place in sys.modules.items() if name.startswith("dolfinmpm")]
    places += [c for m in places for c in vars(m).values() if isinstance(c, type)]
    with contextlib.ExitStack() as all_of:
        for place in places:
            for name, value in list(vars(place).items()):
                # what stages wrap sees their names
                own = getattr(value, "__globals__", None) is vars(stages)
                if own and hasattr(value, "__wrapped__"):
                    all_of.enter_context(mock.patch.object(place, name, value.__wrapped__))
        for name in ("enter", "leave"):
            all_of.enter_context(mock.patch.object(stages.Stage, name, _nothing))
        all_of.enter_context(mock.patch.object(stages, "Watch", _NoWatch))
        yield


def _nothing(stage: stages.Stage) -> None:
    """Neither enters nor leaves a stage."""


class _NoWatch:
    """Watches nothing."""

    def stop(self) -> dict[str, float]:
        """Nothing."""
        return {}


@contextlib.contextmanager
def measured() -> Iterator[None]:
    """Stages are measured."""
    mpm.measure_stages()
    try:
        yield
    finally:
        mpm.measure_stages(False)


def with_output(cells: int) -> Block:
    """A block that writes its points after every step."""
    made = block(cells)
    folder = tempfile.mkdtemp()
    file = mpm.ParaView(Path(folder, "points.pvd"), made.problem.points)
    made.after = lambda: file.write(float(made.taken))
    return made


def with_checkpoint(cells: int) -> Block:
    """A block that saves its state after every step."""
    made, folder = block(cells), tempfile.mkdtemp()
    made.after = lambda: made.problem.save(Path(folder, "state.npz"))
    return made


def with_progress(cells: int) -> Block:
    """A block whose steps show a bar."""
    made = block(cells)
    bar = iter(mpm.steps(1000, label="steps"))
    made.after = lambda: next(bar)
    return made


def with_derivatives(cells: int) -> Block:
    """A block whose solutions are kept for a run that follows."""
    made, tape = block(cells), Tape()
    tape.readers = 1
    record(made.problem, tape)
    made.after = tape.clear
    return made


def yielding() -> Any:
    """A law all of whose points yield."""
    return mpm.materials.VonMises(E=1e4, nu=0.3, radius=0.5)


FEATURES = (
    Feature("ghost penalty", lambda n: block(n, stabilisation="ghost"),
            own=("stabilisations.py", "penalties.py", "active.py:select", "facettensors.py",
                 "latticefacets.py", "splinefacets.py")),
    Feature("aggregation", lambda n: block(n, stabilisation="aggregation"), without_ties,
            ("aggregation.py", "fractions.py", "prolongation.py")),
    Feature("F-bar", lambda n: block(n, fbar=True), without_means, ("fbar.py", "cellmeans.py")),
    Feature("yielding", lambda n: block(n, law=yielding()),
            own=("returnmapping.py", "vonmises.py")),
    Feature("tags", lambda n: block(n, tags=True), own=("cellparts.py", "pointchanges.py")),
    Feature("output", with_output, own=("paraview.py", "vtkfiles.py")),
    Feature("progress", with_progress, own=("progress.py",)),
    Feature("checkpoint", with_checkpoint, own=("checkpoint.py", "rowfile.py")),
    Feature("derivatives", with_derivatives,
            own=("tape.py", "tapedtangent.py", "followingruns.py", "branches.py",
                 "derivativerestart.py")),
    Feature("third dimension", lambda n: block(n, 3)),
    Feature("stages", None, without_stages),
)  # fmt: skip


# %% [markdown]
# ## Counting
# Residuals alone against residuals with a tangent; and collective calls, each of which costs some
# instructions on one rank too.


# %%
def pairs(first: Block, second: Block, count, number: int, stub=None) -> tuple[float, float, int]:
    """Median ratio of steps of two blocks less one, half its spread, and what the first takes."""
    ratios, taken = [], []
    for k in range(number):
        found = {}
        # who goes first changes, as what one leaves in caches may help the other
        for which in (0, 1) if k % 2 else (1, 0):
            with stub() if which and stub else contextlib.nullcontext():
                made = second if which else first
                if stub:
                    # what is exchanged is looked up anew
                    made.step()
                found[which] = count(made.step)[0]
        ratios.append(found[0] / found[1] - 1)
        taken.append(found[0])
    low, high = np.quantile(ratios, (0.25, 0.75))
    return statistics.median(ratios), float(high - low) / 2, int(statistics.median(taken))


def calls(made: Block) -> dict[str, int]:
    """Python-level calls of the package in a step, by "file.py:function"."""
    profile = cProfile.Profile()
    profile.runcall(made.step)
    found: dict[str, int] = {}
    for (path, _, name), (_, number, *_) in pstats.Stats(profile).stats.items():
        if PACKAGE in Path(path).parents:
            key = f"{Path(path).name}:{name}"
            found[key] = found.get(key, 0) + number
        elif "mpi4py" in name or "mpi4py" in path:
            found["mpi"] = found.get("mpi", 0) + number
    return found


def warm(made: Block, steps: int = 3) -> Block:
    """A block whose first steps are taken."""
    for _ in range(steps):
        made.step()
    return made


def row(feature: Feature, args, count) -> dict[str, Any]:
    """The figures of one feature."""
    first, second = warm(feature.plain(args.cells)), warm(feature.plain(args.cells))
    off, spread, plain = pairs(first, second, count, args.steps, feature.stub)
    seen = calls(first)
    own = sum(
        number for key, number in seen.items()
        for part in feature.own if key == part or key.startswith(f"{part}:")
    )  # fmt: skip
    found = {
        "feature": feature.name, "off": off, "off_spread": spread, "off_calls": own,
        "stubbed": feature.stub is not None, "plain": plain,
    }  # fmt: skip
    if feature.on is None:
        return {**found, "on": 1 / (1 + pairs(first, second, count, args.steps, measured)[0]) - 1}
    least = statistics.median(count(first.step)[0] for _ in range(3))
    on = warm(feature.on(args.cells))
    share = first.problem.points.total / on.problem.points.total
    taken = statistics.median(count(on.step)[0] for _ in range(3))
    return {**found, "on": share * taken / least - 1}


def tangent_row(args, count) -> dict[str, Any]:
    """Residual alone, which explicit steps take, and with a tangent."""
    made = warm(block(args.cells))
    called = []
    operator, matrix = made.problem.operator(), made.problem.newton.linear.matrix
    x = np.zeros(operator.here.unknowns.owned)
    for _ in range(args.steps):
        residual = count(lambda: operator.residual(x))[0]
        called.append(count(lambda: operator.tangent(matrix))[0] / residual)
    return {
        "feature": "tangent", "off": 0.0, "off_spread": 0.0, "off_calls": explicit_calls(args),
        "stubbed": False, "on": statistics.median(called), "plain": residual,
    }  # fmt: skip


def explicit_calls(args) -> int:
    """How often an explicit step that is not fused asks for a tangent."""
    made = block(args.cells)
    problem = mpm.Explicit(
        made.problem.form.given, made.problem.fields[0].space.increment, made.problem.points,
        made.problem.bcs, fused=False,
    )  # fmt: skip
    with mock.patch.object(evaluation.Evaluation, "tangent") as asked:
        problem.step(2 * problem.critical_step())
    return asked.call_count


def mpi_row(args, count) -> dict[str, Any]:
    """Collective calls of a step on one rank, by what one of them takes."""
    made = warm(block(args.cells))
    step = statistics.median(count(made.step)[0] for _ in range(args.steps))
    number, collective = 0, {"allreduce", "Allreduce", "allgather", "bcast", "exscan", "barrier"}

    def asked(code, place, what, first) -> None:
        nonlocal number
        number += isinstance(first, MPI.Comm) and getattr(what, "__name__", "") in collective

    comm = MPI.COMM_WORLD

    def hundred() -> None:
        for _ in range(100):
            comm.allreduce(1.0)

    hundred()
    one = count(hundred)[0] / 100
    # MPI's methods are compiled: no profiler of functions sees them
    monitor, tool = sys.monitoring, sys.monitoring.OPTIMIZER_ID
    monitor.use_tool_id(tool, "collective calls")
    monitor.register_callback(tool, monitor.events.CALL, asked)
    monitor.set_events(tool, monitor.events.CALL)
    made.step()
    monitor.set_events(tool, 0)
    monitor.free_tool_id(tool)
    return {
        "feature": "MPI on one rank", "off": number * one / step, "off_spread": 0.0,
        "off_calls": number, "stubbed": False, "on": None, "plain": int(step),
    }  # fmt: skip


def counted(args) -> dict[str, Any]:
    """All rows, in the process that is counted."""
    # which the command line asks for
    mpm.measure_stages(False)
    count = instructions.Counter()
    wanted = args.only.split(",") if args.only else None
    rows = []
    for feature in FEATURES:
        if wanted is None or feature.name in wanted:
            rows.append(row(feature, args, count))
            print(rows[-1], file=sys.stderr, flush=True)
    for name, make in (("tangent", tangent_row), ("MPI", mpi_row)):
        if wanted is None or name in wanted:
            rows.append(make(args, count))
    return {"rows": rows, "unit": count.unit}


# %% [markdown]
# ## The table

# %%
CHILD = "SKIP_TABLE_CHILD"


def share(value, spread=None):
    """A share in per cent."""
    if value is None:
        return "-"
    return f"{100 * value:+.3f} %" + (f" ± {100 * spread:.3f}" if spread else "")


if __name__ == "__main__":
    args = Input.parse()
    if os.environ.get(CHILD):
        print(json.dumps(counted(args)), flush=True)
        sys.exit()
    with mock.patch.dict(os.environ, {CHILD: "1"}):
        words = ["--cells", str(args.cells), "--steps", str(args.steps)]
        words += ["--only", args.only] if args.only else []
        found = instructions.count(__file__, *words, alone=args.calls)
    say(f"{'feature':18s} {'off':>22s} {'calls when off':>15s} {'on':>12s}   ({found['unit']})")
    for one in found["rows"]:
        hook = "" if one["stubbed"] or one["feature"] in ("tangent", "MPI on one rank") else " twin"
        say(
            f"{one['feature']:18s} {share(one['off'], one['off_spread']):>22s}{hook:5s} "
            f"{one['off_calls']:10d} {share(one['on']):>12s}"
        )
    finish(args, found)
