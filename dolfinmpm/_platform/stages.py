"""Where the time of a step goes: one clock for PETSc's log and for the records of steps.

Time belongs to one stage alone. A stage that is entered within another stops the clock of that
one until it is left, in PETSc's log too: the residual that SNES asks for counts as evaluation and
assembly, not as solution, and all stages together are no more than the whole.

Nothing is measured unless somebody asks for it, by `measure_stages` or for PETSc's log: a step
enters dozens of stages, and of one with few points their clock would be half a per cent.
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

# what a step consists of, and what is written about it
STEP = ("activate", "evaluate", "assemble", "solve", "commit", "migrate")
NAMES = (*STEP, "output")

Function = TypeVar("Function", bound=Callable[..., Any])

_active = PETSc.Log.isActive


class _StageClock:
    """What is entered now, and whether it is measured.

    Attributes:
        on: Whether anything is measured.
        asked: Whether `measure_stages` asked for it.
        logged: Whether PETSc keeps a log, as it was when the step began.
        since: Since when the seconds of the stage in front are not counted yet (s).
        front: The stage that was entered last and not left.
        outer: What those that were entered by name interrupt.
        latest: Seconds of the step that was taken last, which output belongs to.
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
        """The stage in front is interrupted or left; another is in front."""
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
        """A step begins; returns whether it is measured."""
        if self.front is None:
            self.logged = bool(_active())
            self.on = self.asked or self.logged
        return self.on


_clock = _StageClock()


class Stage:
    """A part of a step: `with stage: …`, or `@stage` before a function.

    Args:
        name: Its name; that of the event in PETSc's log is "mpm:" and this.

    Attributes:
        name: The argument.
        seconds: Wall time of this process in it so far, without that of stages within it (s).
        event: PETSc's event.
    """

    __slots__ = ("event", "name", "seconds")

    def __init__(self, name: str):
        self.name, self.seconds = name, 0.0
        self.event = PETSc.Log.Event(f"mpm:{name}")

    def enter(self) -> None:
        """Begin it; `leave` must follow, whatever happens."""
        clock = _clock
        if clock.on:
            clock.outer.append(clock.front)
            if clock.front is not self:
                clock.turn(self)

    def leave(self) -> None:
        """End it, and go on with what it interrupted."""
        clock = _clock
        if clock.on:
            outer = clock.outer.pop()
            if outer is not self:
                clock.turn(outer)

    def __enter__(self) -> None:
        self.enter()

    def __exit__(self, *exception: object) -> None:
        self.leave()

    def __call__(self, function: Function) -> Function:
        @functools.wraps(function)
        def within(*arguments: Any, **options: Any) -> Any:
            if not _clock.on:
                return function(*arguments, **options)
            with self:
                return function(*arguments, **options)

        return cast(Function, within)


class _Output(Stage):
    """Output is written between steps: it belongs to the one before."""

    __slots__ = ()

    def leave(self) -> None:
        """End it, and add it to the record of the last step."""
        before = self.seconds
        super().leave()
        latest = _clock.latest
        if _clock.on and _clock.front is None and latest:
            latest["output"] += self.seconds - before


def measure_stages(on: bool = True) -> None:
    """Measure the stages of steps from here on, for `stages` of the records in `history`.

    At first nothing is measured, unless PETSc keeps a log (`-log_view`).
    `demos/studies/skip_table.py --only stages` counts what both take.

    Args:
        on: Whether they are measured.

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
    """Seconds of each stage since it was made; output that is written later is added."""

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
