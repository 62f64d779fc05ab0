"""Times of a computation in time: where steps end, and a progress bar in simulated time."""

from __future__ import annotations

import itertools
import math
import numbers
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinmpm._platform.checks import number, shown, whole
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.io.progress import progress_to
from dolfinmpm.solve.step import Step, StepRecord

__all__ = ["MotionRecord", "Time", "as_yielded", "check_clock", "end_of", "mean_increment", "times"]


# Steps of a run that nobody would wait for
_MOST = 10**9


class Time(float):
    """A time (s) to step to; an open one lets the solver choose where its step ends.

    Attributes:
        open: Whether this is the time at the start of a step whose length the solver chooses.
        end: Latest time that the step may end at.
        at_once: How many fused explicit steps may be taken at most.
        reached: Where a solver ended the step, or None before.
    """

    def __new__(cls, value: float, end: float | None = None, at_once: int = 1):  # noqa: D102
        made = super().__new__(cls, value)
        made.open = end is not None
        made.end = value if end is None else end
        made.at_once = at_once
        made.reached = None
        return made

    open: bool
    end: float
    at_once: int
    reached: float | None


# Open times whose loops wait for their steps
_waiting: list[Time] = []


def as_yielded(t: Any, now: float) -> Any:
    """What a step was given; the open time of a loop where it is that time's bare number.

    A script may well write `problem.step(float(t))`, or hand on what it has computed with t. A
    plain time that is not later than the state's is no time to go to, so that nothing else can be
    meant.

    Args:
        t: What a step was given.
        now: Time of the state (s).
    """
    if isinstance(t, Time) or not isinstance(t, numbers.Real) or float(t) > now:
        return t
    return next((one for one in reversed(_waiting) if one == t), t)


def times(
    end: float | Sequence[float],
    dt: float | str = "auto",
    *,
    start: float = 0.0,
    label: str = "",
    at_once: int = 20,
) -> Iterator[Time]:
    """Times to step to, with a progress bar in simulated time on rank 0, as `steps` draws it.

    `for t in mpm.times(0.6, dt=2.5e-4): problem.step(t)`. With `dt="auto"` the solver chooses
    each step, and takes several fused explicit ones at once: `t` is then the time at its start, and
    the loop ends when the end is reached.

    Args:
        end: The last time (s), which the last step ends at exactly; or all times to step to.
        dt: Length of the steps (s), made a little shorter if the whole is no multiple of it; or
            "auto". Not of times that are all given.
        start: Time before the first step (s).
        label: What is computed, written before the bar.
        at_once: With "auto", how many fused explicit steps a call takes at most, up to 20; one by
            one they take a fifth to two fifths longer, or three times as long where fields are
            changed between them.

    Raises:
        ParameterError: The times do not rise, or are too many, dt is given beside several of them,
            at_once is not positive, or a step was not taken in an automatic loop.
    """
    start = number("start", start, unit="s")
    if np.ndim(end) == 1:
        if dt != "auto":
            raise ParameterError(
                f"dt = {shown(dt)} is of a single time to go to; of times = {shown(end)} all steps "
                "are given: leave dt out, or give the last time alone"
            )
        listed = [number("time", t, unit="s") for t in np.asarray(end, object)]
        if not listed or np.any(np.diff([start, *listed]) <= 0):
            raise ParameterError(f"times = {shown(end)} must rise, from after {start:g} s")
        return _given(start, listed[-1], listed, label)
    end = number("end", end, start, math.inf, "s")
    if isinstance(dt, str):
        if dt != "auto":
            raise ParameterError(f'dt = {shown(dt)} must be a time in s or "auto"')
        return _chosen(start, end, label, whole("at_once", at_once, 1))
    step = number("dt", dt, 0.0, math.inf, "s")
    # rounding must not add a step
    count = max(1, math.ceil((end - start) / step * (1 - 1e-12)))
    if count > _MOST:
        raise ParameterError(
            f"dt = {step:g} s makes {count:.3g} steps up to {end:g} s, more than {_MOST:.0e}: "
            'give the length of a step in s, or dt="auto"'
        )
    along = (start + (end - start) * k / count for k in range(1, count))
    return _given(start, end, itertools.chain(along, [end]), label)


def _given(start: float, end: float, listed: Iterable[float], label: str) -> Iterator[Time]:
    with progress_to(end - start, label) as show:
        for t in listed:
            yield Time(t)
            show(t - start)


def _chosen(start: float, end: float, label: str, at_once: int) -> Iterator[Time]:
    with progress_to(end - start, label) as show:
        t = start
        while t < end:
            now = Time(t, end, at_once)
            _waiting.append(now)
            try:
                yield now
            finally:
                # two loops may wait at equal times
                _waiting[:] = [one for one in _waiting if one is not now]
            if now.reached is None:
                raise ParameterError(
                    f"no step was taken from t = {t:g} s: call problem.step(t) with the t of the "
                    "loop, which lets the solver choose the step"
                )
            t = now.reached
            show(t - start)


@dataclass
class MotionRecord(StepRecord):
    """What one step in time did.

    Attributes:
        time: Where it ended (s).
        dt: Length of its last part (s).
    """

    time: float = 0.0
    dt: float = 0.0


def check_clock(time: Any, grid: Mesh) -> None:
    """Raise ParameterError unless it is a constant that can hold the time, or None."""
    if time is None:
        return
    if not isinstance(time, fem.Constant) or time.ufl_shape != ():
        raise ParameterError(
            f"time = {shown(time)} must be a scalar dolfinx.fem.Constant, which steps set to the "
            "time that they go to: dolfinx.fem.Constant(grid, 0.0)"
        )
    if time.ufl_domain() != grid.ufl_domain():
        raise ParameterError(
            "time is a constant of another mesh than that of the points: make it with "
            "dolfinx.fem.Constant(points.grid, 0.0)"
        )


def mean_increment(velocity: Callable[[float], float], step: Step) -> float:
    """Increment of a whole step by the trapezoidal rule (m), for a velocity by time."""
    mean = 0.5 * (velocity(step.t - step.dt) + velocity(step.t))
    return mean * step.dt / step.share


def end_of(t: float | None, now: float, wanted: float | None) -> float:
    """Where a step ends (s).

    Args:
        t: What the user gave: a time, or one of `times`.
        now: Time of the state (s).
        wanted: Length that the error of the last step allows (s), 0 before the first; None if
            no error chooses lengths.

    Raises:
        ParameterError: It is no time, or not later than now.
    """
    if t is None:
        raise ParameterError("step(t) needs the time to go to (s)")
    end = number("t", t, unit="s")
    if isinstance(t, Time) and t.open:
        if wanted is None:
            raise ParameterError(
                'with times(end, dt="auto") the error of a step chooses the length of the '
                "next: give the problem error=1e-3, or times a dt in s"
            )
        end = min(t.end, now + (wanted or math.inf))
    if not end > now:
        raise ParameterError(f"t = {end:g} s must be later than the time of the state, {now:g} s")
    return end
