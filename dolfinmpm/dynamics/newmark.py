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
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.clock import MotionRecord, check_clock
from dolfinmpm.dynamics.energies import angular_momentum, momentum_of
from dolfinmpm.dynamics.faces import Sides, divided
from dolfinmpm.dynamics.ledger import Energies, Ledger
from dolfinmpm.dynamics.mappings import Mapping, mapping_of
from dolfinmpm.dynamics.mass import KINDS, MassTerms, mass_terms
from dolfinmpm.dynamics.motion import Motion
from dolfinmpm.dynamics.rule import Rule
from dolfinmpm.dynamics.timescheme import TimeScheme
from dolfinmpm.forms.formchecks import check_levels
from dolfinmpm.solve.arguments import increments_of
from dolfinmpm.solve.bodyfields import refuse_bodies
from dolfinmpm.solve.freebodies import check_masses
from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = ["GeneralisedAlpha", "Newmark", "TimeStepping"]

Array = npt.NDArray[np.float64]


class TimeStepping(QuasiStatic):
    """A weak form in time, by a rule of Newmark's family; see `Newmark` for the arguments."""

    history: list[MotionRecord]  # type: ignore[assignment]
    scheme: TimeScheme
    _takes_scheme = False

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
        ties = mass == "consistent" and ghost_mass is None
        own = rule.alpha_m == rule.alpha_f == 0.0
        rule = replace(rule, by_forces=ties and own)
        check_clock(time, points.grid)
        scheme = TimeScheme(rule, ties, error, time)
        super().__init__(form, increment, points, conditions, scheme=scheme, **options)
        check_levels(self.form.parts.carried, 1.0 - rule.alpha_f, type(self).__name__)
        terms = mass_terms(self.form, self.fields, mass, ghost_mass, factorised=True)
        if faces:
            refuse_bodies(self.fields, "a face of the grid", "hold the sides with conditions")
        sides = Sides(faces, points, self.bcs)
        ledger = Ledger(points, self.form, self.bodies)
        scheme.motion = Motion(points, rule, chosen, terms, sides, ledger)
        check_masses(self.bodies)
        self.form.add(terms)
        self.form.start_in_time(scheme.means)

    @property
    def motion(self) -> Motion:
        """What the grid's motion was in the last step."""
        return self.scheme.motion

    @property
    def terms(self) -> MassTerms:
        """What the mass is made of."""
        return self.motion.terms

    @property
    def ledger(self) -> Ledger:
        """Where energy comes from and goes to."""
        return self.motion.ledger

    @property
    def time(self) -> float:
        """Time that the state is of (s)."""
        return self.scheme.clock.time

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
