"""Explicit steps in time: how many and how long, what drives them and what ends them.

A step itself is that of `dolfinmpm.dynamics.general`, or of the loops of
`dolfinmpm.dynamics.fused` where these know the form.
"""

from __future__ import annotations

import math
import os
import time as clock
from collections.abc import Sequence, Set
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms.analysis import extract_constants

from dolfinmpm._platform import garbage, stages
from dolfinmpm._platform.checks import check_kind, choice, truth
from dolfinmpm._platform.errors import FormError, InstabilityError, ParameterError, raise_together
from dolfinmpm._platform.together import together
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.loadbalance import balance, imbalance
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.participants import Activation
from dolfinmpm.dynamics.boundaryforces import Stiffness, check_boundaries, weighed
from dolfinmpm.dynamics.callmemory import CallMemory
from dolfinmpm.dynamics.clock import MotionRecord, Time, as_yielded, check_clock, end_of
from dolfinmpm.dynamics.colliding import Colliding, why_it_does_not_collide
from dolfinmpm.dynamics.collision import Collision
from dolfinmpm.dynamics.critical import critical_step, exact_step
from dolfinmpm.dynamics.energies import angular_momentum, momentum_of
from dolfinmpm.dynamics.energybalance import EnergyBalance
from dolfinmpm.dynamics.faces import Sides, divided, set_velocities
from dolfinmpm.dynamics.fusable import FusedLoads, Laws, why_not
from dolfinmpm.dynamics.fused import Fused
from dolfinmpm.dynamics.fusedcontact import RigidContacts
from dolfinmpm.dynamics.general import General
from dolfinmpm.dynamics.ledger import Energies, Ledger
from dolfinmpm.dynamics.mappings import Mapping
from dolfinmpm.dynamics.mass import KINDS, MassTerms, mass_terms
from dolfinmpm.dynamics.settings import Settings, checked_courant
from dolfinmpm.dynamics.snapshot import Snapshot
from dolfinmpm.solve.agreement import of_step
from dolfinmpm.solve.arguments import increments_of
from dolfinmpm.solve.bodyfields import refuse_bodies
from dolfinmpm.solve.freebodies import check_masses
from dolfinmpm.solve.loads import check_loads
from dolfinmpm.solve.problem import Problem
from dolfinmpm.solve.step import Step

__all__ = ["Explicit"]

Array = npt.NDArray[np.float64]

# Steps after which the critical step is found anew, and the energies are looked at
_EVERY = 20
# Steps after which the state is kept, to go back to: a copy costs about as much as one step
_KEEP = 100
# Fields that kinetic energy and work follow from, and those that no speed of a wave does
_KINETIC = frozenset(("velocity", "density", "V0", "F"))
_BESIDE = frozenset(("x", "cell", "V", "l", "stress", "acceleration"))


