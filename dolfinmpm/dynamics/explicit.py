"""Explicit steps in time: how many and how long, what drives them and what ends them.

A step itself is that of `dolfinmpm.dynamics.general`, or of the loops of
`dolfinmpm.dynamics.fused` where these know the form.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping as StateOf
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.algorithms.analysis import extract_constants

from dolfinmpm._platform.checks import check_kind, choice, truth
from dolfinmpm._platform.errors import FormError, ParameterError, raise_together
from dolfinmpm._platform.together import together
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.participants import Activation
from dolfinmpm.dynamics.boundaryforces import Stiffness, check_boundaries, weighed
from dolfinmpm.dynamics.clock import MotionRecord, check_clock
from dolfinmpm.dynamics.colliding import Colliding, why_it_does_not_collide
from dolfinmpm.dynamics.collision import Collision
from dolfinmpm.dynamics.critical import critical_step, exact_step
from dolfinmpm.dynamics.energies import angular_momentum, momentum_of
from dolfinmpm.dynamics.energybalance import EnergyBalance
from dolfinmpm.dynamics.explicitcall import Call
from dolfinmpm.dynamics.faces import Sides, divided
from dolfinmpm.dynamics.fusable import FusedLoads, Laws, why_not
from dolfinmpm.dynamics.fused import Fused
from dolfinmpm.dynamics.fusedcontact import RigidContacts
from dolfinmpm.dynamics.general import General
from dolfinmpm.dynamics.ledger import Energies, Ledger
from dolfinmpm.dynamics.mappings import Mapping
from dolfinmpm.dynamics.mass import KINDS, MassTerms, mass_terms
from dolfinmpm.dynamics.settings import Settings, checked_courant
from dolfinmpm.dynamics.snapshot import CallMemory, Snapshot
from dolfinmpm.solve.agreement import of_step
from dolfinmpm.solve.arguments import increments_of
from dolfinmpm.solve.bodyfields import refuse_bodies
from dolfinmpm.solve.freebodies import check_masses
from dolfinmpm.solve.problem import Problem
from dolfinmpm.solve.scheme import Scheme

__all__ = ["Explicit"]

Array = npt.NDArray[np.float64]


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
            `critical_step`: "penalty" with a penalty of some 10 costs a half of a step. What they
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
    scheme: Marching

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
        super().__init__(form, increment, points, conditions, scheme=Marching(self), **options)
        refuse_bodies(self.fields, "Explicit", "bodies collide with collision=mpm.Collision(tags)")
        check_boundaries(self.form, mass)
        if points.dt in extract_constants(form):
            raise FormError(
                "the form has rates over points.dt, and increments are 0 where explicit steps find "
                "their forces; take Newmark or Transient, or bulk_viscosity and damping"
            )
        check_masses(self.bodies)
        terms = mass_terms(self.form, self.fields, mass, ghost_mass)
        self.form.add(terms)
        self.form.start_in_time(None)
        self.scheme.settings, self.scheme.terms, self.time = settings, terms, 0.0
        ledger = Ledger(points, self.form, self.bodies, settings.scaling, by_points=True)
        self.balance = EnergyBalance(ledger)
        markers = [of.boundary.markers for of in self.form.boundaries]
        self._between = CallMemory(Snapshot(points, self.bodies, markers))
        sides = Sides(faces, points, self.bcs)
        self._loop: Colliding | Fused | General
        if collision is not None:
            check_kind("collision", collision, Collision, "give mpm.Collision(tags=(1, 2))")
            raise_together(points.comm, why_it_does_not_collide(self, mass, settings))
            self._loop = Colliding(self, self.held, self.form.updates, settings, sides, collision)
            return
        found = self._fused(sides, options) if truth("fused", fused) else "it was not to be"
        if isinstance(found, str):
            self._loop = General(self, self.held, self.form.updates, settings, sides, found)
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
    def settings(self) -> Settings:
        """How steps are taken."""
        return self.scheme.settings

    @property
    def terms(self) -> MassTerms:
        """What the mass is made of."""
        return self.scheme.terms

    @property
    def mapping(self) -> Mapping:
        """How velocities go to the grid and come back."""
        return self.settings.mapping

    def _fused(self, sides: Sides, options: dict[str, Any]) -> Fused | str:
        """The fused loops, or why there are none."""
        form, field, settings = self.form, self.fields[0], self.settings
        reason = why_not(form, field, self.terms.kind, settings, self.held, options)
        if reason is not None:
            return reason
        laws, loads = Laws(self.points, form.parts.declarations), FusedLoads(form)
        contacts, rigid = self.bodies.contacts, None
        if contacts:
            rigid = RigidContacts(contacts, self.bodies, self.points)
        basis, domains = field.space.basis, field.space.domains
        assert isinstance(basis, LatticeBasis)
        return Fused(self.points, basis, self.held, laws, loads, settings, sides, domains, rigid)

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
        springs = sum(term.rate() for term in self.form.terms)
        held = self._loop.held() if isinstance(self._loop, General) else Stiffness()
        rate = (1.0 + held.share) / found**2 + 0.25 * (springs + held.rate)
        return math.sqrt(scaling / rate)

    def _set_penalties(self, here: Activation) -> None:
        self.form.set_penalties(replace(here, blocks={}), ghost=False)

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
        return Call(self, self._loop, self._between, t).run()

    @together
    def save(self, path: str | os.PathLike[str]) -> None:
        """See `Problem.save`. Collective."""
        super().save(path)
        # what goes on from the file begins with points in order, and so does this run
        self._loop.renew()
        self._between.moment = None


class Marching(Scheme):
    """What explicit steps keep, and say of themselves.

    Args:
        problem: The problem.

    Attributes:
        settings: How steps are taken.
        terms: What the mass is made of.
    """

    record = MotionRecord
    in_time = True
    settings: Settings
    terms: MassTerms

    def __init__(self, problem: Explicit):
        self._problem = problem

    def summary(self) -> list[str]:
        """See `Scheme`."""
        own, problem = self._problem.settings, self._problem
        loops = "general loops" if problem.unfused else "fused loops"
        return [
            f'scheme: explicit, order "{own.scheme}", {problem.terms.kind} mass, velocity mapping: '
            f"{own.mapping.kind}; {loops}"
        ]

    def description(self) -> dict[str, str]:
        """See `Scheme`."""
        own, kind = self._problem.settings, self._problem.terms.kind
        steps = f"scheme = {own.scheme}, {kind} mass, damping = {own.damping:g}"
        return {"steps": f"{steps}, mass_scaling = {own.scaling:g}"}

    def identity(self) -> dict[str, Any]:
        """See `Scheme`."""
        return {"mapping": repr(self._problem.mapping)}

    def state(self) -> dict[str, Any]:
        """See `Scheme`."""
        return {"time": self._problem.time, **self._problem.ledger.state()}

    def set_state(self, values: StateOf[str, Any]) -> None:
        """See `Scheme`."""
        self._problem.time = values["time"]
        self._problem.ledger.set_state(values)
