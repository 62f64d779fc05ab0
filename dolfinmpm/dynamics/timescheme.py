"""Schemes of implicit steps in time, among them Newmark's rule and the generalised-α method.

A step solves f(w) + M a_α = 0 for the increment w at the time level at which forces balance. Here
f is the quasi-static form, the rule gives the acceleration a_α for w, and the mass M is that of
`dolfinmpm.dynamics.mass`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm.assembly.term import ActiveTerm, NewState
from dolfinmpm.contact.bodyinertia import find_acceleration
from dolfinmpm.contact.meanforces import MeanForceWeights
from dolfinmpm.cut.activation import Activation
from dolfinmpm.dynamics.boundarywork import works_of_boundaries
from dolfinmpm.dynamics.clock import (
    MotionRecord,
    Time,
    end_of_step,
    mean_increment,
    open_time,
    set_velocities,
    velocities_at,
)
from dolfinmpm.dynamics.energybounds import SHORTEST
from dolfinmpm.dynamics.gridmotion import GridMotion
from dolfinmpm.dynamics.inertia import Inertia, NewmarkRule
from dolfinmpm.dynamics.transfer import collect
from dolfinmpm.forms.carriedfields import StartAcceleration
from dolfinmpm.forms.declarations import rows_within
from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.freebodies import FreeBodies, Inertial
from dolfinmpm.solve.newstate import new_state
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.scheme import Static
from dolfinmpm.solve.step import Step, StepRecord

__all__ = ["NewmarkScheme", "TimedScheme"]

Array = npt.NDArray[np.float64]


@dataclass
class StepClock:
    """Times of a problem, and the length of its next step.

    Attributes:
        time: Time of the state (s).
        start, end: Start and end of the step (s).
        last: Length of the last substep (s).
        wanted: Length allowed by the error of the last step (s); 0 before the first step.
        largest: Largest displacement in a substep so far (m).
        begun: Whether a substep has been taken.
    """

    time: float = 0.0
    start: float = 0.0
    end: float = 0.0
    last: float = 0.0
    wanted: float = 0.0
    largest: float = 0.0
    begun: bool = False

    def judge(self, dt: float, found: float, allowed: float, order: int) -> str | None:
        """Choose the length of the next step by the error of this step, or refuse this step.

        Args:
            dt: Length of the step (s).
            found: Error of its displacement (m).
            allowed: Bound of the error (m).
            order: Order of the error in the length of the step.

        Returns:
            The reason to refuse the step, or None.
        """
        ratio = (allowed / found) ** (1 / order) if found > 0 else 2.0
        self.wanted = dt * min(max(0.9 * ratio if found > 0 else ratio, 0.2), 2.0)
        if found > allowed:
            return (
                f"the error of the step's displacement is {found:.3g} m and may be {allowed:.3g} m"
            )
        return None


class TimedScheme(Static):
    """An implicit scheme whose steps have a length in seconds.

    Args:
        error: Bound of a step's error, as a share of the largest displacement of a step so far, or
            None.
        constant: DOLFINx constant that holds the time (s), or None.

    Attributes:
        error: The argument.
        clock: Times of the problem.
    """

    record = MotionRecord
    in_time = True

    def __init__(self, error: float | None, constant: fem.Constant | None):
        self.error, self._constant = error, constant
        self.clock = StepClock()
        self._t: Any = None

    def set_time(self, t: float) -> None:
        """Set the time in the form (s)."""
        if self._constant is not None:
            self._constant.value = t

    def begin(self, problem: Any, t: float | None) -> None:
        """See `Static`. Collective.

        Raises:
            ParameterError: The time is missing, or not later than the time of the state.
        """
        clock, self._t = self.clock, open_time(t, self.clock.time)
        wanted = None if self.error is None else clock.wanted
        clock.end, clock.start = end_of_step(self._t, clock.time, wanted), clock.time

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


class NewmarkScheme(TimedScheme):
    """Steps in time by a rule of Newmark's family.

    Args:
        rule: The rule.
        ties_movers: Whether nodes with little support by points are constrained to others, in
            fields that move points.
        error, constant: See `TimedScheme`.

    Attributes:
        rule, ties_movers: The arguments.
        jumped: Whether a load jumps at the start of the step.
        motion: Motion of the grid's nodes in the last step; the problem sets it.
    """

    inertia = True
    motion: GridMotion

    def __init__(
        self,
        rule: NewmarkRule,
        ties_movers: bool,
        error: float | None,
        constant: fem.Constant | None,
    ):
        super().__init__(error, constant)
        self.rule, self.ties_movers, self.jumped = rule, ties_movers, False

    def remark_on(self, step: int) -> str:
        """See `Scheme.remark_on`."""
        rule = self.rule
        if rule.beta >= 0.5 * rule.gamma or rule.alpha_m or rule.alpha_f:
            return ""
        return (
            f". beta = {rule.beta:.4g} is below gamma/2 = {0.5 * rule.gamma:.4g}: in long steps "
            "vibrations grow without bound; take beta=0.25, or much shorter steps"
        )

    @property
    def mean_weights(self) -> MeanForceWeights:
        """Weights of contact forces in the mean over a step."""
        rule = self.rule
        return MeanForceWeights(
            (1.0 - rule.alpha_m) / (2.0 * rule.beta), 1.0 / (1.0 - rule.alpha_f)
        )

    def begin(self, problem: Any, t: float | None) -> None:
        """See `TimedScheme`. Collective."""
        super().begin(problem, t)
        self.jumped = problem.loads.jumps()
        self.motion.ledger.begin()
        self.motion.begin(self.jumped, any(problem.loads.change) or self._constant is not None)

    def adapted(self) -> None:
        """See `TimedScheme`. The step begins with the energies of the points that are there now.

        What merging has taken would else count again in the step, as a loss of the mapping.
        """
        self.motion.ledger.adapted()

    def end(self, record: StepRecord | None) -> None:
        """See `TimedScheme`. The substeps taken so far count. Collective."""
        self.motion.ledger.end()
        super().end(record)

    def _load_at(self, problem: Any, step: Step, share: float) -> None:
        """Set time and loads at a share of a step. Loads that jump do so at its start."""
        clock = self.clock
        done = (step.t - clock.start) / (clock.end - clock.start)
        moved = done - (1 - share) * step.share
        problem.loads.set(done if self.jumped else moved, moved)
        self.set_time(step.t - (1 - share) * step.dt)

    def system(self, problem: Any, step: Step) -> Operator:
        """See `Static`. Collective."""
        motion, rule, points = self.motion, self.rule, problem.points
        set_velocities(problem.bcs, lambda v: mean_increment(v, step))
        # increments and rates belong to the level at which forces balance
        points.dt.value = (1 - rule.alpha_f) * step.dt
        problem.bodies.begin(step.dt)
        here = problem.activate(step)
        self._load_at(problem, step, 0.0)
        scale = step.dt / step.share
        rates = velocities_at(problem, here, step, lambda v: v(step.start) * scale)
        # the accelerations of the last step are no forces at the start of this one
        self._carry_accelerations(problem, here, None)
        motion.to_grid(here, problem.form, step, rates)
        self._load_at(problem, step, 1 - rule.alpha_f)
        conditions = problem.essential_conditions
        if rule.alpha_f and (here.driven or conditions.moved):
            bases, level = [field.basis for field in here.fields], 1 - rule.alpha_f
            here = replace(here, prescribed=conditions.at(bases, level * step.share, level)[1])
        self._begin_free_bodies(problem, step)
        share, level_dt = motion.penalty_energy.share, (1 - rule.alpha_f) * step.dt
        known = {one.k: rule.known(one.V, one.A, step.dt) for one in motion.nodes}
        expected = {one.k: share[one.k] * level_dt * one.V for one in motion.nodes}
        masses, factor = {one.k: one.mass for one in motion.nodes}, rule.factor(step.dt)
        points.inertia.value = factor
        self._carry_accelerations(problem, here, known)
        more: list[ActiveTerm] = [Inertia(here, masses, factor, known, expected)]
        dashpots = motion.dashpots(here)
        return Operator(problem.form, here, more if dashpots is None else [*more, dashpots])

    def _carry_accelerations(
        self, problem: Any, here: Activation, known: Mapping[int, Array] | None
    ) -> None:
        """Set the points' field of accelerations at the start of a step, if the form has it.

        Args:
            problem: The problem.
            here: The activation.
            known: Accelerations of the nodes (m/s²) by field; None for zero.
        """
        for field in problem.form.parts.carried:
            if isinstance(field, StartAcceleration):
                if known is None:
                    problem.points[field.name][:] = 0.0
                    continue
                for one in self.motion.nodes:
                    rows = rows_within(problem.points, one.tags)
                    found = collect(here.fields[one.k].stencils, known[one.k])
                    problem.points[field.name][rows] = found[rows]

    def _begin_free_bodies(self, problem: Any, step: Step) -> None:
        """Begin the step of the free rigid bodies, at the level at which forces balance."""
        rule, dt = self.rule, step.dt
        for body in problem.bodies.free:
            assert body.freedom is not None
            none = np.zeros(body.freedom.increment.size)
            find_acceleration(body, none, self.jumped)
        solver = problem.solver
        if isinstance(solver, Bordered) and isinstance(solver.border, FreeBodies):
            solver.border.inertial = Inertial(
                rule.factor(dt), lambda V, A: rule.known(V, A, dt),
                lambda u, V, A: rule.level_velocity(u, V, A, dt), rule.gamma / (rule.beta * dt),
                level=1.0 - rule.alpha_f, weight=self.mean_weights.weight,
            )  # fmt: skip

    def add_body_work(self, work: float) -> None:
        """See `Static`."""
        self.motion.ledger.work.external += work

    def finish(self, problem: Any, operator: Operator, x: Array, step: Step) -> NewState | str:
        """See `Static`. Collective."""
        motion = self.motion
        # forces balance at a level within the step; the state is the state at its end
        scale = 1.0 / (1.0 - self.rule.alpha_f)
        problem.bodies.put(1.0)
        carried: dict[str, Array] = {}
        for update in problem.form.updates if scale != 1.0 else ():
            if update.carried:
                update.run(operator.points, carried)
        if scale != 1.0:
            operator.move(x, scale)
        # what boundaries and the user's updates have at the end belongs to the loads there
        self._load_at(problem, step, 1.0)
        state = new_state(problem, operator, carried=carried)
        if isinstance(state, str):
            return state
        boundary_work, _ = works_of_boundaries(operator, motion.boundary_forces, state)
        self._load_at(problem, step, 0.5)
        may_halve = step.share > SHORTEST and step.share >= 2 * 0.5**problem.max_halvings
        motion.end(operator)
        reason, largest = self._judge(operator.here, step.dt)
        if reason is None:
            reason = motion.to_points(operator, state, x, scale, may_halve, boundary_work)
        if reason is None:
            self.clock.largest = max(self.clock.largest, largest)
            self.clock.time, self.clock.last = step.t, step.dt
            self._end_free_bodies(problem, operator, step.dt)
            problem.essential_conditions.accept()
        self._load_at(problem, step, 1.0)
        return state if reason is None else reason

    def holding_forces(self, operator: Operator, held: Array) -> Array:
        """See `Static`. Collective."""
        if not operator.form.contact_weights:
            return held
        return np.asarray(held - self.motion.excess_of_supports(operator))

    def _judge(self, here: Activation, dt: float) -> tuple[str | None, float]:
        """Bound the error of a step's displacement, and choose the next length. Collective.

        Returns:
            The reason to halve the step, or None; and the largest displacement (m).
        """
        if self.error is None:
            return None, 0.0
        clock, (found, largest) = self.clock, self.motion.errors(here)
        reason = clock.judge(dt, found, self.error * max(clock.largest, largest), 3)
        return reason, float(largest)

    def _end_free_bodies(self, problem: Any, operator: Operator, dt: float) -> None:
        """Give the free rigid bodies their velocities at the end of a step. Collective."""
        rule = self.rule
        acting = problem.bodies.acting(operator)
        for body in problem.bodies.free:
            free = body.freedom
            assert free is not None
            V, A = free.velocity, free.acceleration
            assert A is not None
            A_end = rule.acceleration(free.increment, V, A, dt)
            own = free.free
            pushed = np.zeros_like(A)
            totals = [c.totals() for c in acting if c.contact.body is body]
            force = sum((np.concatenate(both) for both in totals), np.zeros_like(A))
            M = free.inertia(body.at(1.0 - rule.alpha_f))[np.ix_(own, own)]
            pushed[own] = np.linalg.solve(M, force[own])
            V_end, A_end = rule.with_contact(rule.velocity(V, A, A_end, dt), A_end, pushed, dt)
            free.velocity[own] = V_end[own]
            free.acceleration = np.zeros_like(A)
            free.acceleration[own] = A_end[own]

    def regrid(self) -> None:
        """See `Scheme`."""
        self.motion.regrid()

    def summary(self) -> list[str]:
        """See `Scheme`."""
        rule = self.rule
        numbers = f"β = {rule.beta:g}, γ = {rule.gamma:g}"
        if rule.alpha_m or rule.alpha_f:
            numbers += f", α_m = {rule.alpha_m:g}, α_f = {rule.alpha_f:g}"
        return [f"scheme: {numbers}; velocity mapping: {self.motion.mapping.kind}"]

    def description(self) -> dict[str, str]:
        """See `Scheme`."""
        return {"steps": f"{self.rule}, {self.motion.terms.kind} mass"}

    def identity(self) -> dict[str, Any]:
        """See `Scheme`."""
        return {"mapping": repr(self.motion.mapping)}

    def state(self) -> dict[str, Any]:
        """See `Scheme`."""
        # the account finds points that have come since the last step
        account = self.motion.ledger.state()
        return {**super().state(), **self.motion.state(), **account}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """See `Scheme`."""
        super().set_state(values)
        self.motion.set_state(dict(values))
        self.motion.ledger.set_state(values)
