"""Quasi-static steps in time: no inertia, but rates, such as those of water that flows."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
from dolfinmpm.solve.advance import NewState
from dolfinmpm.solve.agreement import of_step
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.pressures import refuse_idle, refuse_undetermined
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.solve.step import Step

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
    _of_step = MotionRecord
    _in_time = True

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
        super().__init__(form, increment, points, conditions, **options)
        check_clock(time, points.grid)
        self._error, self._constant = error, time
        self.clock = _TransientClock()
        if error is not None:
            points.add_field(_RATE, (points.gdim,), "m/s")

    @property
    def time(self) -> float:
        """Time that the state is of (s)."""
        return self.clock.time

    @together(given=of_step)
    def step(self, t: float | None = None) -> MotionRecord:
        """Go to a time. Collective.

        Args:
            t: The time (s), later than `time`; or one of `times(end, dt="auto")`, for a step
                whose length follows from the error of the last one.

        Raises:
            ParameterError: The time is not later.
            ConvergenceError, PointsOutsideGridError: See `QuasiStatic.step`. The state, and
                `time`, are those of the last converged part of the step.
        """
        clock, t = self.clock, as_yielded(t, self.time)
        clock.end = end_of(t, clock.time, clock.wanted if self._error is not None else None)
        clock.start = clock.time
        record = super().step()
        assert isinstance(record, MotionRecord)
        record.time, record.dt = clock.time, clock.last
        if isinstance(t, Time):
            t.reached = clock.time
        return record

    def _part(self, done: float, share: float) -> Step:
        whole = self.clock.end - self.clock.start
        return Step(self.clock.start + (done + share) * whole, share * whole, share)

    def _operator(self, step: Step) -> Operator:
        self.points.dt.value = step.dt
        if self._constant is not None:
            self._constant.value = step.t
        set_velocities(self.bcs, lambda v: mean_increment(v, step))
        first = self.here is None
        operator = super()._operator(step)
        if first:
            refuse_idle(self.bcs, operator.here)
            refuse_undetermined(operator)
        return operator

    def _advance(
        self, operator: Operator, x: Array, step: Step, kept: dict[str, Array] | None = None
    ) -> NewState | str:
        state = super()._advance(operator, x, step, kept)
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
        change = rate - self.points[_RATE] if clock.rates else np.zeros_like(rate)
        both = np.array([np.abs(change).max(initial=0.0), np.abs(u).max(initial=0.0)])
        self.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.MAX)
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

    def _memory(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        state, local, cells = super()._memory()
        c = self.clock
        kept = np.array([c.time, c.last, c.wanted, c.largest, float(c.rates)])
        return {**state, "clock": kept}, local, cells

    def _remember(
        self, state: dict[str, Any], local: dict[str, Any] | None, cells: dict[str, Any]
    ) -> None:
        super()._remember(state, local, cells)
        time, last, wanted, largest, rates = (float(value) for value in state["clock"])
        self.clock = _TransientClock(time, time, time, last, wanted, largest, bool(rates))
        if self._constant is not None:
            self._constant.value = time
