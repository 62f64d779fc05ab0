"""The scheme of implicit steps in time: Newmark's rule and the generalised-α method.

A step solves f(w) + M a_α = 0 for the increment w at the time level where forces balance, with
the accelerations that the rule gives for it; f is the quasi-static form, and the mass is that of
`dolfinmpm.dynamics.mass`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm.assembly.term import ActiveTerm, NewState
from dolfinmpm.contact.meanforces import MeanForceWeights
from dolfinmpm.cut.activation import Activation
from dolfinmpm.dynamics.clock import mean_increment
from dolfinmpm.dynamics.faces import set_velocities
from dolfinmpm.dynamics.gains import LEAST
from dolfinmpm.dynamics.inertiaterm import Inertia
from dolfinmpm.dynamics.intime import InTime
from dolfinmpm.dynamics.mappings import NodalMotion
from dolfinmpm.dynamics.motion import Motion
from dolfinmpm.dynamics.rule import Rule
from dolfinmpm.dynamics.transfer import collect
from dolfinmpm.forms.carriedfields import StartAcceleration
from dolfinmpm.forms.declarations import rows_within
from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.freebodies import FreeBodies, Inertial
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.scheme import ended
from dolfinmpm.solve.step import Step, StepRecord

__all__ = ["TimeScheme"]

Array = npt.NDArray[np.float64]


class TimeScheme(InTime):
    """Steps in time by a rule of Newmark's family.

    Args:
        rule: The rule.
        ties_movers: Whether nodes that move points are tied where points hardly support them.
        error, constant: See `InTime`.

    Attributes:
        rule, ties_movers: The arguments.
        jumped: Whether a load jumps at the start of the step.
        motion: What the grid's motion was in the last step; the problem sets it.
    """

    inertia = True
    motion: Motion

    def __init__(
        self, rule: Rule, ties_movers: bool, error: float | None, constant: fem.Constant | None
    ):
        super().__init__(error, constant)
        self.rule, self.ties_movers, self.jumped = rule, ties_movers, False

    @property
    def means(self) -> MeanForceWeights:
        """How contacts act in the mean over a step."""
        rule = self.rule
        return MeanForceWeights(
            (1.0 - rule.alpha_m) / (2.0 * rule.beta), 1.0 / (1.0 - rule.alpha_f)
        )

    def begin(self, problem: Any, t: float | None) -> None:
        """See `InTime`. Collective."""
        super().begin(problem, t)
        self.jumped = problem.loads.jumps()
        self.motion.begin(self.jumped, any(problem.loads.change) or self._constant is not None)
        self.motion.ledger.begin()

    def end(self, record: StepRecord | None) -> None:
        """See `InTime`: what has been taken of a step counts. Collective."""
        self.motion.ledger.end()
        super().end(record)

    def _load_at(self, problem: Any, step: Step, share: float) -> None:
        """Set time and loads to those at a share of a step; what jumps has done so at its start."""
        clock = self.clock
        done = (step.t - clock.start) / (clock.end - clock.start)
        problem.loads.set(done if self.jumped else done - (1 - share) * step.share)
        self.set_time(step.t - (1 - share) * step.dt)

    def system(self, problem: Any, step: Step) -> Operator:
        """See `Static`. Collective."""
        motion, rule, points = self.motion, self.rule, problem.points
        set_velocities(problem.bcs, lambda v: mean_increment(v, step))
        # increments are those of the level where forces balance, and so are rates
        points.dt.value = (1 - rule.alpha_f) * step.dt
        problem.bodies.begin(step.dt)
        here = problem.activate(step)
        self._load_at(problem, step, 0.0)
        motion.to_grid(here, problem.form, step.dt, self._rates(problem, here, step))
        self._load_at(problem, step, 1 - rule.alpha_f)
        if rule.alpha_f and here.driven:
            bases = [field.basis for field in here.fields]
            level = problem.held.at(bases, (1 - rule.alpha_f) * step.share)[1]
            here = replace(here, prescribed=level)
        self._free(problem, step)
        share, free = motion.reserve.share, (1 - rule.alpha_f) * step.dt
        known = {one.k: rule.known(one.V, one.A, step.dt) for one in motion.nodes}
        expected = {one.k: share[one.k] * free * one.V for one in motion.nodes}
        masses, factor = {one.k: one.mass for one in motion.nodes}, rule.factor(step.dt)
        points.inertia.value = factor
        self._carry_accelerations(problem, here, known)
        more: list[ActiveTerm] = [Inertia(here, masses, factor, known, expected)]
        dashpots = motion.dashpots(here, step.dt)
        return Operator(problem.form, here, more if dashpots is None else [*more, dashpots])

    def _carry_accelerations(
        self, problem: Any, here: Activation, known: Mapping[int, Array]
    ) -> None:
        """Give points the accelerations at the start of a step that a form carries."""
        for field in problem.form.parts.carried:
            if isinstance(field, StartAcceleration):
                for one in self.motion.nodes:
                    rows = rows_within(problem.points, one.tags)
                    found = collect(here.fields[one.k].stencils, known[one.k])
                    problem.points[field.name][rows] = found[rows]

    def _free(self, problem: Any, step: Step) -> None:
        """Begin the step of the free rigid bodies, at the level where forces balance."""
        rule, dt = self.rule, step.dt
        for body in problem.bodies.free:
            assert body.freedom is not None
            none = np.zeros(body.freedom.increment.size)
            body.freedom.begin(body.start, none, body.time, self.jumped)
        solver = problem.solver
        if isinstance(solver, Bordered) and isinstance(solver.border, FreeBodies):
            solver.border.inertial = Inertial(
                rule.factor(dt), lambda V, A: rule.known(V, A, dt), 1.0 - rule.alpha_f,
                weight=self.means.weight,
            )  # fmt: skip

    def _rates(self, problem: Any, here: Activation, step: Step) -> list[Array]:
        """Velocities of held components at the start of a step (m/s), each field's. Collective.

        Those prescribed there, and increments over the step's length.
        """
        if not any(condition.velocity for condition in problem.bcs):
            return [np.asarray(g / step.dt, np.float64) for g in here.prescribed]
        bases, scale = [field.basis for field in here.fields], step.dt / step.share
        set_velocities(problem.bcs, lambda v: v(step.t - step.dt) * scale)
        values = problem.held.at(bases, step.share)[1]
        set_velocities(problem.bcs, lambda v: mean_increment(v, step))
        return [np.asarray(g / step.dt, np.float64) for g in values]

    def count(self, work: float) -> None:
        """See `Static`."""
        self.motion.ledger.work.external += work

    def finish(self, problem: Any, operator: Operator, x: Array, step: Step) -> NewState | str:
        """See `Static`. Collective."""
        motion = self.motion
        # forces balance at a level within the step, the state is that at its end
        scale = 1.0 / (1.0 - self.rule.alpha_f)
        problem.bodies.put(1.0)
        kept: dict[str, Array] = {}
        for update in problem.form.updates if scale != 1.0 else ():
            if update.carried:
                update.run(operator.points, kept)
        if scale != 1.0:
            operator.move(x, scale)
        state = ended(problem, operator, kept)
        if isinstance(state, str):
            return state
        self._load_at(problem, step, 0.5)
        parts = step.share >= 2 * 0.5**problem.max_halvings
        parts = parts and step.share > LEAST
        motions = motion.ends(operator, step.dt)
        reason = self._judge(motions, operator.here, step.dt)
        if reason is None:
            reason = motion.to_points(operator, state, motions, step.dt, x, scale, parts)
        if reason is None:
            self.clock.time, self.clock.last = step.t, step.dt
            self._move_free(problem, operator, step.dt)
        self._load_at(problem, step, 1.0)
        return state if reason is None else reason

    def _judge(self, motions: Sequence[NodalMotion], here: Activation, dt: float) -> str | None:
        """Bound the error of a step's displacement, and choose the next length. Collective."""
        if self.error is None:
            return None
        clock, (found, largest) = self.clock, self.motion.errors(motions, here, dt)
        reason = clock.judge(dt, found, self.error * max(clock.largest, largest), 3)
        if reason is None:
            clock.largest = max(clock.largest, float(largest))
        return reason

    def _move_free(self, problem: Any, operator: Operator, dt: float) -> None:
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
            M = free.inertia(body.start)[np.ix_(own, own)]
            pushed[own] = np.linalg.solve(M, force[own])
            V_end, A_end = rule.pushed(rule.velocity(V, A, A_end, dt), A_end, pushed, dt)
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
        return {**super().state(), **self.motion.state(), **self.motion.ledger.state()}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """See `Scheme`."""
        super().set_state(values)
        self.motion.set_state(dict(values))
        self.motion.ledger.set_state(values)
