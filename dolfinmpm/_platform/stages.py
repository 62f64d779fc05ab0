"""Where the time of a step goes: one clock for PETSc's log and for the records of steps.

Time belongs to one stage alone. A stage that is entered within another stops the clock of that
one until it is left, in PETSc's log too: the residual that SNES asks for counts as evaluation and
assembly, not as solution, and all stages together are no more than the whole.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from time import perf_counter
from typing import Any, TypeVar

from petsc4py import PETSc

__all__ = ["NAMES", "STEP", "Watch", "activate", "assemble", "commit", "evaluate", "measure",
           "migrate", "output", "solve"]  # fmt: skip

# what a step consists of, and what is written about it
STEP = ("activate", "evaluate", "assemble", "solve", "commit", "migrate")
NAMES = (*STEP, "output")

Function = TypeVar("Function", bound=Callable[..., Any])

_active = PETSc.Log.isActive


class _Clock:
    """What is entered now.

    Attributes:
        on: Whether anything is measured.
        since: Since when the seconds of the stage in front are not counted yet (s).
        logged: Whether PETSc keeps a log, as it was when the first of them was entered.
        latest: Seconds of the step that was taken last, which output belongs to.
    """

    __slots__ = ("latest", "logged", "on", "since")

    def __init__(self) -> None:
        self.on, self.since, self.logged = True, 0.0, False
        self.latest: dict[str, float] = {}


_clock = _Clock()
# stages that others interrupt, and last the one in front
_entered: list[Stage] = []


class Stage:
    """A part of a step: `with stage: …`, or `@stage` before a function.

    A function of one or two arguments without defaults then takes them by position only.

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

    # Both are called dozens of times a step: they are short rather than divided. A call by name
    # takes a third of the instructions of one by `with`.

    def enter(self) -> None:
        """Begin it; `leave` must follow, whatever happens."""
        clock = _clock
        if not clock.on:
            return
        if _entered:
            outer = _entered[-1]
            _entered.append(self)
            if outer is self:
                return
            now = perf_counter()
            outer.seconds += now - clock.since
            clock.since = now
            if clock.logged:
                outer.event.end()
                self.event.begin()
            return
        _entered.append(self)
        clock.logged = _active()
        if clock.logged:
            self.event.begin()
        clock.since = perf_counter()

    def leave(self) -> None:
        """End it, and go on with what it interrupted."""
        clock = _clock
        if not clock.on:
            return
        _entered.pop()
        if _entered and _entered[-1] is self:
            return
        now = perf_counter()
        self.seconds += now - clock.since
        clock.since = now
        if clock.logged:
            self.event.end()
            if _entered:
                _entered[-1].event.begin()

    def __enter__(self) -> None:
        self.enter()

    def __exit__(self, *exception: object) -> None:
        self.leave()

    def __call__(self, function: Function) -> Function:
        enter, leave, clock = self.enter, self.leave, _clock

        def one(a: Any) -> Any:
            if not clock.on:
                return function(a)
            enter()
            try:
                return function(a)
            finally:
                leave()

        def two(a: Any, b: Any) -> Any:
            if not clock.on:
                return function(a, b)
            enter()
            try:
                return function(a, b)
            finally:
                leave()

        def many(*arguments: Any, **options: Any) -> Any:
            if not clock.on:
                return function(*arguments, **options)
            enter()
            try:
                return function(*arguments, **options)
            finally:
                leave()

        # what is called most often need not pack and unpack its arguments
        parameters = list(inspect.signature(function).parameters.values())
        plain = all(p.default is p.empty and p.kind is p.POSITIONAL_OR_KEYWORD for p in parameters)
        within: Any = {1: one, 2: two}.get(len(parameters), many) if plain else many
        named: Any = functools.wraps(function)(within)
        return named


class _Output(Stage):
    """Output is written between steps: it belongs to the one before."""

    __slots__ = ()

    def leave(self) -> None:
        """End it, and add it to the record of the last step."""
        before = self.seconds
        super().leave()
        latest = _clock.latest
        if not _entered and latest:
            latest["output"] += self.seconds - before


def measure(on: bool) -> None:
    """Switch all measurement on, as it is at first, or off: records of steps then say 0 s.

    What it takes on and off `demos/studies/skip_table.py --only stages` counts.

    Raises:
        RuntimeError: A step is being taken.
    """
    if _entered:
        raise RuntimeError("stages are switched on or off between steps")
    _clock.on = on


activate, evaluate, assemble, solve, commit, migrate = (Stage(name) for name in STEP)
output = _Output("output")
_ALL = (activate, evaluate, assemble, solve, commit, migrate, output)


class Watch:
    """Seconds of each stage since it was made; output that is written later is added."""

    __slots__ = ("_before",)

    def __init__(self) -> None:
        self._before = [stage.seconds for stage in _ALL]

    def stop(self) -> dict[str, float]:
        """Seconds of each stage by name (s), of this process."""
        found = {s.name: s.seconds - before for s, before in zip(_ALL, self._before)}
        _clock.latest = found
        return found
