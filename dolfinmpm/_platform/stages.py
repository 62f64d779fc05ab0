"""Stages of a step: one clock for PETSc's log and for the records of steps.

Every moment belongs to one stage only. An inner stage stops the clock of the outer stage, also in
PETSc's log. The residual that SNES computes counts as evaluation and assembly, for example, and
not as solution. The stages of a step add up to no more than the step.

Stages are measured only after `measure_stages`, or for PETSc's log. A step enters dozens of stages:
with few points, the clock would take half a per cent of the step.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from time import perf_counter
from typing import Any, TypeVar, cast

from petsc4py import PETSc

from dolfinmpm._platform.argumentchecks import truth

__all__ = ["NAMES", "STEP", "Watch", "activate", "assemble", "commit", "evaluate",
           "measure_stages", "migrate", "output", "solve"]  # fmt: skip

# Stages of a step, and the output between steps
STEP = ("activate", "evaluate", "assemble", "solve", "commit", "migrate")
NAMES = (*STEP, "output")

Function = TypeVar("Function", bound=Callable[..., Any])

_active = PETSc.Log.isActive


class _StageClock:
    """The present stage, and whether stages are measured.

    Attributes:
        on: Whether stages are measured.
        asked: Whether `measure_stages` has asked for it.
        logged: Whether PETSc kept a log at the start of the step.
        since: Time up to which the seconds of the present stage are counted (s).
        front: The present stage, or None.
        outer: Interrupted stages, one per entered stage.
        latest: Seconds of the stages of the last step; later output is added.
    """

    __slots__ = ("asked", "front", "latest", "logged", "on", "outer", "since")

    def __init__(self) -> None:
        self.asked = False
        self.on = self.logged = bool(_active())
        self.since = 0.0
        self.front: Stage | None = None
        self.outer: list[Stage | None] = []
        self.latest: dict[str, float] = {}

    def turn(self, to: Stage | None) -> None:
        """Change the present stage."""
        now, front = perf_counter(), self.front
        if front is not None:
            front.seconds += now - self.since
        if self.logged:
            if front is not None:
                front.event.end()
            if to is not None:
                to.event.begin()
        self.front, self.since = to, now

    def begin(self) -> bool:
        """Begin a step; returns whether its stages are measured."""
        if self.front is None:
            self.logged = bool(_active())
            self.on = self.asked or self.logged
        return self.on


_clock = _StageClock()


class Stage:
    """A stage of a step: `with stage: …`, or `@stage` before a function.

    Args:
        name: Name of the stage. PETSc's event is called "mpm:" and the name.

    Attributes:
        name: The argument.
        seconds: Wall time of this process in the stage so far, without inner stages (s).
        event: PETSc's event.
    """

    __slots__ = ("event", "name", "seconds")

    def __init__(self, name: str):
        self.name, self.seconds = name, 0.0
        self.event = PETSc.Log.Event(f"mpm:{name}")

    def enter(self) -> None:
        """Begin the stage; `leave` must follow, also after an error."""
        clock = _clock
        if clock.on:
            clock.outer.append(clock.front)
            if clock.front is not self:
                clock.turn(self)

    def leave(self) -> None:
        """End the stage, and continue the interrupted stage."""
        clock = _clock
        if clock.on:
            outer = clock.outer.pop()
            if outer is not self:
                clock.turn(outer)

    def __exit__(self, *exception: object) -> None:
        self.leave()

    __enter__ = enter

    def __call__(self, function: Function) -> Function:
        @functools.wraps(function)
        def within(*arguments: Any, **options: Any) -> Any:
            if not _clock.on:
                return function(*arguments, **options)
            with self:
                return function(*arguments, **options)

        return cast(Function, within)


class _Output(Stage):
    """Output between steps, which belongs to the step before."""

    __slots__ = ()

    def leave(self) -> None:
        """End the output, and add its seconds to the record of the last step."""
        before = self.seconds
        super().leave()
        latest = _clock.latest
        if _clock.on and _clock.front is None and latest:
            latest["output"] += self.seconds - before


def measure_stages(on: bool = True) -> None:
    """Measure the stages of the next steps, for `stages` of the records in `history`.

    By default stages are measured only if PETSc keeps a log (`-log_view`).
    `demos/studies/skip_table.py --only stages` measures the cost of both.

    Args:
        on: Whether stages are measured.

    Raises:
        ParameterError: `on` is neither True nor False.
        RuntimeError: A step is being taken.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> mpm.measure_stages()
    >>> record = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()
    >>> mpm.measure_stages(False)
    >>> sorted(record.stages)
    ['activate', 'assemble', 'commit', 'evaluate', 'migrate', 'output', 'solve']
    """
    if _clock.front is not None:
        raise RuntimeError("stages are switched on or off between steps")
    _clock.asked = truth("on", on)
    _clock.begin()


activate, evaluate, assemble, solve, commit, migrate = (Stage(name) for name in STEP)
output = _Output("output")
_ALL = (activate, evaluate, assemble, solve, commit, migrate, output)


class Watch:
    """Seconds of each stage since the object was made; later output is added."""

    __slots__ = ("_before",)

    def __init__(self) -> None:
        self._before = [stage.seconds for stage in _ALL] if _clock.begin() else None

    def stop(self) -> dict[str, float]:
        """Seconds of each stage by name (s), of this process; empty if nothing is measured."""
        found: dict[str, float] = {}
        if self._before is not None:
            found = {s.name: s.seconds - before for s, before in zip(_ALL, self._before)}
        _clock.latest = found
        return found
