"""Times of a computation in time: ends of steps, and a progress bar in simulated time."""

from __future__ import annotations

import itertools
import math
import numbers
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinmpm._platform.argumentchecks import array_of, check_kind, number, shown, whole
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.cut.activation import Activation
from dolfinmpm.grid.userfunctions import VelocityByTime
from dolfinmpm.io.progress import progress_to
from dolfinmpm.solve.step import Step, StepRecord

__all__ = [
    "MotionRecord",
    "Time",
    "check_clock",
    "end_of_step",
    "mean_increment",
    "open_time",
    "set_velocities",
    "times",
    "velocities_at",
]


Array = npt.NDArray[np.float64]

# Steps of a run that nobody would wait for
_MOST = 10**9
# A step that is longer than the whole time by this factor is a mistake
_SWAPPED = 10.0

# First step of a chosen length, as a share of the whole time
_FIRST = 1e-3


class Time(float):
    """A time to step to (s). With an open time the solver chooses the end of the step.

    Attributes:
        open: True for the time at the start of a step with a length chosen by the solver.
        end: Latest end of the step (s).
        at_once: Largest number of fused explicit steps.
        reached: End of the step (s), or None before the step.
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


def open_time(t: Any, now: float) -> Any:
    """The argument of a step, or the open time of a loop with the same number.

    A script may write `problem.step(float(t))`, or pass on a number computed from t. A plain
    number that is not later than the state is no valid time. So it must mean the open time.

    Args:
        t: Argument of the step.
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
    """Times to step to, with a progress bar in simulated time on rank 0; see `steps`.

    `for t in mpm.times(0.6, dt=2.5e-4): problem.step(t)`. With `dt="auto"` the solver chooses the
    length of each step, and takes several fused explicit steps at once. Then `t` is the time at
    the start of the step, and the loop ends when the end is reached. Implicit steps follow the
    `error=` of their problem. The first one is a thousandth of the whole time, or shorter, and a
    step is at most twice as long as the step before. For another first step, call `problem.step`
    before the loop, and give its time as `start`.

    Args:
        end: The last time (s), at which the last step ends exactly; or all times to step to (s).
        dt: Length of the steps (s), or "auto". If the whole time is no multiple of dt, the steps
            are a little shorter. Leave dt out if all times are given.
        start: Time before the first step (s).
        label: Text before the bar.
        at_once: With "auto": largest number of fused explicit steps per call, up to 20. With 1
            the steps take a fifth to two fifths longer, or three times as long if the script
            changes fields between the steps.

    Raises:
        ParameterError: The times do not increase, or are too many. Or dt is far longer than the
            whole time, or given together with several times; at_once is not positive; or a pass of
            an automatic loop took no step.

    >>> import dolfinmpm as mpm
    >>> [round(float(t), 3) for t in mpm.times(0.3, dt=0.1)]
    [0.1, 0.2, 0.3]
    """
    start, at_once = number("start", start, unit="s"), whole("at_once", at_once, 1)
    check_kind("label", label, str, "the text before the bar")
    if isinstance(end, (list, tuple)) or array_of("end", end).ndim == 1:
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
        return _chosen(start, end, label, at_once)
    step = number("dt", dt, 0.0, math.inf, "s")
    if step > _SWAPPED * (end - start):
        raise ParameterError(
            f"dt = {step:g} s is the length of a step, and the whole time up to end = {end:g} s is "
            f"{end - start:g} s: the order is times(end, dt)"
        )
    # rounding must not add a step
    count = (end - start) / step * (1 - 1e-12)
    if count > _MOST:
        raise ParameterError(
            f"dt = {step:g} s makes {count:.3g} steps up to {end:g} s, more than {_MOST:.0e}: "
            'give the length of a step in s, or dt="auto"'
        )
    parts = max(1, math.ceil(count))
    along = (start + (end - start) * k / parts for k in range(1, parts))
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


@unchanged(FOUND)
@dataclass
class MotionRecord(StepRecord):
    """Report of one call of `step` in time.

    Attributes:
        time: Time at the end of the step (s).
        dt: Length of the last substep (s).
    """

    time: float = 0.0
    dt: float = 0.0


def check_clock(time: Any, grid: Mesh) -> None:
    """Raise ParameterError unless `time` is a scalar constant on the grid, or None."""
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


def mean_increment(velocity: VelocityByTime, step: Step) -> float:
    """Increment of a whole step by the trapezoidal rule (m), for a velocity by time."""
    return velocity.mean_velocity(step.start, step.t) * step.dt / step.share


def set_velocities(
    conditions: Sequence[Condition], value: Callable[[VelocityByTime], float]
) -> None:
    """Set the increments of conditions that prescribe velocities.

    Args:
        conditions: Conditions. Conditions without a velocity stay unchanged.
        value: Function from a velocity by time (m/s) to the increment (m).
    """
    for condition in conditions:
        if condition.velocity is not None:
            assert isinstance(condition.value, fem.Constant)
            condition.value.value = value(condition.velocity)


def velocities_at(
    problem: Any, here: Activation, step: Step, increment: Callable[[VelocityByTime], float]
) -> list[Array]:
    """Velocities of prescribed components (m/s), shape (nodes, d), per field. Collective.

    They are prescribed velocities at another time than that of the conditions, and prescribed
    increments over the step's length.

    Args:
        problem: The problem.
        here: The activation.
        step: The step.
        increment: Function from a velocity by time (m/s) to the increment (m) of a whole step.
    """
    conditions, values = problem.essential_conditions.conditions, here.prescribed
    if any(condition.velocity is not None for condition in conditions):
        present = [np.array(condition.values) for condition in conditions]
        set_velocities(conditions, increment)
        values = problem.essential_conditions.at(
            [field.basis for field in here.fields], step.share
        )[1]
        for condition, value in zip(conditions, present):
            if condition.velocity is not None:
                condition.value.value = value
    return [np.asarray(value / step.dt, np.float64) for value in values]


def end_of_step(t: float | None, now: float, wanted: float | None) -> float:
    """End of a step (s).

    Args:
        t: Argument of the user: a time, or a time of `times`.
        now: Time of the state (s).
        wanted: Length allowed by the error of the last step (s). 0 before the first step, which is
            a thousandth of the whole time. None if the problem has no bound of the error.

    Raises:
        ParameterError: t is not a time, or not later than now.
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
        end = min(t.end, now + (wanted or max(_FIRST * (t.end - now), math.ulp(now))))
    if not end > now:
        raise ParameterError(
            f"t = {end:g} s must be later than the time of the state, {now:g} s: a step goes to "
            "the time t, so add the length of the step to the time of the problem"
        )
    return end