class Explicit(Problem):
    """A weak form in time, by explicit steps: no tangent, no Newton iteration, no factorisation.

    The form is that of the quasi-static problem, internal forces less loads; what it moves has
    mass, the points' `density`. The points carry `velocity` (m/s) and `acceleration` (m/s²).

    Velocities are half a step behind positions, and forces at a time change them over half of the
    step before and half of that after: steps may change their length. `energies()` has the kinetic
    energy at the time of the positions.

    `step(t)` goes to a time in as many steps as stability asks for; in a loop over
    `times(end, dt="auto")` each call takes twenty fused ones, or one where they are not. A run
    that turns out unstable ends with an `InstabilityError` and goes back to the beginning of the
    call of `step`, or to one of each hundred steps since at which no energy had come from nowhere:
    `time` tells which.

    Args:
        form, increment, points, bcs, updates, stabilisation, prolongation: See `QuasiStatic`.
            Penalties on the increment do nothing here: explicit steps take no tangent. Weak
            conditions act with what they have kept until a step, and their stiffness counts in
            `critical_step`: "penalty" with a beta of some 10 costs a half of a step. What they
            prescribe changes by the constant `time`, or from call to call.
        scheme: "musl", "usl" or "usf".
        mapping: How velocities go to the grid and come back; "flip" by default.
        mass: "lumped", or "consistent" with conjugate gradients in each step.
        ghost_mass: See `Newmark`.
        courant: Share of the critical step that is taken, at most 1; math.inf takes the steps that
            `step` is asked for as they are.
        damping: Share α of local damping, −α |f| sign v (Cundall 1987).
        mass_scaling: Factor of the mass in the inertia, not in loads: steps grow by its root.
        bulk_viscosity: Linear and quadratic coefficients of the pressure ρ h (b₁ c |ε̇| + b₂² h ε̇²)
            against fast compression (von Neumann & Richtmyer 1950), about (0.06, 1.2).
        mass_cutoff: Nodes of less than this share of the largest mass stand still (Sulsky,
            Zhou & Schreyer 1995).
        redistribution: Nodes of less than this share of the largest mass hand that part of
            their forces that their mass lacks to their neighbours (Ma, Zhang & Qiu 2010).
        time: DOLFINx constant that holds the time (s), for forms that depend on it.
        fused: Whether one loop may do a step of a form that it knows: laws of one measure of
            strain, loads, contact with rigid bodies, lumped mass, a rectangular grid in two or
            three dimensions, "flip", "pic", "apic" or "tpic"; F-bar in two dimensions. `unfused`
            says why it does not.
        collision: Bodies that touch each other at the nodes, see `Collision`; without, all points
            move in one field of velocities, which cannot slide nor part.

    Attributes:
        history: One record a call of `step`.
        time: Time that the state is of (s).

    Raises:
        ParameterError: An argument is not what it may be.
    """

    history: list[MotionRecord]  # type: ignore[assignment]
    _of_step = MotionRecord
    _in_time = True

    # `time` is that of the state
    _live = frozenset({"courant", "time"})

    @together
    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        scheme: str = "musl",
        mapping: Mapping | str | None = None,
        mass: str = "lumped",
        ghost_mass: float | None = None,
        courant: float = 0.8,
        damping: float = 0.0,
        mass_scaling: float = 1.0,
        bulk_viscosity: tuple[float, float] = (0.0, 0.0),
        mass_cutoff: float = 0.0,
        redistribution: float = 0.0,
        time: fem.Constant | None = None,
        fused: bool = True,
        collision: Collision | None = None,
        **options: Any,
    ):
        mass = choice("mass", mass, KINDS)
        u = increments_of(increment, points)
        settings = Settings.of(
            scheme, mapping, u[0]._dolfinmpm_space.basis, mass, damping, mass_scaling,
            bulk_viscosity, mass_cutoff, redistribution, time,
        )  # fmt: skip
        self.courant = checked_courant(courant)
        if len(u) > 1 or u[0].ufl_shape != (points.gdim,):
            raise ParameterError(
                "explicit steps move one field, a displacement of as many components as space has "
                "dimensions; bodies collide in it with collision=mpm.Collision(tags)"
            )
        check_clock(time, points.grid)
        settings.mapping.add_fields(points)
        conditions, faces = divided(bcs)
        super().__init__(form, increment, points, conditions, **options)
        refuse_bodies(self.fields, "Explicit", "bodies collide with collision=mpm.Collision(tags)")
        check_boundaries(self.form, mass)
        if points.dt in extract_constants(form):
            raise FormError(
                "the form has rates over points.dt, and increments are 0 where explicit steps find "
                "their forces; take Newmark or Transient, or bulk_viscosity and damping"
            )
        check_masses(self.bodies)
        self.form.inertia = mass_terms(self.form, self.fields, mass, ghost_mass)
        self.settings, self.time = settings, 0.0
        ledger = Ledger(points, self.form, settings.scaling, by_points=True)
        self.balance = EnergyBalance(ledger)
        markers = [of.boundary.markers for of in self.form.boundaries]
        self._between = CallMemory(Snapshot(points, self.bodies, markers))
        sides = Sides(faces, points, self.bcs)
        self._loop: Colliding | Fused | General
        if collision is not None:
            check_kind("collision", collision, Collision, "give mpm.Collision(tags=(1, 2))")
            raise_together(points.comm, why_it_does_not_collide(self, mass, settings))
            self._loop = Colliding(self, self._held, self._updates, settings, sides, collision)
            return
        found = self._fused(sides, options) if truth("fused", fused) else "it was not to be"
        if isinstance(found, str):
            self._loop = General(self, self._held, self._updates, settings, sides, found)
        else:
            self._loop = found

    @property
    def unfused(self) -> str:
        """Why steps are not fused, or an empty string."""
        return self._loop.instead

    @property
    def collision_force(self) -> Array:
        """What other bodies did to the first of a `Collision` in the last step (N), shape (d,)."""
        if not isinstance(self._loop, Colliding):
            return np.zeros(self.points.gdim)
        return self._loop.force

    @property
    def ledger(self) -> Ledger:
        """Where energy comes from and goes to."""
        return self.balance.ledger

    @property
    def terms(self) -> MassTerms:
        """What the mass is made of."""
        assert isinstance(self.form.inertia, MassTerms)
        return self.form.inertia

    @property
    def mapping(self) -> Mapping:
        """How velocities go to the grid and come back."""
        return self.settings.mapping

    def _scheme(self) -> list[str]:
        own = self.settings
        loops = "general loops" if self.unfused else "fused loops"
        return [
            f'scheme: explicit, order "{own.scheme}", {self.terms.kind} mass, velocity mapping: '
            f"{own.mapping.kind}; {loops}"
        ]

    def _fused(self, sides: Sides, options: dict[str, Any]) -> Fused | str:
        """The fused loops, or why there are none."""
        basis, stabilisation = self.fields[0].space.basis, self.fields[0].stabilisation
        settings = self.settings
        if not isinstance(basis, LatticeBasis):
            return "the grid is not rectangular"
        if self.terms.kind != "lumped":
            return "the mass is consistent"
        if not settings.plain:
            return "bulk viscosity or filters of light nodes act"
        domains = self.fields[0].space.domains
        if self._held.follows:
            return "conditions whose place follows something"
        if stabilisation.ties_nodes or options.get("prolongation") or options.get("updates"):
            return "nodes are tied, or fields updated"
        if settings.mapping.kind not in ("flip", "pic", "apic", "tpic"):
            return "the mapping filters velocities at the nodes"
        reason = why_not(self.form)
        if reason is not None:
            return reason
        loads = FusedLoads(self.form)
        if not loads.known or loads.varies:
            return "loads that depend on functions of the grid or on what moves"
        laws = Laws(self.points, self.form.parts.declarations)
        contacts, rigid = self.form.parts.contacts, None
        if contacts:
            rigid = RigidContacts(contacts, self.bodies, self.points)
        return Fused(self.points, basis, self._held, laws, loads, settings, sides, domains, rigid)

    @together
    def energies(self) -> Energies:
        """Energies of the body now, and work done since the first step. Collective.

        The kinetic energy is that at the time of the positions, half a step after the velocities.
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
        spins = self.mapping.kind == "apic"
        return angular_momentum(self.points, self.points["velocity_moment"] if spins else None)

    @together
    def critical_step(self, exact: bool = False) -> float:
        """The longest step that is stable (s). Collective.

        Args:
            exact: Whether it is that of the eigenproblem K x = λ M x of the present state,
                2/√λ_max, for which the tangent is compiled; else it is by wave speed and grid.
        """
        scaling = self.settings.scaling
        if truth("exact", exact):
            here = self.activate()
            if self.form.boundaries:
                here, _ = weighed(self.form, here)
            return exact_step(self.form, self.terms, here, scaling)
        self.form.bind()
        field, declarations = self.fields[0], self.form.parts.declarations
        tied = (
            field.stabilisation.kind in ("aggregation", "extended") or field.prolongate is not None
        )
        found = critical_step(self.points, field.space.basis, declarations, self.terms.kind, tied)
        # a corner in contact is a spring on a light node
        springs = sum(contact.rate() for contact in self.form.parts.contacts)
        held = self._loop.held() if isinstance(self._loop, General) else Stiffness()
        rate = (1.0 + held.share) / found**2 + 0.25 * (springs + held.rate)
        return math.sqrt(scaling / rate)

    def _set_penalties(self, here: Activation) -> None:
        fields = tuple(replace(field, penalty=None) for field in here.fields)
        self.form.set_penalties(replace(here, grid=[], soft=[], fields=fields), ghost=False)

    @together(given=of_step)
    def step(self, t: float | None = None) -> MotionRecord:
        """Go to a time. Collective.

        Args:
            t: The time (s), later than `time`; or one of `times(end, dt="auto")`, for the steps
                that are taken at once: fused ones as it says, or one.

        Raises:
            ParameterError: The time is not later.
            InstabilityError: The state is not finite, or energy comes from nowhere; it is then
                that of `time` again.
            PointsOutsideGridError: Points would leave the grid.
        """
        started, watch = clock.perf_counter(), stages.Watch()
        most, t = math.inf, as_yielded(t, self.time)
        if isinstance(t, Time) and t.open:
            most = min(self._loop.at_once, t.at_once)
        target = t.end if isinstance(t, Time) else end_of(t, self.time, None)
        if not target > self.time:
            raise ParameterError(
                f"t = {target:g} s must be later than the time of the state, {self.time:g} s"
            )
        record, between = MotionRecord(), self._between
        check_loads(self._loads.items, self.form.given, self.bcs, self.comm)
        self._begin()
        whole = target - self.time
        touched = self._touched()
        if touched:
            raise_together(self.comm, self.points.fault())
        record.migrated += balance(self.points)
        if touched & _KINETIC or not self.ledger.started:
            self.ledger.begin()
        self._loop.start(1.0 / whole, touched)
        between.state.time = math.nan
        if not (between.single and touched <= _BESIDE and self._loop.keeps_speed):
            between.since = _EVERY
        while self.time < target:
            if record.parts % _EVERY == 0:
                if record.parts:
                    touched = frozenset()
                garbage.free(self.comm)
                if record.parts or touched & _KINETIC:
                    self._check_energy(record.dt, begins=record.parts == 0)
                if record.parts % _KEEP == 0:
                    between.state.take(self.time, self.ledger.work, touched)
            if between.since >= _EVERY or self.form.boundaries:
                # what comes to a wall is held from then on
                between.critical, between.since = self.critical_step(), 0
            longest = self.courant * between.critical
            left = target - self.time
            count = max(1, math.ceil(left / longest * (1 - 1e-12)))
            dt = left / count
            now = int(min(count, self._loop.at_once, most - record.parts))
            self._check_speeds(dt)
            now = self.bodies.followed(dt, now)
            more = now < min(count, most - record.parts)
            self._advance(now, dt, whole, more, record)
            between.since += now
            if abs(self.time - target) <= 1e-9 * dt:
                # rounding must not add a step
                self.time = target
            if record.parts >= most:
                break
        self._loads.release()
        self._check_energy(record.dt)
        record.time = self.time
        record.unknowns = self.here.unknowns.total if self.here is not None else 0
        record.imbalance = imbalance(self.points)
        record.bodies = self.bodies.record()
        self._loop.release()
        between.moment, between.single = self.points.fields.moment(), record.parts == 1
        record.seconds, record.stages = clock.perf_counter() - started, watch.stop()
        self.history.append(record)
        if isinstance(t, Time):
            t.reached = self.time
        return record

    def _touched(self) -> Set[str]:
        """Fields that may have been changed since the last call, on any rank. Collective."""
        fields, comm = self.points.fields, self.comm
        between = self._between
        touched, between.moment = fields.touched(between.moment), None
        if comm.size == 1:
            return touched
        names = sorted(fields)
        flags = np.array([name in touched for name in names], np.uint8)
        comm.Allreduce(MPI.IN_PLACE, flags, op=MPI.MAX)
        return {name for name, flag in zip(names, flags) if flag}

    def _advance(
        self, count: int, dt: float, whole: float, more: bool, record: MotionRecord
    ) -> None:
        """Equal steps, a part of a call that goes so far (s). Collective."""
        start = self.time

        def begin(k: int) -> Step:
            end = start + (k + 1) * dt
            set_velocities(self.bcs, lambda v: v(end) * whole)
            if self.settings.clock is not None:
                self.settings.clock.value = start + k * dt
            return Step(end, dt, dt / whole)

        work = self.ledger.work
        # velocities are half of the last step behind
        kick = 0.5 * (work.length + dt) if work.length else dt
        taken, migrated, reason = self._loop.run(count, dt, kick, more, begin)
        work.add(self._loop.work())
        work.length = dt
        record.parts, record.migrated = record.parts + taken, record.migrated + migrated
        self.time, record.dt = start + taken * dt, dt
        if reason is not None:
            raise self._unstable(reason, dt)

    def _check_speeds(self, dt: float) -> None:
        """Raise where steps of that length (s) do not follow a rigid body. Collective."""
        fault = self.bodies.fault(dt)
        stabilisation = "give a smaller velocity, or a smaller courant number"
        raise_together(
            self.comm, None if fault is None else ParameterError(f"{fault}; {stabilisation}")
        )
        # all ranks know alike where forces have driven the free ones
        fault = self.bodies.fault(dt, inertia=True) if self.bodies.free else None
        if fault is not None:
            raise self._unstable(fault, dt)

    def _check_energy(self, dt: float, begins: bool = False) -> None:
        """Raise InstabilityError if energy comes from nowhere. Collective."""
        reason = self.balance.fault(begins)
        if reason is not None:
            raise self._unstable(reason, dt)

    def _unstable(self, reason: str, dt: float) -> InstabilityError:
        """What is known of a step that ended in no state; goes back to one. Collective."""
        points = self.points
        speed = np.linalg.norm(points["velocity"], axis=1)
        worst = None
        if len(points):
            p = int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
            worst = (float(speed[p]), int(points["id"][p]), points["x"][p].tolist())
        found = [w for w in self.comm.allgather(worst) if w is not None]
        fastest = max(found)
        energies = self.energies()
        at, longest = self.time, self.critical_step()
        self._go_back()
        return InstabilityError(
            f"explicit step at t = {at:.6g} s: {reason}. The step is {dt:.3g} s, the "
            f"critical one {longest:.3g} s; the fastest point is {fastest[1]} at "
            f"{fastest[2]} m with {fastest[0]:.3g} m/s; energies (J): kinetic "
            f"{energies.kinetic:.4g}, strain {energies.strain:.4g}, external work "
            f"{energies.external:.4g}. The state is that at t = {self.time:.6g} s: take a smaller "
            "courant number, a mapping that damps, or aggregation where cuts are small"
        )

    def _go_back(self) -> None:
        """To the last state that was kept. Collective."""
        self.bodies.reset()
        if math.isnan(self._between.state.time):
            # nothing has moved yet
            return
        self._between.state.put(self.ledger.work)
        self.ledger.end()
        self.balance.forget()
        self.time = self._between.state.time

    @together
    def save(self, path: str | os.PathLike[str]) -> None:
        """See `Problem.save`. Collective."""
        super().save(path)
        # what goes on from the file begins with points in order, and so does this run
        self._loop.renew()
        self._between.moment = None

    def _memory(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        state, local, cells = super()._memory()
        return {**state, "time": self.time, **self.ledger.memory()}, local, cells

    def _remember(self, state, local, cells) -> None:
        super()._remember(state, local, cells)
        self.time = state["time"]
        self.ledger.remember(state)

    def _description(self) -> dict[str, str]:
        own = self.settings
        steps = f"scheme = {own.scheme}, {self.terms.kind} mass, damping = {own.damping:g}"
        return {**super()._description(), "steps": f"{steps}, mass_scaling = {own.scaling:g}"}

    def _problem(self) -> dict[str, Any]:
        return {**super()._problem(), "mapping": repr(self.mapping)}
