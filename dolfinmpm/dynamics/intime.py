"""What implicit schemes in time have in common: where in time a problem is, and steps by error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinmpm.dynamics.clock import MotionRecord, Time, as_yielded, end_of
from dolfinmpm.solve.scheme import Static
from dolfinmpm.solve.step import Step, StepRecord

__all__ = ["InTime", "StepClock"]


@dataclass
class StepClock:
    """Where in time a problem is.

    Attributes:
        time: Time that the state is of (s).
        start, end: Times between which the step asked for goes (s).
        last, wanted: Length of the last part of a step, and of the next where it is free (s).
        largest: Largest displacement of a part so far (m).
        begun: Whether a part has been taken.
    """

    time: float = 0.0
    start: float = 0.0
    end: float = 0.0
    last: float = 0.0
    wanted: float = 0.0
    largest: float = 0.0
    begun: bool = False

    def judge(self, dt: float, found: float, allowed: float, order: int) -> str | None:
        """Choose the length of the next step by the error of this one, or refuse this one.

        Args:
            dt: Length of the step (s).
            found: Error of its displacement (m).
            allowed: Bound of the error (m).
            order: Power of the length that the error goes with.
        """
        ratio = (allowed / found) ** (1 / order) if found > 0 else 2.0
        self.wanted = dt * min(max(0.9 * ratio if found > 0 else ratio, 0.2), 2.0)
        if found > allowed:
            return (
                f"the error of the step's displacement is {found:.3g} m and may be {allowed:.3g} m"
            )
        return None


class InTime(Static):
    """An implicit scheme whose steps have a length in seconds.

    Args:
        error: Bound of a step's error, as a share of the largest displacement of a step so far; or
            None.
        constant: DOLFINx constant that holds the time (s), or None.

    Attributes:
        error: The argument.
        clock: Where in time the problem is.
    """

    record = MotionRecord
    in_time = True

    def __init__(self, error: float | None, constant: fem.Constant | None):
        self.error, self._constant = error, constant
        self.clock = StepClock()
        self._t: Any = None

    def set_time(self, t: float) -> None:
        """Tell the form the time (s)."""
        if self._constant is not None:
            self._constant.value = t

    def begin(self, problem: Any, t: float | None) -> None:
        """See `Static`. Collective.

        Raises:
            ParameterError: The time is missing, or not later.
        """
        clock, self._t = self.clock, as_yielded(t, self.clock.time)
        wanted = None if self.error is None else clock.wanted
        clock.end, clock.start = end_of(self._t, clock.time, wanted), clock.time

    def substep(self, done: float, share: float) -> Step:
        """See `Static`."""
        whole = self.clock.end - self.clock.start
        return Step(self.clock.start + (done + share) * whole, share * whole, share)

    def fail(self) -> None:
        """See `Static`."""
        self.set_time(self.clock.time)

    def end(self, record: StepRecord | None) -> None:
        """See `Static`. Collective."""
        if record is None:
            return
        assert isinstance(record, MotionRecord)
        record.time, record.dt = self.clock.time, self.clock.last
        if isinstance(self._t, Time):
            self._t.reached = self.clock.time

    def state(self) -> dict[str, Any]:
        """See `Scheme`."""
        return {"clock": np.array(astuple(self.clock), float)}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """See `Scheme`."""
        time, start, end, last, wanted, largest, begun = values["clock"].tolist()
        self.clock = StepClock(time, start, end, last, wanted, largest, bool(begun))
        self.set_time(self.clock.time)
