"""Implicit steps in time: Newmark's rule and the generalised-α method around a weak form.

A step solves f(w) + M a_α = 0 for the increment w at the time level at which forces balance. Here
f is the quasi-static form, and the rule gives the acceleration a_α for w. The mass M is that of
`dolfinmpm.dynamics.mass`. Newmark's rule (1959), with the increment u of the whole step, is

    a' = (u − Δt v) / (β Δt²) − (1/(2β) − 1) a,    v' = v + Δt ((1 − γ) a + γ a'),

The generalised-α method (Chung & Hulbert 1993, doi 10.1115/1.2900803) balances the forces at
w = (1 − α_f) u, under the loads at that time, with the acceleration (1 − α_m) a' + α_m a.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import choice, number
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import DoubtfulInputWarning, ParameterError, warn
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.clock import MotionRecord, check_clock
from dolfinmpm.dynamics.faces import (
    ghost_mass_at,
    refuse_constraints,
    split_conditions,
)
from dolfinmpm.dynamics.facesatnodes import Sides
from dolfinmpm.dynamics.gridmotion import GridMotion
from dolfinmpm.dynamics.inertia import NewmarkRule
from dolfinmpm.dynamics.ledger import Ledger, MovingBody
from dolfinmpm.dynamics.mappings import Mapping, mapping_of
from dolfinmpm.dynamics.mass import KINDS, MassTerms, mass_terms
from dolfinmpm.dynamics.timescheme import NewmarkScheme
from dolfinmpm.forms.formchecks import check_levels
from dolfinmpm.forms.weightchecks import warn_of_second_inertia
from dolfinmpm.solve.arguments import as_read, increments_of
from dolfinmpm.solve.freebodies import check_masses
from dolfinmpm.solve.problemchecks import refuse_field_tags
from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = ["GeneralisedAlpha", "Newmark", "TimeStepping"]


# β of the rule of Fox and Goodwin, less its rounding
_LEAST_BETA = 0.083


class TimeStepping(MovingBody, QuasiStatic):
    """A weak form in time, by a rule of Newmark's family; see `Newmark` for the arguments."""

    history: list[MotionRecord]  # type: ignore[assignment]
    scheme: NewmarkScheme
    _takes_scheme = False

    def __init__(
        self,
        rule: NewmarkRule,
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
                f"shape {u.ufl_shape}: the first increment moves the points"
            )
        if error is not None:
            number("error", error, 0.0)
        if u._dolfinmpm_space.configuration != "updated":
            raise ParameterError(
                'steps in time need Space(..., configuration="updated"), got "total": velocities '
                "are mapped where the points are now"
            )
        chosen.add_fields(points)
        conditions, faces = split_conditions(bcs)
        for face in faces:
            if face.friction is not None:
                raise ParameterError(
                    f"the frictional face at '{face.where}' is for explicit steps only; hold the "
                    "side with mpm.rollers or mpm.fixed, or take mpm.Explicit"
                )
        ghost_mass = ghost_mass_at(faces, u._dolfinmpm_space, mass, ghost_mass)
        ties = mass == "consistent" and ghost_mass is None
        own = rule.alpha_m == rule.alpha_f == 0.0
        rule = replace(rule, by_forces=ties and own)
        check_clock(time, points.grid)
        scheme = NewmarkScheme(rule, ties, error, time)
        super().__init__(form, increment, points, conditions, scheme=scheme, **options)
        warn_of_second_inertia(form, points, type(self).__name__)
        self.essential_conditions.read = as_read(bcs)
        check_levels(self.form.parts.carried, 1.0 - rule.alpha_f, type(self).__name__)
        if self.form.has_rates:
            # forces at the start of a step have no increments, and so neither rates nor the
            # acceleration: M a = f would leave out the inertia of the form's own terms
            scheme.rule = rule = replace(rule, by_forces=False)
        terms = mass_terms(self.form, self.fields, mass, ghost_mass, direct=True)
        refuse_constraints(faces, self.fields)
        if faces:
            refuse_field_tags(self.fields, "a face of the grid", "hold the sides with conditions")
        sides = Sides(faces, points, self.bcs, options.get("prolongation"), self.form)
        scheme.waves = sides.waves
        ledger = Ledger(points, self.form, self.bodies)
        scheme.motion = GridMotion(points, rule, chosen, terms, sides, ledger)
        check_masses(self.bodies)
        self.form.add(terms)
        self.form.start_in_time(scheme.mean_weights)

    @property
    def motion(self) -> GridMotion:
        """Motion of the grid's nodes in the last step."""
        return self.scheme.motion

    @property
    def mapping(self) -> Mapping:
        """The velocity mapping between points and grid."""
        return self.motion.mapping

    @property
    def terms(self) -> MassTerms:
        """The terms of the mass."""
        return self.motion.terms

    @property
    def ledger(self) -> Ledger:
        """The account of energies and works."""
        return self.motion.ledger

    @property
    def time(self) -> float:
        """Time of the present state (s)."""
        return self.scheme.clock.time


