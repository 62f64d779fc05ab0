"""Where the time of a step goes: one clock for PETSc's log and for the records of steps.

Time belongs to one stage alone. A stage that is entered within another stops the clock of that
one until it is left, in PETSc's log too: the residual that SNES asks for counts as evaluation and
assembly, not as solution, and all stages together are no more than the whole.

Nothing is measured unless somebody asks for it, by `measure_stages` or for PETSc's log: a step
enters dozens of stages, and of one with few points their clock would be half a per cent.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from time import perf_counter
from typing import Any, TypeVar

from petsc4py import PETSc

from dolfinmpm._platform.checks import truth

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

# `turn` is written out, as two calls more would take half as much again. Arguments keep their
# names, so that they may be given by name; `*arguments, **options` would take more than all the
# rest where nothing is measured.
_WITHIN = """
def make(_stage, _function):
    def within{signature}:
        if not _clock.on:
            return _function({arguments})
        _outer = _clock.front
        if _outer is _stage:
            return _function({arguments})
        if _clock.logged:
            _clock.turn(_stage)
        else:
            _now = perf_counter()
            if _outer is not None:
                _outer.seconds += _now - _clock.since
            _clock.front, _clock.since = _stage, _now
        try:
            return _function({arguments})
        finally:
            if _clock.logged:
                _clock.turn(_outer)
            else:
                _now = perf_counter()
                _stage.seconds += _now - _clock.since
                _clock.front, _clock.since = _outer, _now
    return within
"""


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
        signature = inspect.signature(function)
        kinds, given = inspect.Parameter, []
        for p in signature.parameters.values():
            stars = "*" * (p.kind is kinds.VAR_POSITIONAL) + "**" * (p.kind is kinds.VAR_KEYWORD)
            given.append(f"{p.name}={p.name}" if p.kind is kinds.KEYWORD_ONLY else stars + p.name)
        # defaults are objects: they are put in afterwards
        bare = [
            p.replace(annotation=p.empty, default=p.default if p.default is p.empty else None)
            for p in signature.parameters.values()
        ]
        text = _WITHIN.format(signature=inspect.Signature(bare), arguments=", ".join(given))
        made: dict[str, Any] = {}
        # a warning names the first line that is not of the package's files
        exec(compile(text, __file__, "exec"), globals(), made)
        within: Any = functools.wraps(function)(made["make"](self, function))
        within.__defaults__, within.__kwdefaults__ = function.__defaults__, function.__kwdefaults__
        return within


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

    def __call__(self, function: Function) -> Function:
        def within(*arguments: Any, **options: Any) -> Any:
            with self:
                return function(*arguments, **options)

        named: Any = functools.wraps(function)(within)
        return named


def measure_stages(on: bool = True) -> None:
    """Measure the stages of steps from here on, for `stages` of the records in `history`.

    At first nothing is measured, unless PETSc keeps a log (`-log_view`).
    `demos/studies/skip_table.py --only stages` counts what both take.

    Args:
        on: Whether they are measured.

    Raises:
        ParameterError: `on` is neither True nor False.
        RuntimeError: A step is being taken.
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
