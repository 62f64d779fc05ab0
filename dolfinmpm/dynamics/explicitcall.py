"""One call of `Explicit.step`: number, length and checks of its steps, and copies of the state."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.errors import InstabilityError, ParameterError, raise_together
from dolfinmpm._platform.garbagecollector import free_petsc
from dolfinmpm.body.loadbalance import balance, imbalance
from dolfinmpm.body.pointchecks import overwritten, seal_results, unseal_results
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.rigidbodies import RigidBodies
from dolfinmpm.dynamics.clock import MotionRecord, Time, end_of_step, open_time, set_velocities
from dolfinmpm.dynamics.energies import fastest_point
from dolfinmpm.dynamics.explicitbase import ExplicitStep, checked_courant
from dolfinmpm.dynamics.worksums import Work
from dolfinmpm.solve.adaptation import adapt
from dolfinmpm.solve.bodyrecords import BodyRecords
from dolfinmpm.solve.loads import check_loads

__all__ = ["CallMemory", "ExplicitCall", "Snapshot"]

# Fields that no step changes
_FIXED = frozenset(("id", "tag", "x0", "V0", "l0", "density"))


class Snapshot:
    """A copy of the state of points and bodies. The next copy uses the same memory.

    Args:
        points: Material points.
        bodies: Rigid bodies.
        markers: Markers of boundaries that do not fit the grid.

    Attributes:
        time: Time of the copy (s).
    """

    def __init__(
        self, points: MaterialPoints, bodies: RigidBodies, markers: Sequence[MaterialPoints] = ()
    ):
        self.time = math.nan
        self._bodies, self._of_bodies = bodies, bodies.state()
        self._sets, self._work = [points, *markers], Work().values()
        self._revision = -1
        self._fields: list[dict[str, npt.NDArray]] = [{} for _ in self._sets]

    def take(self, time: float, work: Work, touched: Set[str]) -> None:
        """Copy the present state.

        Args:
            time: Time of the state (s).
            work: Works until this time.
            touched: Fields of the points that the user may have changed since the last copy.
        """
        revision = self._sets[0].revision
        still = _FIXED - touched if revision == self._revision else frozenset()
        self._revision = revision
        self.time, self._of_bodies = time, self._bodies.state()
        self._work = work.values()
        for k, (points, kept) in enumerate(zip(self._sets, self._fields)):
            self._fields[k] = {}
            for name in points.fields:
                values, own = points.fields.read(name), kept.get(name)
                if k == 0 and name in still and own is not None:
                    self._fields[k][name] = own
                    continue
                if own is None or own.shape != values.shape:
                    own = np.empty_like(values)
                np.copyto(own, values)
                self._fields[k][name] = own

    def restore(self, work: Work) -> None:
        """Restore the state and the works. Points go back to their ranks. Collective."""
        self._bodies.set_state(self._of_bodies)
        work.take(self._work)
        for points, fields in zip(self._sets, self._fields):
            for name, values in fields.items():
                points.fields[name] = values.copy()
            points.recount()
            points.locate()


@dataclass
class CallMemory:
    """Data that explicit steps keep from call to call.

    Attributes:
        state: Copy of the state to which a failed run goes back.
        moment: End of the last call, to find fields changed later; see `FieldArrays`. None if all
            fields count as changed.
        critical: The last critical step (s).
        steps_since: Number of steps since the critical step was found.
        unchecked: Number of steps since the energy that laws dissipate was looked at.
        single: Whether the last call took one step. Calls with one step share a critical step. A
            call with several steps finds its own.
    """

    state: Snapshot
    moment: int | None = None
    critical: float = math.nan
    steps_since: int = 0
    unchecked: int = 0
    single: bool = False

    def touched(self, points: MaterialPoints) -> Set[str]:
        """Fields that may have been changed since the last call, on any rank. Collective."""
        fields, comm = points.fields, points.comm
        touched, self.moment = fields.touched(self.moment), None
        if comm.size == 1:
            return touched
        names = sorted(fields)
        flags = np.array([name in touched for name in names], np.uint8)
        comm.Allreduce(MPI.IN_PLACE, flags, op=MPI.MAX)
        return {name for name, flag in zip(names, flags) if flag}


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
        checked_courant(problem.courant)  # a script may have set it since
        conditions = problem.essential_conditions
        check_loads(problem.loads.items, problem.form.given, conditions, problem.comm)
        problem._check_still_valid()
        problem.bodies.follow_constants(self._whole)
        touched = memory.touched(problem.points)
        if touched:
            points = problem.points
            raise_together(problem.comm, points.error_in_fields() or overwritten(points))
            problem.form.check_new_tags()
            problem.balance.touched()
        unseal_results(problem.points)
        if problem.form.adaptive:
            adapted = adapt(problem)
            self._record.split, self._record.merged = adapted.split, adapted.merged
            if adapted.split or adapted.merged:
                touched = touched | _KINETIC
        if problem.comm.size > 1:
            self._record.migrated += balance(problem.points)
        if touched & _KINETIC or not problem.ledger.started:
            problem.ledger.begin()
        problem.form.set_contacts()
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
        memory.unchecked += now
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

        # velocities are half of the last step behind positions, and none before the first step
        kick = 0.5 * (problem.ledger.work.length + dt)

        def begin(k: int) -> ExplicitStep:
            end = start + (k + 1) * dt
            set_velocities(problem.bcs, lambda v: v(end - 0.5 * dt) * whole)
            if time is not None:
                time.value = start + k * dt
            return ExplicitStep(end, dt, dt / whole, dt if k else kick)

        work = problem.ledger.work
        taken, migrated, reason = self._loop.run(count, more, begin)
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
        if problem.comm.size > 1:
            record.imbalance = imbalance(problem.points)
        record.bodies = BodyRecords(problem.bodies.record())
        self._loop.release()
        seal_results(problem.points)
        memory.moment, memory.single = problem.points.fields.moment(), record.parts == 1

    def _check_speeds(self, dt: float) -> None:
        """Raise if rigid bodies are too fast for steps of a length (s). Collective."""
        bodies = self._problem.bodies
        fault = bodies.too_fast(dt)
        advice = "give a smaller velocity, or a smaller courant number"
        raise_together(
            self._problem.comm, None if fault is None else ParameterError(f"{fault}; {advice}")
        )
        # forces drive free bodies in the same way on all ranks
        fault = bodies.too_fast(dt, inertia=True) if bodies.free else None
        if fault is not None:
            raise self._unstable(fault, dt)

    def _check_energy(self, begins: bool = False) -> None:
        """Raise InstabilityError if energy grows without a cause. Collective."""
        balance, memory = self._problem.balance, self._memory
        reason = balance.gain(begins)
        if reason is None and memory.unchecked >= _COPY_EVERY:
            # strains of all points cost as much as two steps
            reason, memory.unchecked = balance.given_back(), 0
        if reason is not None:
            raise self._unstable(reason, self._record.dt)

    def _unstable(self, reason: str, dt: float) -> InstabilityError:
        """The error about a failed step. The state goes back to the last copy. Collective."""
        problem = self._problem
        fastest, energies = fastest_point(problem.points), problem.energies()
        at, longest = problem.time, problem.critical_step()
        if problem.terms.warned:
            # nodes that almost no point moves: shorter steps do not help
            advice = "The consistent mass is next to singular: do what the SingularMassWarning says"
        else:
            advice = (
                "Against instability take a smaller courant number, a mapping that damps, or "
                "aggregation where cuts are small"
            )
        self._go_back()
        return InstabilityError(
            f"explicit step at t = {at:.6g} s: {reason}. The step is {dt:.3g} s, the "
            f"critical one {longest:.3g} s; the fastest point is {fastest}; energies (J): kinetic "
            f"{energies.kinetic:.4g}, strain {energies.strain:.4g}, external work "
            f"{energies.external:.4g}. The state is that at t = {problem.time:.6g} s. {advice}"
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
