"""What a problem is made of: checked arguments, remedies with their moduli, updates of fields."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import FormError, ParameterError, call_together
from dolfinmpm.assembly.updates import PointUpdates
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Field
from dolfinmpm.cut.remedies import Stabilisation
from dolfinmpm.kinematics import parameters_at
from dolfinmpm.materials.base import Law
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

    One for all fields is that of each of them. Of moduli that vary from point to point it
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
    integrands = [integral.integrand() for integral in form.integrals()]
    laws: list[Law] = []
    for coefficient in (c for i in integrands for c in extract_coefficients(i)):
        law = getattr(getattr(coefficient, "law", None), "law", None)
        if law is not None and "E" in law.values and law not in laws:
            laws.append(law)
    if not laws:
        raise ParameterError(
            f'stabilisation="{remedy.kind}" needs a modulus, and no law in the form has one: give '
            f'mpm.Stabilisation("{remedy.kind}", E=...)'
        )
    E = max(_largest(law, points, "E") for law in laws)
    nu = max(_largest(law, points, "nu") for law in laws)
    return replace(remedy, E=E, nu=nu)


def _largest(law: Law, points: MaterialPoints, name: str) -> float:
    """Largest value of a parameter over the points of all ranks; 0 if it has none. Collective."""
    if name not in law.values:
        return 0.0
    column = list(law.parameters).index(name)
    values = call_together(points.comm, lambda: parameters_at(law, points)[:, column])
    return float(points.comm.allreduce(values.max(initial=-math.inf), op=MPI.MAX))


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
    points, spaces = form.points, form.spaces
    made = [PointUpdates(given, spaces, points)] if given else []
    for number in form.parts.declared:
        declaration = points.declarations[number]
        if declaration.updates:
            made.append(PointUpdates(declaration.updates, spaces, points, declaration.tags))
    return made
