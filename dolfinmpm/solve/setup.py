"""What a problem is made of: checked arguments, remedies with their moduli, updates of fields."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.assembly.updates import PointUpdates
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Field
from dolfinmpm.cut.remedies import Stabilisation
from dolfinmpm.forms.declarations import declared
from dolfinmpm.solve.operator import WeakForm

__all__ = ["check_arguments", "remedies_of", "space_of", "updates_of", "with_remedies"]

Remedies = Stabilisation | str | Sequence[Stabilisation | str]


def space_of(increment: fem.Function) -> Space:
    """The space of an increment.

    Raises:
        FormError: It is not the increment of a `Space`.
    """
    space = getattr(increment, "_dolfinmpm_space", None)
    if space is None:
        raise FormError(f"'{increment}' is not the increment of a dolfinmpm.Space")
    return space


def check_arguments(
    points: MaterialPoints,
    spaces: Sequence[Space],
    bcs: Sequence[Condition],
    tolerance: float,
    max_iterations: int,
    max_halvings: int,
) -> None:
    """Raise ParameterError where the arguments of a problem are not what they may be."""
    if any(space.grid is not points.grid for space in spaces):
        raise ParameterError("the material points live on another grid than the increment")
    if len({space.configuration for space in spaces}) > 1:
        raise ParameterError(
            "the fields' spaces are of several configurations; give all of them the same one"
        )
    if not (math.isfinite(tolerance) and 0 < tolerance < 1):
        raise ParameterError(f"tolerance = {tolerance} must be between 0 and 1")
    if max_iterations < 1 or max_halvings < 0:
        raise ParameterError(
            f"max_iterations = {max_iterations} must be at least 1, max_halvings = "
            f"{max_halvings} at least 0"
        )
    for condition in bcs:
        if not isinstance(condition, Condition):
            raise ParameterError(
                f"bcs holds a {type(condition).__name__}; use mpm.fixed, mpm.rollers or "
                "mpm.prescribed"
            )


def remedies_of(
    stabilisation: Remedies, spaces: Sequence[Space], form: ufl.Form, points: MaterialPoints
) -> list[Stabilisation]:
    """One remedy for every field, with the moduli of the form's law where it names none.

    One for all fields is that of each of them. Of several laws, and of moduli that vary, it
    takes the largest: too stiff a penalty costs less than one that leaves the stiffest
    cells ill-conditioned. Collective.

    Raises:
        ParameterError: Remedies are not as many as fields, or one needs a modulus that no
            law in the form has, or that is none of a field that is no displacement.
    """
    if not isinstance(form, ufl.Form):
        raise FormError(f"the weak form must be a UFL form, got {type(form).__name__}")
    several = isinstance(stabilisation, Sequence) and not isinstance(stabilisation, str)
    given: list[Any] = list(stabilisation) if several else [stabilisation] * len(spaces)  # type: ignore[arg-type]
    if len(given) != len(spaces):
        raise ParameterError(
            f"stabilisation has {len(given)} entries for {len(spaces)} fields; give one for each, "
            "or one for all"
        )
    made = []
    for k, (one, space) in enumerate(zip(given, spaces)):
        remedy = Stabilisation(one) if isinstance(one, str) else one
        if remedy.needs_modulus and remedy.E is None:
            if space.increment.ufl_shape != (points.gdim,):
                raise ParameterError(
                    f'stabilisation="{remedy.kind}" of field {k + 1} needs a modulus: it is no '
                    f'displacement, whose law would have one; give mpm.Stabilisation("'
                    f'{remedy.kind}", E=...) in a list with one entry a field, or "none"'
                )
            remedy = _with_modulus(remedy, form, points)
        made.append(remedy)
    return made


def _with_modulus(remedy: Stabilisation, form: ufl.Form, points: MaterialPoints) -> Stabilisation:
    moduli = []
    for declaration in declared(form, points):
        if "E" in declaration.law.values:
            declaration.bind()
            moduli.append((declaration.largest("E"), declaration.largest("nu")))
    if not moduli:
        raise ParameterError(
            f'stabilisation="{remedy.kind}" needs a modulus, and no law in the form has one: give '
            f'mpm.Stabilisation("{remedy.kind}", E=...)'
        )
    E, nu = max(moduli)
    return replace(remedy, E=E, nu=nu)


def with_remedies(
    form: ufl.Form, fields: Sequence[Field], points: MaterialPoints
) -> tuple[ufl.Form, ufl.Form | None]:
    """The form with the forces of the fields' remedies, and what these add to the tangent only."""
    softening = None
    for field in fields:
        trial = field.space.increment, field.space.test
        extra = field.remedy.force_terms(points, *trial)
        form = form if extra is None else form + extra
        soft = field.remedy.tangent_terms(points, *trial)
        if soft is not None:
            softening = soft if softening is None else softening + soft
    return form, softening


def updates_of(form: WeakForm, given: Mapping[str, Expr]) -> list[PointUpdates]:
    """Fields that a converged step sets: those of the form's laws, and those given. Collective."""
    made = [
        PointUpdates(declaration.updates, form.regions, form.spaces, form.points, declaration.tags)
        for declaration in form.parts.declarations
        if declaration.updates
    ]
    if given:
        made.append(PointUpdates(given, form.regions, form.spaces, form.points))
    return made
