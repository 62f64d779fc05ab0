"""Where the time of a step goes: one clock for PETSc's log and for the records of steps.

Time belongs to one stage alone. A stage that is entered within another stops the clock of that
one until it is left, in PETSc's log too: the residual that SNES asks for counts as evaluation and
assembly, not as solution, and all stages together are no more than the whole.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from time import perf_counter
from typing import Any, TypeVar

from petsc4py import PETSc

__all__ = ["NAMES", "STEP", "Watch", "activate", "assemble", "commit", "evaluate", "migrate",
           "output", "solve"]  # fmt: skip

# what a step consists of, and what is written about it
STEP = ("activate", "evaluate", "assemble", "solve", "commit", "migrate")
NAMES = (*STEP, "output")

Function = TypeVar("Function", bound=Callable[..., Any])

_active = PETSc.Log.isActive


class _Clock:
    """What is entered now.

    Attributes:
        since: Since when the seconds of the stage in front are not counted yet (s).
        entered: Stages that others interrupt, and last the one in front.
        logged: Whether PETSc keeps a log, as it was when the first of them was entered.
        latest: Seconds of the step that was taken last, which output belongs to.
    """

    __slots__ = ("entered", "latest", "logged", "since")

    def __init__(self) -> None:
        self.since, self.logged = 0.0, False
        self.entered: list[Stage] = []
        self.latest: dict[str, float] = {}


_clock = _Clock()


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

    def __enter__(self) -> None:
        clock = _clock
        entered = clock.entered
        if entered:
            outer = entered[-1]
            entered.append(self)
            if outer is self:
                return
            now = perf_counter()
            outer.seconds += now - clock.since
            clock.since = now
            if clock.logged:
                outer.event.end()
                self.event.begin()
            return
        entered.append(self)
        clock.logged = _active()
        if clock.logged:
            self.event.begin()
        clock.since = perf_counter()

    def __exit__(self, *exception: object) -> None:
        clock = _clock
        entered = clock.entered
        entered.pop()
        if entered and entered[-1] is self:
            return
        now = perf_counter()
        self.seconds += now - clock.since
        clock.since = now
        if clock.logged:
            self.event.end()
            if entered:
                entered[-1].event.begin()

    def __call__(self, function: Function) -> Function:
        enter, leave = self.__enter__, self.__exit__

        @functools.wraps(function)
        def within(*arguments: Any, **options: Any) -> Any:
            enter()
            try:
                return function(*arguments, **options)
            finally:
                leave()

        return within  # type: ignore[return-value]


class _Output(Stage):
    """Output is written between steps: it belongs to the one before."""

    __slots__ = ()

    def __exit__(self, *exception: object) -> None:
        before = self.seconds
        super().__exit__(*exception)
        latest = _clock.latest
        if not _clock.entered and latest:
            latest["output"] += self.seconds - before


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
