"""Quasi-static steps in time: no inertia, but rates, such as those of water that flows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.checks import number
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.together import together
from dolfinmpm.assembly.term import NewState
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.clock import (
    MotionRecord,
    Time,
    as_yielded,
    check_clock,
    end_of,
    mean_increment,
)
from dolfinmpm.dynamics.faces import divided, set_velocities
from dolfinmpm.solve.arguments import check_points
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.pressures import refuse_idle, refuse_undetermined
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.solve.scheme import Static, ended
from dolfinmpm.solve.step import Step, StepRecord

__all__ = ["Transient"]

Array = npt.NDArray[np.float64]

# Field of the points: rate of displacement of the last step (m/s)
_RATE = "rate"


@dataclass
class _TransientClock:
    """Where in time a problem is.

    Attributes:
        time: Time that the state is of (s).
        start, end: Times between which the step asked for goes (s).
        last, wanted: Length of its last part, and of the next step where it is free (s).
        largest: Largest displacement of a part so far (m).
        rates: Whether points have the rate of a part before.
    """

    time: float = 0.0
    start: float = 0.0
    end: float = 0.0
    last: float = 0.0
    wanted: float = 0.0
    largest: float = 0.0
    rates: bool = False


class Rates(Static):
    """Quasi-static steps in time; rates are over the length of the step.

    Args:
        points: Material points.
        error: Bound of a step's error, see `Transient`, or None.
        constant: DOLFINx constant that holds the time (s), or None.

    Attributes:
        clock: Where in time the problem is.
    """

    record = MotionRecord
    in_time = True

    def __init__(self, points: MaterialPoints, error: float | None, constant: fem.Constant | None):
        self._points, self._error, self._constant = points, error, constant
        self.clock = _TransientClock()

    def begin(self, problem: Any, t: float | None) -> None:
        """See `Static`.

        Raises:
            ParameterError: The time is missing, or not later.
        """
        clock, t = self.clock, as_yielded(t, self.clock.time)
        clock.end = end_of(t, clock.time, clock.wanted if self._error is not None else None)
        clock.start, self._t = clock.time, t

    def end(self, record: StepRecord | None) -> None:
        """See `Static`."""
        if record is None:
            return
        assert isinstance(record, MotionRecord)
        record.time, record.dt = self.clock.time, self.clock.last
        if isinstance(self._t, Time):
            self._t.reached = self.clock.time

    def part(self, done: float, share: float) -> Step:
        """See `Static`."""
        whole = self.clock.end - self.clock.start
        return Step(self.clock.start + (done + share) * whole, share * whole, share)

    def system(self, problem: Any, step: Step) -> Operator:
        """See `Static`. Collective."""
        self._points.dt.value = step.dt
        if self._constant is not None:
            self._constant.value = step.t
        set_velocities(problem.bcs, lambda v: mean_increment(v, step))
        first = problem.here is None
        operator = super().system(problem, step)
        if first:
            refuse_idle(problem.bcs, operator.here)
            refuse_undetermined(operator)
        return operator

    def finish(self, problem: Any, operator: Operator, x: Array, step: Step) -> NewState | str:
        """See `Static`. Collective."""
        state = ended(problem, operator)
        if isinstance(state, str):
            return state
        if self._error is not None:
            reason = self._judge(operator, state, step.dt)
            if reason is not None:
                return reason
        self.clock.time, self.clock.last = step.t, step.dt
        return state

    def _judge(self, operator: Operator, state: NewState, dt: float) -> str | None:
        """Bound the error ½ Δt |u/Δt − rate| of a step, and choose the next. Collective."""
        assert self._error is not None
        u, clock = operator.points.motion(operator.here.movers)[0], self.clock
        rate = u / dt
        change = rate - self._points[_RATE] if clock.rates else np.zeros_like(rate)
        both = np.array([np.abs(change).max(initial=0.0), np.abs(u).max(initial=0.0)])
        self._points.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.MAX)
        found, allowed = 0.5 * dt * both[0], self._error * max(clock.largest, both[1])
        growth = 0.9 * math.sqrt(allowed / found) if found else 2.0
        clock.wanted = dt * min(max(growth, 0.2), 2.0)
        if found > allowed:
            return (
                f"the error of the step's displacement is {found:.3g} m and may be {allowed:.3g} m"
            )
        clock.largest, clock.rates = max(clock.largest, both[1]), True
        state.fields[_RATE] = np.asarray(rate, np.float64)
        return None

    def state(self) -> dict[str, Any]:
        """See `Scheme`."""
        c = self.clock
        return {"clock": np.array([c.time, c.last, c.wanted, c.largest, float(c.rates)])}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """See `Scheme`."""
        time, last, wanted, largest, rates = (float(value) for value in values["clock"])
        self.clock = _TransientClock(time, time, time, last, wanted, largest, bool(rates))
        if self._constant is not None:
            self._constant.value = time


class Transient(QuasiStatic):
    """Quasi-static steps in time: forces balance at the end of each, rates are over `points.dt`.

    For weak forms with rates and without inertia, such as consolidation; see `poromechanics`.
    Each step, and each part of one that is halved, sets the constant `points.dt` to its length.

    Args:
        form, increment, points, bcs, options: See `QuasiStatic`.
        error: Largest error of a step's displacement, half its length times the change of the
            rate (that of backward Euler's rule), as a share of the largest displacement of a
            step so far; a step that exceeds it is halved. None for no bound.
        time: DOLFINx constant that holds the time (s), for forms that depend on it.

    The first step ends with an error if a pressure is determined up to a constant alone, or is held
    where the body is not.

    Raises:
        ParameterError: An argument is not what it may be.
    """

    history: list[MotionRecord]  # type: ignore[assignment]
    scheme: Rates
    _takes_scheme = False

    @together
    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        error: float | None = None,
        time: fem.Constant | None = None,
        **options: Any,
    ):
        if error is not None:
            number("error", error, 0.0)
        conditions, faces = divided(bcs)
        if faces:
            raise ParameterError(
                f"the face at '{faces[0].where}' acts on velocities, and Transient has no inertia: "
                "hold the side with mpm.rollers or mpm.fixed, or take Newmark"
            )
        check_points(points)
        check_clock(time, points.grid)
        scheme = Rates(points, error, time)
        super().__init__(form, increment, points, conditions, scheme=scheme, **options)
        if error is not None:
            points.add_field(_RATE, (points.gdim,), "m/s")

    @property
    def time(self) -> float:
        """Time that the state is of (s)."""
        return self.scheme.clock.time
