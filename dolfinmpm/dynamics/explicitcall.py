"""One call of `Explicit.step`: number, length and checks of its steps."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Set
from typing import Any

from dolfinmpm._platform import stages
from dolfinmpm._platform.errors import InstabilityError, ParameterError, raise_together
from dolfinmpm._platform.garbagecollector import free_petsc
from dolfinmpm.body.loadbalance import balance, imbalance
from dolfinmpm.body.pointchecks import overwritten, seal_results, unseal_results
from dolfinmpm.dynamics.clock import MotionRecord, Time, end_of_step, open_time
from dolfinmpm.dynamics.energies import fastest_point
from dolfinmpm.dynamics.faces import set_velocities
from dolfinmpm.dynamics.snapshot import CallMemory
from dolfinmpm.solve.adaptation import adapt
from dolfinmpm.solve.loads import check_loads
from dolfinmpm.solve.step import Step

__all__ = ["ExplicitCall"]

# Number of steps between updates of the critical step, and between checks of the energy balance
_CHECK_EVERY = 20
# Number of steps between copies of the state; a copy costs about as much as one step
_COPY_EVERY = 100
# Fields that determine kinetic energy and work, and fields without effect on the critical step
_KINETIC = frozenset(("velocity", "density", "V0", "F"))
_NOT_CRITICAL = frozenset(("x", "cell", "V", "l", "stress", "acceleration"))


class ExplicitCall:
    """Explicit steps of one call of `Explicit.step`.

    Args:
        problem: The problem.
        loop: The object that takes the steps, such as `FusedSteps`.
        memory: Data that the problem keeps from call to call.
        t: End of the last step (s), or a time of `times`.

    Raises:
        ParameterError: The time is not later than the time of the state.
    """

    def __init__(self, problem: Any, loop: Any, memory: CallMemory, t: float | None):
        self._problem, self._loop, self._memory = problem, loop, memory
        self._most, self._t = math.inf, open_time(t, problem.time)
        if isinstance(self._t, Time) and self._t.open:
            self._most = min(loop.at_once, self._t.at_once)
        given = isinstance(self._t, Time)
        self._target = self._t.end if given else end_of_step(self._t, problem.time, None)
        if not self._target > problem.time:
            raise ParameterError(
                f"t = {self._target:g} s must be later than the time of the state, "
                f"{problem.time:g} s"
            )
        self._whole, self._record = self._target - problem.time, MotionRecord()

    def run(self) -> MotionRecord:
        """Take the steps; returns their record. Collective.

        Raises:
            InstabilityError: The state is not finite, or energy grows without a cause. The state
                is then the last copy.
        """
        started, watch = clock.perf_counter(), stages.Watch()
        problem, record = self._problem, self._record
        touched = self._begin()
        while problem.time < self._target and record.parts < self._most:
            if record.parts % _CHECK_EVERY == 0:
                self._check_and_copy(touched if record.parts == 0 else frozenset())
            self._take_steps()
        self._end()
        record.seconds, record.stages = clock.perf_counter() - started, watch.stop()
        problem.history.append(record)
        if isinstance(self._t, Time):
            self._t.reached = problem.time
        return record

    def _begin(self) -> Set[str]:
        """Begin the call; returns the fields changed since the last call. Collective."""
        problem, memory = self._problem, self._memory
        check_loads(problem.loads.items, problem.form.given, problem.bcs, problem.comm)
        problem._check_still_valid()
        problem.bodies.follow_constants(self._whole)
        touched = memory.touched(problem.points)
        if touched:
            points = problem.points
            raise_together(problem.comm, points.error_in_fields() or overwritten(points))
        unseal_results(problem.points)
        adapted = adapt(problem)
        self._record.split, self._record.merged = adapted.split, adapted.merged
        if adapted.split or adapted.merged:
            touched = touched | _KINETIC
        self._record.migrated += balance(problem.points)
        if touched & _KINETIC or not problem.ledger.started:
            problem.ledger.begin()
        self._loop.start(1.0 / self._whole, touched)
        memory.state.time = math.nan
        if not (memory.single and touched <= _NOT_CRITICAL and self._loop.keeps_speed):
            memory.steps_since = _CHECK_EVERY
        return touched

    def _check_and_copy(self, touched: Set[str]) -> None:
        """Check the energy balance, and copy the state if a copy is due. Collective."""
        problem, parts = self._problem, self._record.parts
        if problem.comm.size > 1:
            free_petsc(problem.comm)
        if parts or touched & _KINETIC:
            self._check_energy(begins=parts == 0)
        if parts % _COPY_EVERY == 0:
            self._memory.state.take(problem.time, problem.ledger.work, touched)

    def _take_steps(self) -> None:
        """Choose number and length of the next equal steps, and take them. Collective."""
        problem, memory, parts = self._problem, self._memory, self._record.parts
        if memory.steps_since >= _CHECK_EVERY or problem.form.boundaries:
            # a point that reaches a wall changes the critical step
            memory.critical, memory.steps_since = problem.critical_step(), 0
        longest, left = problem.courant * memory.critical, self._target - problem.time
        count = max(1, math.ceil(left / longest * (1 - 1e-12)))
        dt = left / count
        now = int(min(count, self._loop.at_once, self._most - parts))
        self._check_speeds(dt)
        now = problem.bodies.followed(dt, now)
        self._run(now, dt, now < min(count, self._most - parts))
        memory.steps_since += now
        if abs(problem.time - self._target) <= 1e-9 * dt:
            # rounding must not add a step
            problem.time = self._target

    def _run(self, count: int, dt: float, more: bool) -> None:
        """Take equal steps. Collective.

        Args:
            count: Number of steps.
            dt: Length of each step (s).
            more: Whether further steps follow in this call.
        """
        problem, record, whole = self._problem, self._record, self._whole
        start, time = problem.time, problem.settings.clock

        def begin(k: int) -> Step:
            end = start + (k + 1) * dt
            set_velocities(problem.bcs, lambda v: v(end - 0.5 * dt) * whole)
            if time is not None:
                time.value = start + k * dt
            return Step(end, dt, dt / whole)

        work = problem.ledger.work
        # velocities are half of the last step behind positions, and none before the first step
        kick = 0.5 * (work.length + dt)
        taken, migrated, reason = self._loop.run(count, dt, kick, more, begin)
        work.add(self._loop.work())
        work.length = dt
        record.parts, record.migrated = record.parts + taken, record.migrated + migrated
        problem.time, record.dt = start + taken * dt, dt
        if reason is not None:
            raise self._unstable(reason, dt)

    def _end(self) -> None:
        """End the call. Collective."""
        problem, record, memory = self._problem, self._record, self._memory
        problem.loads.accept()
        self._check_energy()
        record.time = problem.time
        record.unknowns = problem.here.unknowns.total if problem.here is not None else 0
        record.imbalance = imbalance(problem.points)
        record.bodies = problem.bodies.record()
        self._loop.release()
        seal_results(problem.points)
        memory.moment, memory.single = problem.points.fields.moment(), record.parts == 1

    def _check_speeds(self, dt: float) -> None:
        """Raise if rigid bodies are too fast for steps of a length (s). Collective."""
        bodies = self._problem.bodies
        fault = bodies.fault(dt)
        advice = "give a smaller velocity, or a smaller courant number"
        raise_together(
            self._problem.comm, None if fault is None else ParameterError(f"{fault}; {advice}")
        )
        # forces drive free bodies in the same way on all ranks
        fault = bodies.fault(dt, inertia=True) if bodies.free else None
        if fault is not None:
            raise self._unstable(fault, dt)

    def _check_energy(self, begins: bool = False) -> None:
        """Raise InstabilityError if energy grows without a cause. Collective."""
        reason = self._problem.balance.fault(begins)
        if reason is not None:
            raise self._unstable(reason, self._record.dt)

    def _unstable(self, reason: str, dt: float) -> InstabilityError:
        """The error about a failed step. The state goes back to the last copy. Collective."""
        problem = self._problem
        fastest, energies = fastest_point(problem.points), problem.energies()
        at, longest = problem.time, problem.critical_step()
        self._go_back()
        return InstabilityError(
            f"explicit step at t = {at:.6g} s: {reason}. The step is {dt:.3g} s, the "
            f"critical one {longest:.3g} s; the fastest point is {fastest}; energies (J): kinetic "
            f"{energies.kinetic:.4g}, strain {energies.strain:.4g}, external work "
            f"{energies.external:.4g}. The state is that at t = {problem.time:.6g} s. Against "
            "instability take a smaller courant number, a mapping that damps, or aggregation where "
            "cuts are small"
        )

    def _go_back(self) -> None:
        """Restore the last copy of the state. Collective."""
        problem, state = self._problem, self._memory.state
        problem.bodies.reset()
        if math.isnan(state.time):
            # nothing has moved yet
            return
        state.restore(problem.ledger.work)
        problem.ledger.end()
        problem.balance.forget()
        problem.time = state.time
