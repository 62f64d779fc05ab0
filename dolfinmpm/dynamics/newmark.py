"""Implicit steps in time: Newmark's rule and the generalised-α method around a weak form.

A step solves f(w) + M a_α = 0 for the increment w at the time level where forces balance, with
the accelerations that the rule gives for it; f is the quasi-static form, and the mass is that of
`dolfinmpm.dynamics.mass`. Newmark's rule (1959) is, with the increment u of the whole step,

    a' = (u − Δt v) / (β Δt²) − (1/(2β) − 1) a,    v' = v + Δt ((1 − γ) a + γ a'),

and the generalised-α method (Chung & Hulbert 1993, doi 10.1115/1.2900803) balances the forces at
w = (1 − α_f) u, under the loads of that time, with the acceleration (1 − α_m) a' + α_m a.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from dolfinmpm._platform.checks import choice, number
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.together import together
from dolfinmpm.assembly.stencilsums import add_product
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.means import Means
from dolfinmpm.cut.participants import Activation
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.dynamics.clock import (
    MotionRecord,
    Time,
    as_yielded,
    check_clock,
    end_of,
    mean_increment,
)
from dolfinmpm.dynamics.energies import angular_momentum, momentum_of
from dolfinmpm.dynamics.faces import Sides, divided, set_velocities
from dolfinmpm.dynamics.gains import LEAST
from dolfinmpm.dynamics.ledger import Energies, Ledger
from dolfinmpm.dynamics.mappings import Mapping, mapping_of
from dolfinmpm.dynamics.mass import KINDS, Mass, mass_terms
from dolfinmpm.dynamics.motion import Motion
from dolfinmpm.dynamics.rule import Rule
from dolfinmpm.dynamics.transfer import collect
from dolfinmpm.forms.carriedfields import StartAcceleration
from dolfinmpm.forms.declarations import rows_within
from dolfinmpm.forms.formchecks import check_levels
from dolfinmpm.solve.advance import NewState
from dolfinmpm.solve.agreement import of_step
from dolfinmpm.solve.arguments import increments_of
from dolfinmpm.solve.bodyfields import refuse_bodies
from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.freebodies import FreeBodies, Inertial, check_masses
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.solve.step import Step
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["GeneralisedAlpha", "Newmark", "TimeStepping"]

Array = npt.NDArray[np.float64]


class InertialOperator(Operator):
    """A weak form with inertial forces, on an activation. Collective.

    Args:
        form, here: See `Operator`.
        masses: The masses of the fields that move points, in the order of `here.movers`.
        factor: Derivative of the accelerations by the increments (1/s²).
        known: The rest of them (m/s²), shape (nodes, d) each.
        expected: Increments that penalties on changes of velocity leave free (m), likewise.
        dashpots: Dashpots on the nodes by the increments, and forces of the velocities that do
            not depend on these (N), shape (nodes, d); or None.
    """

    def __init__(
        self,
        form: WeakForm,
        here: Activation,
        masses: Sequence[Mass],
        factor: float,
        known: Sequence[Array],
        expected: Sequence[Array],
        dashpots: tuple[Blocks, Array] | None = None,
    ):
        self._known, self._dashpots = dict(zip(here.movers, known)), dashpots
        self._expected = dict(zip(here.movers, expected))
        self._masses = [b for mass in masses for b in mass.blocks]
        self._inertia = [replace(b, values=factor * b.values) for b in self._masses]
        if dashpots is not None:
            self._inertia.append(dashpots[0])
        super().__init__(form, here)

    def renew_external(self) -> None:
        super().renew_external()
        # M times what is known acts as a load does
        forces = self.here.unknowns.nodal()
        for b in self._masses:
            add_product(b, self._on_all(self._known), forces.arrays)
        for b in self.here.changes:
            add_product(replace(b, values=-b.values), self._on_all(self._expected), forces.arrays)
        forces.add_up()
        self._loads = [np.array(values) for values in self._external.arrays]
        for k in self._known:
            self._external.arrays[k][...] += forces.arrays[k]
        if self._dashpots is not None:
            self._external.arrays[0][...] += self._dashpots[1]

    @property
    def loads(self) -> Sequence[Array]:
        return self._loads

    def _linear(self) -> list[Blocks]:
        return [*super()._linear(), *self.here.changes, *self._inertia]

    def _on_all(self, given: dict[int, Array]) -> list[Array]:
        """Nodal values of all fields, those that none are given of being zero."""
        return [given.get(k, np.zeros_like(u)) for k, u in enumerate(self._u.arrays)]


class TimeStepping(QuasiStatic):
    """A weak form in time, by a rule of Newmark's family; see `Newmark` for the arguments."""

    history: list[MotionRecord]  # type: ignore[assignment]
    _of_step = MotionRecord
    _in_time = True
    _has_inertia = True

    def __init__(
        self,
        rule: Rule,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        mass: str = "consistent",
        mapping: Mapping | str | None = None,
        ghost_mass: float | None = None,
        error: float | None = None,
        time: fem.Constant | None = None,
        **options: Any,
    ):
        mass = choice("mass", mass, KINDS)
        chosen = mapping_of(mapping, "pic" if mass == "consistent" else "accel")
        u = increments_of(increment, points)[0]
        chosen = chosen.on(u._dolfinmpm_space.basis, mass)
        if u.ufl_shape != (points.gdim,):
            raise ParameterError(
                f"the first increment must be a displacement of {points.gdim} components, got "
                f"shape {u.ufl_shape}: it moves the points"
            )
        if error is not None:
            number("error", error, 0.0)
        if u._dolfinmpm_space.configuration != "updated":
            raise ParameterError(
                'steps in time need Space(..., configuration="updated"), got "total": velocities '
                "are mapped where the points are now"
            )
        chosen.add_fields(points)
        conditions, faces = divided(bcs)
        for face in faces:
            if face.friction is not None:
                raise ParameterError(
                    f"the frictional face at '{face.where}' is of explicit steps; hold the side "
                    "with mpm.rollers or mpm.fixed, or take mpm.Explicit"
                )
        self._ties_movers = mass == "consistent" and ghost_mass is None
        super().__init__(form, increment, points, conditions, **options)
        check_levels(self.form.parts.carried, 1.0 - rule.alpha_f, type(self).__name__)
        terms = mass_terms(self.form, self.fields, mass, ghost_mass, factorised=True)
        if faces:
            refuse_bodies(self.fields, "a face of the grid", "hold the sides with conditions")
        sides = Sides(faces, points, self.bcs)
        own = rule.alpha_m == rule.alpha_f == 0.0
        rule = replace(rule, by_forces=self._ties_movers and own)
        ledger = Ledger(points, self.form)
        check_clock(time, points.grid)
        self.motion = Motion(points, rule, chosen, terms, error, time, sides, ledger)
        check_masses(self.bodies)
        self.form.inertia = terms
        weight = (1.0 - rule.alpha_m) / (2.0 * rule.beta)
        terms.means = Means(weight, 1.0 / (1.0 - rule.alpha_f))

    def _scheme(self) -> list[str]:
        rule, motion = self.motion.rule, self.motion
        numbers = f"β = {rule.beta:g}, γ = {rule.gamma:g}"
        if rule.alpha_m or rule.alpha_f:
            numbers += f", α_m = {rule.alpha_m:g}, α_f = {rule.alpha_f:g}"
        return [f"scheme: {numbers}; velocity mapping: {motion.mapping.kind}", *super()._scheme()]

    @property
    def ledger(self) -> Ledger:
        """Where energy comes from and goes to."""
        return self.motion.ledger

    @property
    def time(self) -> float:
        """Time that the state is of (s)."""
        return self.motion.time

    @together
    def energies(self) -> Energies:
        """Energies of the body now, and work done since the first step. Collective.

        Bodies that meet in one field of velocities lose energy by the mapping, see `Energies`.
        """
        return self.ledger.energies()

    @together
    def momentum(self) -> Array:
        """Linear momentum of the body (kg m/s), shape (d,). Collective."""
        return momentum_of(self.points)

    @together
    def angular_momentum(self) -> Array:
        """Angular momentum about the origin (kg m²/s), shape (1,) or in 3D (3,). Collective.

        That of the affine parts which "apic" gives the points is counted.
        """
        spins = self.motion.mapping.kind == "apic"
        return angular_momentum(self.points, self.points["velocity_moment"] if spins else None)

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
        motion, t = self.motion, as_yielded(t, self.time)
        end = end_of(t, motion.time, motion.wanted if motion.chooses else None)
        jumped = self._loads.jumps()
        motion.begin(end, jumped, any(self._loads.change))
        self.ledger.begin()
        try:
            record = super().step()
        finally:
            # what has been taken of a step counts
            self.ledger.end()
        assert isinstance(record, MotionRecord)
        record.time, record.dt = motion.time, motion.last
        if isinstance(t, Time):
            t.reached = motion.time
        return record

    def _part(self, done: float, share: float) -> Step:
        motion = self.motion
        whole = motion.end - motion.start
        return Step(motion.start + (done + share) * whole, share * whole, share)

    def _load_at(self, step: Step, share: float) -> None:
        """Set time and loads to those at a share of a step; what jumps has done so at its start."""
        motion = self.motion
        done = (step.t - motion.start) / (motion.end - motion.start)
        self._loads.set(done if motion.jumped else done - (1 - share) * step.share)
        motion.set_time(step.t - (1 - share) * step.dt)

    def _operator(self, step: Step) -> Operator:
        motion, rule = self.motion, self.motion.rule
        set_velocities(self.bcs, lambda v: mean_increment(v, step))
        # increments are those of the level where forces balance, and so are rates
        self.points.dt.value = (1 - rule.alpha_f) * step.dt
        self.bodies.begin(step.dt)
        here = self.activate(step)
        self._load_at(step, 0.0)
        motion.to_grid(here, self.form, step.dt, self._rates(here, step))
        self._load_at(step, 1 - rule.alpha_f)
        if rule.alpha_f and here.driven:
            bases = [field.basis for field in here.fields]
            level = self._held.at(bases, (1 - rule.alpha_f) * step.share)[1]
            here = replace(here, prescribed=level)
        self._free(step)
        share, free = motion.reserve.share, (1 - rule.alpha_f) * step.dt
        known = [rule.known(one.V, one.A, step.dt) for one in motion.nodes]
        expected = [share[one.k] * free * one.V for one in motion.nodes]
        dashpots, factor = motion.dashpots(here, step.dt), rule.factor(step.dt)
        self.points.inertia.value = factor
        for field in self.form.parts.carried:
            if isinstance(field, StartAcceleration):
                for one, own in zip(motion.nodes, known):
                    rows = rows_within(self.points, one.tags)
                    found = collect(here.fields[one.k].stencils, own)
                    self.points[field.name][rows] = found[rows]
        masses = [one.mass for one in motion.nodes]
        return InertialOperator(self.form, here, masses, factor, known, expected, dashpots)

    def _free(self, step: Step) -> None:
        """Begin the step of the free rigid bodies, at the level where forces balance."""
        rule, dt = self.motion.rule, step.dt
        for body in self.bodies.free:
            assert body.freedom is not None
            none = np.zeros(body.freedom.increment.size)
            body.freedom.begin(body.start, none, body.time, self.motion.jumped)
        if isinstance(self.solver, Bordered) and isinstance(self.solver.border, FreeBodies):
            self.solver.border.inertial = Inertial(
                rule.factor(dt), lambda V, A: rule.known(V, A, dt), 1.0 - rule.alpha_f,
                weight=self._means.weight,
            )  # fmt: skip

    def _rates(self, here: Activation, step: Step) -> list[Array]:
        """Velocities of held components at the start of a step (m/s), each field's. Collective.

        Those prescribed there, and increments over the step's length.
        """
        if not any(condition.velocity for condition in self.bcs):
            return [np.asarray(g / step.dt, np.float64) for g in here.prescribed]
        bases, scale = [field.basis for field in here.fields], step.dt / step.share
        set_velocities(self.bcs, lambda v: v(step.t - step.dt) * scale)
        values = self._held.at(bases, step.share)[1]
        set_velocities(self.bcs, lambda v: mean_increment(v, step))
        return [np.asarray(g / step.dt, np.float64) for g in values]

    def _count(self, work: float) -> None:
        self.ledger.work.external += work

    def _advance(
        self, operator: Operator, x: Array, step: Step, kept: dict[str, Array] | None = None
    ) -> NewState | str:
        motion = self.motion
        # forces balance at a level within the step, the state is that at its end
        scale = 1.0 / (1.0 - motion.rule.alpha_f)
        self.bodies.put(1.0)
        kept = {}
        for update in self._updates if scale != 1.0 else ():
            if update.carried:
                update.run(operator.points, kept)
        if scale != 1.0:
            operator.move(x, scale)
        state = super()._advance(operator, x, step, kept)
        if isinstance(state, str):
            return state
        self._load_at(step, 0.5)
        parts = step.share >= 2 * 0.5**self.max_halvings
        reason = motion.to_points(operator, state, step, x, scale, parts and step.share > LEAST)
        if reason is None:
            self._move_free(operator, step.dt)
        self._load_at(step, 1.0)
        return state if reason is None else reason

    def regrid(self) -> None:
        """Forget what belongs to where the grid's lines were; see `regrid`."""
        super().regrid()
        self.motion.regrid()

    @property
    def _means(self) -> Means:
        assert self.form.means is not None
        return self.form.means

    def _move_free(self, operator: Operator, dt: float) -> None:
        """Give the free rigid bodies their velocities at the end of a step. Collective."""
        rule = self.motion.rule
        for body in self.bodies.free:
            free = body.freedom
            assert free is not None
            V, A = free.velocity, free.acceleration
            assert A is not None
            A_end = rule.acceleration(free.increment, V, A, dt)
            own = free.free
            pushed = np.zeros_like(A)
            totals = [c.totals() for c in operator.contacts if c.contact.body is body]
            force = sum((np.concatenate(both) for both in totals), np.zeros_like(A))
            M = free.inertia(body.start)[np.ix_(own, own)]
            pushed[own] = np.linalg.solve(M, force[own])
            V_end, A_end = rule.pushed(rule.velocity(V, A, A_end, dt), A_end, pushed, dt)
            free.velocity[own] = V_end[own]
            free.acceleration = np.zeros_like(A)
            free.acceleration[own] = A_end[own]

    def _memory(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        state, local, cells = super()._memory()
        change = np.array(self._loads.change)
        own = {**self.motion.memory(), **self.ledger.memory(), "change of loads": change}
        return {**state, **own}, local, cells

    def _remember(self, state, local, cells) -> None:
        super()._remember(state, local, cells)
        self.motion.remember(state)
        self.ledger.remember(state)
        self._loads.change = state["change of loads"].tolist()

    def _description(self) -> dict[str, str]:
        rule = f"{self.motion.rule}, {self.motion.terms.kind} mass"
        return {**super()._description(), "steps": rule}

    def _problem(self) -> dict[str, Any]:
        return {**super()._problem(), "mapping": repr(self.motion.mapping)}


class Newmark(TimeStepping):
    """A weak form in time, by Newmark's rule; the trapezoidal one by default.

    The form is that of the quasi-static problem: internal forces less loads. What it moves
    has mass, the points' `density`, and the points carry `velocity` (m/s) and `acceleration`
    (m/s²), which may be set before the first step. All else is as with `QuasiStatic`.

    The first step begins with the acceleration that the loads give the body, M a₀ = f, and so
    does every step at whose start a load jumps: free fall is exact from the first step.

    Args:
        form, increment, points, bcs, options: See `QuasiStatic`. The first field moves the points.
        beta, gamma: β and γ.
        mass: "consistent" or "lumped".
        mapping: How velocities go to the grid and come back: a `Mapping` or the name of one.
            By default "pic" with a consistent mass, which is then a projection and damps
            nothing, and "accel" with a lumped one.
        ghost_mass: γ_M of a ghost penalty of the consistent mass, in units of the largest density:
            Coombs (2023) has 1/4. By default there is none. Nodes that the points hardly support
            are tied to well-filled cells instead, as "aggregation" ties them, whatever the
            stabilisation; and the ghost penalty of `stabilisation="ghost"` acts on what a step
            changes of the velocity, on u − Δt v, not on u, and gives back no more energy than it
            has taken (`dolfinmpm.dynamics.reserve`). So neither takes energy from the body.
            A penalty of the mass takes some in every step, the more the smaller the steps. With a
            `prolongation`, contact, and beside weak aggregation, the default is 1/4, and on
            quadratic and cubic splines 100 and 10⁴ times that. With 0 nodes with small shares of
            points make the mass singular.
        error: Largest error of a step's displacement, as a share of the largest displacement of a
            step so far; a step that exceeds it is halved. None for no bound.
        time: DOLFINx constant that holds the time (s), for forms that depend on it.

    Attributes:
        history: One record per step.
        motion: What the grid's motion was in the last step.

    Raises:
        ParameterError: An argument is not what it may be.
    """

    @together
    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        beta: float = 0.25,
        gamma: float = 0.5,
        **options: Any,
    ):
        if number("gamma", gamma) < 0.5:
            raise ParameterError(
                f"gamma = {gamma:g} must be at least 0.5: with less every vibration grows from "
                "step to step, however short they are"
            )
        rule = Rule(number("beta", beta, 0.0), float(gamma))
        super().__init__(rule, form, increment, points, bcs, **options)


class GeneralisedAlpha(TimeStepping):
    """A weak form in time, by the generalised-α method: second order, with damping.

    Args:
        form, increment, points, bcs, options: See `Newmark`, also for what options there are.
        rho_inf: ρ∞ in [0, 1], the share of the highest frequencies' amplitudes that a step keeps;
            1 is the midpoint rule, which keeps all.

    Raises:
        ParameterError: An argument is not what it may be.
        FormError: The form carries fields from the end of a step to that of the next, and does not
            know of the level within a step where forces balance; `poromechanics` is told it by its
            own rho_inf.
    """

    @together
    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        rho_inf: float = 0.8,
        **options: Any,
    ):
        r = number("rho_inf", rho_inf, 0.0, 1.0, closed=True)
        alpha_m, alpha_f = (2 * r - 1) / (r + 1), r / (r + 1)
        beta, gamma = 0.25 * (1 - alpha_m + alpha_f) ** 2, 0.5 - alpha_m + alpha_f
        rule = Rule(beta, gamma, alpha_m, alpha_f)
        super().__init__(rule, form, increment, points, bcs, **options)
