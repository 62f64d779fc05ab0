"""Explicit steps in time: their number and length, their loads and their end.

`dolfinmpm.dynamics.general` takes a single step. The loops of `dolfinmpm.dynamics.fused` take it
where they support the form.
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

from dolfinmpm._platform.argumentchecks import check_kind, choice, truth
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Activation
from dolfinmpm.dynamics.boundaryforces import Stiffness, check_boundaries, weighed
from dolfinmpm.dynamics.clock import MotionRecord, check_clock
from dolfinmpm.dynamics.collision import Collision
from dolfinmpm.dynamics.collisionsteps import CollisionSteps, collision_error
from dolfinmpm.dynamics.critical import cell_sizes_at, critical_step, exact_step
from dolfinmpm.dynamics.energybounds import EnergyBalance
from dolfinmpm.dynamics.explicitbase import Settings, checked_courant
from dolfinmpm.dynamics.explicitcall import CallMemory, ExplicitCall, Snapshot
from dolfinmpm.dynamics.faces import ghost_mass_at, refuse_constraints, split_conditions
from dolfinmpm.dynamics.facesatnodes import Sides
from dolfinmpm.dynamics.fusable import why_not
from dolfinmpm.dynamics.fused import FusedSteps
from dolfinmpm.dynamics.general import GeneralSteps
from dolfinmpm.dynamics.kinks import Kinks
from dolfinmpm.dynamics.ledger import Ledger, MovingBody
from dolfinmpm.dynamics.mappings import Mapping
from dolfinmpm.dynamics.mass import KINDS, MassTerms, mass_terms
from dolfinmpm.dynamics.smallmass import BulkViscosity, check_filters
from dolfinmpm.forms.formchecks import check_explicit
from dolfinmpm.kinematics.footing import refuse_footings
from dolfinmpm.solve.agreement import of_step
from dolfinmpm.solve.arguments import as_read, increments_of
from dolfinmpm.solve.freebodies import check_masses
from dolfinmpm.solve.problem import Problem
from dolfinmpm.solve.problemchecks import refuse_field_tags
from dolfinmpm.solve.scheme import Scheme

__all__ = ["Explicit"]

Array = npt.NDArray[np.float64]


class Explicit(MovingBody, Problem):
    """A weak form in time, by explicit steps: no tangent, no Newton iteration, no factorisation.

    The form is that of the quasi-static problem: internal forces less loads. The mass comes from
    the points' `density`. The points carry `velocity` (m/s) and `acceleration` (m/s²).

    Velocities are half a step behind positions. A force changes the velocities over half of the
    step before and half of the step after. So steps may change their length. The first step has no
    step before: velocities that are given are those at the start. Velocities that are set later
    are those in the middle of the last step, half a step before the positions, as all velocities
    that the points have then: the next step changes them by forces over half of both steps.
    Prescribed velocities are those in the middle of a step. `energies()` gives the kinetic energy
    at the time of the positions. Velocities at this time are, to second order,
    `points["velocity"] + 0.5 * record.dt * points["acceleration"]` with the record of `step`.

    `step(t)` goes to the time t in as many steps as stability requires. In a loop over
    `times(end, dt="auto")` each call takes twenty fused steps, or one step that is not fused.

    An unstable run ends with an `InstabilityError`. The state then goes back to the start of the
    call of `step`, or to a later state. Such a state is kept every hundred steps, after a check
    of the energy balance. `time` is then the time of the restored state.

    Args:
        form, increment, points, bcs, updates, stabilisation, prolongation: See `QuasiStatic`.
            Penalties on the increment do nothing here, because explicit steps use no tangent.
            Weak conditions act with their state before the step. Their stiffness counts in
            `critical_step`: "penalty" with a penalty of some 10 halves the step. Their prescribed
            values change by the constant `time`, or from call to call.
        scheme: "musl", "usl" or "usf". In "usf" stress and strain are those at the start of the
            last step. "usl" loses energy at any length of the steps.
        mapping: The velocity mapping between points and grid; "flip" by default.
        mass: "lumped", or "consistent" with conjugate gradients in each step.
        ghost_mass: See `Newmark`; by default as with a `prolongation` there, with aggregation 0.
        courant: Length of a step as a share of the critical step, at most 1. With math.inf,
            `step` takes one step to the given time without this bound.
        damping: Factor α of local damping, −α |f| sign v (Cundall 1987).
        mass_scaling: Factor of the mass in the inertia, not in the loads. Steps grow by the square
            root of the factor.
        bulk_viscosity: Linear and quadratic coefficients of the pressure ρ h (b₁ c |ε̇| + b₂² h ε̇²)
            against fast compression (von Neumann & Richtmyer 1950), about (0.06, 1.2). They
            shorten `critical_step`.
        mass_cutoff: Nodes with less than this share of the largest mass stand still (Sulsky,
            Zhou & Schreyer 1995). Their forces are lost, and momentum with them: some 0.5 % to 4 %
            in runs of "musl". In "usl" and "usf" they also strain what moves, and a share of 0.01
            took 38 %. Larger shares give a LostMomentumWarning. `redistribution` keeps momentum.
        redistribution: Nodes with less than this share of the largest mass pass a part of their
            forces to their neighbours. This part is the share of mass that they lack (Ma, Giguere,
            Jayaraman & Zhang 2010).
        time: DOLFINx constant that holds the time (s), for forms that depend on the time.
        fused: Whether one compiled loop may take a whole step, where it supports the form. It
            supports laws of one strain formulation, body forces, contact with rigid bodies, lumped
            mass, rectangular grids in 2D and 3D, "flip", "pic", "apic" and "tpic", and F-bar of
            one law. `unfused` gives the reason if the loop is not used.
        collision: Bodies that touch each other at the nodes, see `Collision`. Without it all
            points move in one velocity field. Then bodies neither slide nor separate.

    Attributes:
        history: One record per call of `step`.
        time: Time of the present state (s).

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.

    A free body keeps its momentum:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> problem = mpm.Explicit(F, V.increment, points)
    >>> points["velocity"] = (1.0, 0.0)
    >>> record = problem.step(0.1)
    >>> problem.momentum()[0].round(6).item(), problem.critical_step() < 0.1
    (16000.0, True)
    """

    history: list[MotionRecord]  # type: ignore[assignment]
    scheme: Marching

    # `time` is the time of the state
    _live = frozenset({"courant", "time"})

    @collective
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
                "explicit steps move one field, a displacement with one component per dimension of "
                "space; bodies collide in this field with collision=mpm.Collision(tags)"
            )
        check_clock(time, points.grid)
        settings.mapping.add_fields(points)
        conditions, faces = split_conditions(bcs)
        super().__init__(form, increment, points, conditions, scheme=Marching(self), **options)
        self.essential_conditions.read = as_read(bcs)
        refuse_field_tags(
            self.fields, "Explicit", "bodies collide with collision=mpm.Collision(tags)"
        )
        check_boundaries(self.form, mass)
        check_filters(u[0]._dolfinmpm_space, settings.filters, collision)
        check_explicit(form, u[0], points)
        refuse_footings(form)
        check_masses(self.bodies)
        refuse_constraints(faces, self.fields)
        ghost_mass = ghost_mass_at(faces, u[0]._dolfinmpm_space, mass, ghost_mass)
        terms = mass_terms(self.form, self.fields, mass, ghost_mass)
        self.form.add(terms)
        self.form.start_in_time(None)
        self.form.contact_mode = None, settings.scheme != "usf"  # there other velocities work
        self.scheme.settings, self.scheme.terms, self.time = settings, terms, 0.0
        ledger = Ledger(points, self.form, self.bodies, settings.mass_scaling, by_points=True)
        self.balance = EnergyBalance(ledger)
        markers = [of.boundary.markers for of in self.form.boundaries]
        self._between = CallMemory(Snapshot(points, self.bodies, markers))
        sides = Sides(faces, points, self.bcs, options.get("prolongation"), self.form)
        self.scheme.waves = sides.waves
        self._loop: CollisionSteps | FusedSteps | GeneralSteps
        if collision is not None:
            check_kind("collision", collision, Collision, "give mpm.Collision(tags=(1, 2))")
            if sides.incoming:
                raise ParameterError(
                    "bodies that collide at the nodes take no waves through a side: leave out "
                    "collision= or incoming="
                )
            raise_together(points.comm, collision_error(self, mass, settings))
            self._loop = CollisionSteps(self, settings, sides, collision)
            return
        own = truth("fused", fused)
        reason = why_not(self, settings, sides, options) if own else "fused=False"
        if reason is not None:
            self._loop = GeneralSteps(self, settings, sides, reason)
        else:
            self._loop = FusedSteps(self, settings, sides)

    @property
    def unfused(self) -> str:
        """Why steps are not fused, or an empty string."""
        return self._loop.instead

    @property
    def collision_force(self) -> Array:
        """Force of the other bodies on the first body of a `Collision` (N), shape (d,).

        It is the mean over the last step.
        """
        if not isinstance(self._loop, CollisionSteps):
            return np.zeros(self.points.gdim)
        return self._loop.force

    def watch_kinks(self) -> Kinks | None:
        """Keep where the steps are not smooth from now on; None where they are.

        Fused steps cannot tell, so general steps take their place.
        """
        settings, collides = self.settings, isinstance(self._loop, CollisionSteps)
        resists = settings.damping or settings.viscosity != (0.0, 0.0)
        if not (collides or self._loop.sides.frictional or self.bodies.contacts or resists):
            return None
        if isinstance(self._loop, FusedSteps):
            why = "it is watched where steps are not smooth"
            self._loop = GeneralSteps(self, settings, self._loop.sides, why)
        self._loop.kinks = self._loop.kinks or Kinks()
        return self._loop.kinks

    @property
    def ledger(self) -> Ledger:
        """The account of energies and works."""
        return self.balance.ledger

    @property
    def settings(self) -> Settings:
        """The settings of the steps."""
        return self.scheme.settings

    @property
    def terms(self) -> MassTerms:
        """The terms of the mass."""
        return self.scheme.terms

    @property
    def mapping(self) -> Mapping:
        """The velocity mapping between points and grid."""
        return self.settings.mapping

    @collective
    def critical_step(self, exact: bool = False) -> float:
        """The longest stable step (s). Collective.

        The order "usl" and bulk viscosity shorten it, the quadratic one by that of the last step.
        So does contact with a free rigid body that is lighter than soil under it, also before it
        touches.

        Args:
            exact: True takes 2/√λ_max of the eigenproblem K x = λ M x in the present state. The
                tangent is then compiled. False gives an estimate by wave speed and grid.
        """
        mass_scaling, loop = self.settings.mass_scaling, self._loop
        if truth("exact", exact):
            here = self.activate()
            if self.form.boundaries:
                here, _ = weighed(self.form, here)
            return self._shortened(exact_step(self.form, self.terms, here, mass_scaling))
        self.form.bind()
        field, declarations = self.fields[0], self.form.parts.declarations
        tied = (
            field.stabilisation.kind in ("aggregation", "extended") or field.prolongate is not None
        )
        sizes = cell_sizes_at(self.points, field.space)
        tied = tied or sizes is not None
        found = critical_step(
            self.points, field.space.basis, declarations, self.terms.kind, tied, sizes
        )
        # a corner in contact acts as a spring on a node of small mass
        springs = sum(term.rate(mass_scaling) for term in self.form.terms)
        if self.terms.kind == "consistent":
            # functions of degree p move ρh/(p + 1)² at a face; `rate` counts with linear ones
            springs *= (0.5 * (field.space.basis.degree + 1)) ** 2
        boundaries = loop.boundary_stiffness() if isinstance(loop, GeneralSteps) else Stiffness()
        rate = (1.0 + boundaries.share) / found**2 + 0.25 * boundaries.rate
        return self._shortened(1.0 / math.sqrt(rate / mass_scaling + 0.25 * springs))

    def _shortened(self, longest: float) -> float:
        """The longest stable step (s), from 2/ω_max without bulk viscosity. Collective."""
        longest = self.settings.shorten(longest, self.terms.kind)
        return self.viscosity.shorten(longest) if self.viscosity is not None else longest

    @property
    def viscosity(self) -> BulkViscosity | None:
        """Bulk viscosity, or None without it. Fused steps have none."""
        return self._loop.viscosity if isinstance(self._loop, GeneralSteps) else None

    def _set_penalties(self, here: Activation) -> None:
        self.form.set_penalties(replace(here, blocks={}), ghost=False)

    @collective(compared=of_step)
    def step(self, t: float | None = None) -> MotionRecord:
        """Go to a time. Collective.

        Args:
            t: The time (s), later than `time`. A time of `times(end, dt="auto")` stands for
                several fused steps, as many as `times` says, or for one step that is not fused.

        Raises:
            ParameterError: The time is not later than `time`.
            InstabilityError: The state is not finite, or the energy balance shows a gain. The
                state is then an earlier one, at `time`.
            PointsOutsideGridError: Points would leave the grid.
        """
        return ExplicitCall(self, self._loop, self._between, t).run()

    @collective
    def save(self, path: str | os.PathLike[str]) -> None:
        """See `Problem.save`. Collective.

        The next step sorts the points by cells, as a restarted run does. So a run that saves and
        goes on has the bits of the restarted run. The last digits of a run that never saves differ.
        """
        super().save(path)
        # a run from the file begins with sorted points, so this run must do the same
        self._loop.renew()
        self._between.moment = None


class Marching(Scheme):
    """Scheme of explicit steps: their summary, and their state from step to step.

    Args:
        problem: The problem.

    Attributes:
        settings: The settings of the steps.
        terms: The terms of the mass.
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
        return {"steps": f"{steps}, mass_scaling = {own.mass_scaling:g}"}

    def identity(self) -> dict[str, Any]:
        """See `Scheme`."""
        return {"mapping": repr(self._problem.mapping)}

    def state(self) -> dict[str, Any]:
        """See `Scheme`."""
        found = {"time": self._problem.time, **self._problem.ledger.state()}
        viscosity = self._problem.viscosity
        return found if viscosity is None else found | {"compression": viscosity.compression}

    def set_state(self, values: StateOf[str, Any]) -> None:
        """See `Scheme`."""
        self._problem.time = values["time"]
        if self._problem.viscosity is not None:
            self._problem.viscosity.compression = values["compression"]
        self._problem.ledger.set_state(values)
