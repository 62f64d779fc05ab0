"""What a problem is made of, in lines: `print(problem)`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem

if TYPE_CHECKING:
    from dolfinmpm.solve.problem import Problem

__all__ = ["summary"]


def summary(problem: Problem) -> str:
    """Fields, bases, stabilisation, laws, terms, conditions, scheme and solver, a line each.

    Every rank may ask by itself. What varies from point to point is told as "varying".

    Args:
        problem: The problem.
    """
    form, points = problem.form, problem.points
    lines = [f"{type(problem).__name__}: {points.total} points in {_dimension(points)}"]
    for k, field in enumerate(problem.fields):
        space, of = field.space, field.space.increment.ufl_shape
        kind = "displacement" if of == (points.gdim,) else f"field of shape {of}"
        lines.append(
            f"field {k + 1}: {kind}, {_basis(space)}, {space.configuration} configuration; "
            f"stabilisation: {field.stabilisation.kind}"
        )
    for law in form.parts.declarations:
        tags = "" if law.tags is None else f", tags {', '.join(map(str, law.tags))}"
        fbar = ", F-bar" if law.fbar else ""
        lines.append(f"law: {law.law!r}, {law.strain} strain{fbar}{tags}")
    lines.append(f"terms: {', '.join(_terms(problem)) or 'none'}")
    held = [f"{c.where}: component {c.component} {_value(c)}" for c in problem.bcs]
    lines.append(f"conditions: {'; '.join(held) or 'none'}")
    lines += [f"rigid body: '{body.name}'" for body in problem.bodies.all]
    return "\n".join(lines + problem.scheme_lines())


def _dimension(points: Any) -> str:
    return "axisymmetry" if points.axisymmetric else f"{points.gdim} dimensions"


def _basis(space: Any) -> str:
    degree, averaged = space.basis.degree, space.basis.averaged
    name = f"B-splines of degree {degree}" if degree > 1 else ("linear", "GIMP")[averaged]
    return name if space.coarsen == 1 else f"{name} on cells of {space.coarsen} times the size"


def _terms(problem: Problem) -> Iterable[str]:
    """Kinds of terms in the form."""
    form = problem.form
    if form.regions:
        yield "sums over points"
    yield from (told for term in form.terms if (told := term.summary()))


def _value(condition: Any) -> str:
    if condition.velocity is not None:
        return "moves by a velocity"
    if isinstance(condition.value, fem.Constant):
        return "increment by a constant"
    if np.ndim(condition.value):
        return "increments by node"
    return "held" if condition.value == 0 else f"increment {condition.value:g} m"
