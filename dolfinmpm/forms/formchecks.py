"""What a weak form must have, and must not, before it is split and compiled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives, extract_arguments, extract_coefficients
from ufl.classes import Division, Product, ScalarValue
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import shown
from dolfinmpm._platform.compat import restrict
from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.acting import MARK
from dolfinmpm.body.fields import PointField
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.forms.operators import PointOperator

__all__ = ["check_fields", "check_form", "check_levels", "check_signs"]


def check_form(form: Any) -> None:
    """Look for what is wrong with a weak form before it is split and compiled.

    Raises:
        FormError: It is no form, has no terms, has a footing twice, has a trial function or an
            unrestricted term on inner facets, adds what acts on the body, or subtracts what
            resists it.
    """
    if not isinstance(form, ufl.Form):
        raise FormError(f"the weak form must be a UFL form, got {_not_a_form(form)}")
    if form.empty():
        raise FormError("the weak form has no terms; begin with mpm.momentum(law, points, u, v)")
    arguments = [a for integral in form.integrals() for a in extract_arguments(integral)]
    if any(a.number() > 0 for a in arguments):
        raise FormError(
            "the weak form contains a TrialFunction; write Space.increment in its place beside "
            "Space.test, the solver derives the tangent itself"
        )
    check_signs(form)
    for integral in form.integrals():
        if integral.integral_type() == "interior_facet":
            _check_restricted(integral)


def check_levels(kept: Sequence[PointField], share: float, problem: str) -> None:
    """Raise FormError unless carried fields are of the level of a step where forces balance.

    Args:
        kept: Fields that a form carries.
        share: Share of the step up to there.
        problem: What balances them.
    """
    for field in kept:
        if isinstance(field, CarriedField) and abs(field.level - share) > 1e-12:
            raise FormError(
                f"the form carries '{field.name}' by a rule for forces that balance at "
                f"{field.level:.6g} of a step, and with {problem} they do at {share:.6g}: for "
                f"GeneralisedAlpha give mpm.poromechanics the same rho_inf, {1 / share - 1:.6g} "
                "here, and for any other problem none; a form of your own sets the `level` of its "
                "fields, see mpm.carried, or takes rho_inf=0"
            )


def check_fields(form: ufl.Form, spaces: Sequence[Space]) -> None:
    """Raise FormError unless the form, whose terms are all in order, determines every field."""
    increments = [space.increment for space in spaces]
    coefficients = [c for integral in form.integrals() for c in extract_coefficients(integral)]
    if not any(isinstance(c, PointOperator) or any(c is u for u in increments)
               for c in coefficients):  # fmt: skip
        raise FormError(
            "no term of the weak form depends on what is solved for; add internal forces, such as "
            "mpm.momentum(law, points, u, v)"
        )
    arguments = [a for integral in form.integrals() for a in extract_arguments(integral)]
    for k, space in enumerate(spaces):
        if not any(a == space.test for a in arguments):
            raise FormError(
                f"no term of the weak form contains the test function of field {k + 1} of "
                f"{len(spaces)}; add its equation, with Space.test"
            )


def _not_a_form(form: Any) -> str:
    if isinstance(form, ufl.equation.Equation):
        return "an equation; give its left side, whose zero is sought"
    if isinstance(form, fem.Form):
        return "a compiled dolfinx.fem.Form; give the UFL form that it was made from"
    if isinstance(form, Space):
        return "a Space; the arguments are form, increment, points, bcs"
    if isinstance(form, Expr):
        return "an expression; integrate it, as in expression * points.dX"
    return shown(form) if isinstance(form, (int, float)) else f"a {type(form).__name__}"


def check_signs(form: ufl.Form) -> None:
    """Raise FormError if a load, a penalty or a condition was subtracted.

    Their forms carry what they were made as, see `dolfinmpm.body.acting`; a sign that
    was put before it since is a factor of it. Terms that were rewritten in between, as
    by `ufl.replace`, cannot be told and pass.
    """
    seen: set[str] = set()
    for integral in form.integrals():
        acting = (integral.metadata() or {}).get(MARK)
        if acting is None:
            continue
        if acting.once and acting.name in seen:
            raise FormError(f"the form has {acting.name} twice: leave one out")
        seen.add(acting.name)
        sign = _factor(integral.integrand(), acting.integrand)
        if sign is not None and sign < 0:
            raise FormError(
                f"{acting.name} is subtracted from the weak form; all forces are added: write "
                "F += ..., and give a load that acts the other way a negative value"
            )


def _factor(term: Expr, part: Expr) -> float | None:
    """Sign of the numbers that multiply a part of a product, or None if it is no product of it."""
    if term is part or term == part:
        return 1.0
    if isinstance(term, Division):
        top, bottom = term.ufl_operands
        return _times(_factor(top, part), bottom)
    if isinstance(term, Product):
        a, b = term.ufl_operands
        first = _factor(a, part)
        return _times(first, b) if first is not None else _times(_factor(b, part), a)
    return None


def _times(sign: float | None, factor: Expr) -> float | None:
    # constants and fields are the user's loads, whose values have signs of their own
    if sign is None or not isinstance(factor, ScalarValue):
        return sign
    return sign * math.copysign(1.0, float(factor))


def _check_restricted(integral: Any) -> None:
    try:
        restrict(expand_derivatives(ufl.Form([integral])))
    except ValueError as error:
        text = str(error)
        if "restrict" not in text:
            raise
        term = str(integral.integrand())
        raise FormError(
            f"the term '{term if len(term) <= 200 else term[:197] + '...'}' on inner facets has "
            "something that differs between the two sides of a facet, or is restricted twice "
            f"({text.rstrip('.')}): write v('+'), ufl.jump(v) or ufl.avg(v) for v"
        ) from None