class Newmark(TimeStepping):
    """A weak form in time, by Newmark's rule; the trapezoidal rule by default.

    The form is that of the quasi-static problem: internal forces less loads. The mass comes from
    the points' `density`. The points carry `velocity` (m/s) and `acceleration` (m/s²). Both may
    be set before the first step. All else is as in `QuasiStatic`.

    The first step begins with the acceleration that follows from the loads, M a₀ = f. Every step
    with a jump of a load at its start does the same, and every step before which points came or
    went. So free fall is exact from the first step.

    Args:
        form, increment, points, bcs, options: See `QuasiStatic`. The first field moves the points.
        beta, gamma: β and γ. With β below γ/2 steps must be shorter than 1/√(γ/2 − β) over
            the highest angular frequency of the grid, or vibrations grow: see Hughes (2000), *The
            finite element method*, section 9.1.
        mass: "consistent" or "lumped".
        mapping: The velocity mapping between points and grid: a `Mapping` or its name. The
            default is "pic" with a consistent mass, and "accel" with a lumped mass. With a
            consistent mass "pic" is a projection and damps nothing.
        ghost_mass: γ_M of a ghost penalty of the consistent mass, in units of the largest density:
            Coombs (2023) has 1/4. By default there is no such penalty. Instead, nodes with little
            support by points are constrained to well-filled cells as by "aggregation", whatever
            the stabilisation. The ghost penalty of `stabilisation="ghost"` then acts on the
            step's change of velocity, u − Δt v, not on u. It gives back no more energy than it
            has taken (`dolfinmpm.dynamics.energybounds`). So neither takes energy from the body.
            A penalty of the mass takes energy in every step, and more with smaller steps. It acts
            from the next step on, with a `SingularMassWarning`, if the mass is found singular.
            With a `prolongation`, with contact and with weak aggregation the default is 1/4; on
            quadratic and cubic splines it is 100 and 10⁴ times 1/4; with `tied` sides it is 0.
            With 0, nodes with small shares of points make the mass singular.
        error: Largest error of a step's displacement, as a share of the largest displacement of a
            step so far. A step with a larger error is halved. None for no bound.
        time: DOLFINx constant that holds the time (s), for forms that depend on the time.

    Attributes:
        history: One record per step.
        motion: Motion of the grid's nodes in the last step.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.

    A free body keeps its velocity:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> problem = mpm.Newmark(F, V.increment, points)
    >>> points["velocity"] = (1.0, 0.0)
    >>> record = problem.step(0.1)
    >>> (points["x"] - points["x0"])[0, 0].round(9).item()
    0.1
    """

    @collective
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
                "step to step, even in short steps"
            )
        rule = NewmarkRule(number("beta", beta, 0.0), float(gamma))
        if rule.beta < _LEAST_BETA:
            warn(
                points.comm if isinstance(points, MaterialPoints) else MPI.COMM_WORLD,
                f"beta = {rule.beta:g} is below those of the usual rules, 1/12, 1/6 and 1/4: the "
                f"steps are stable only up to {1 / math.sqrt(rule.gamma / 2 - rule.beta):.3g} over "
                "the highest angular frequency of the grid; take beta=0.25",
                DoubtfulInputWarning,
            )
        super().__init__(rule, form, increment, points, bcs, **options)


class GeneralisedAlpha(TimeStepping):
    """A weak form in time, by the generalised-α method: second order, with damping.

    Args:
        form, increment, points, bcs, options: See `Newmark`.
        rho_inf: Spectral radius ρ∞ in [0, 1]: a step keeps this share of the amplitudes of the
            highest frequencies. 1 is the midpoint rule without damping.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.
        FormError: The form carries fields from the end of a step to the end of the next step,
            without the time level at which forces balance. `poromechanics` gets this level by its
            own rho_inf.

    A free body keeps its velocity:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> problem = mpm.GeneralisedAlpha(F, V.increment, points, rho_inf=0.9)
    >>> points["velocity"] = (1.0, 0.0)
    >>> record = problem.step(0.1)
    >>> points["velocity"][0, 0].round(9).item()
    1.0
    """

    @collective
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
        rule = NewmarkRule(beta, gamma, alpha_m, alpha_f)
        super().__init__(rule, form, increment, points, bcs, **options)
