"""Checks of a weak form before it is split and compiled."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives, extract_arguments, extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.classes import ComplexValue, Division, Product, ScalarValue, Zero
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.compat import restrict
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm._platform.units import FAR_MODULI
from dolfinmpm.basis.space import Space
from dolfinmpm.body.fields import PointField
from dolfinmpm.body.formsigns import MARK
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.forms.operators import PointOperator
from dolfinmpm.forms.termqueries import brief, depends_on, summands, term_of
from dolfinmpm.forms.weightchecks import check_repeated, check_weights

__all__ = [
    "check_explicit",
    "check_fields",
    "check_form",
    "check_laws",
    "check_levels",
    "check_moving",
    "check_signs",
]

# Ratio of the modulus of a footing's penalty to that of the body, beyond which its load is rounded
_STIFFEST = 1e6


def check_form(form: Any) -> None:
    """Check a weak form before it is split and compiled.

    Args:
        form: The weak form, as the user wrote it.

    Raises:
        FormError: The form is no UFL form; has no terms; has a footing, a ghost penalty, the
            weight of a mixture or another term twice; has a trial function; has an unrestricted
            term on inner facets; adds a load; subtracts a term that resists the motion; or has a
            number that is complex or not finite.
    """
    if not isinstance(form, ufl.Form):
        raise FormError(f"the weak form must be a UFL form, got {_not_a_form(form)}")
    if form.empty():
        raise FormError("the weak form has no terms; begin with mpm.momentum(law, points, u, v)")
    arguments = [a for integral in form.integrals() for a in extract_arguments(integral)]
    if any(a.number() > 0 for a in arguments):
        raise FormError(
            "the weak form contains a TrialFunction; write Space.increment in its place, and "
            "Space.test as test function: the solver derives the tangent itself"
        )
    check_signs(form)
    check_weights(form)
    check_repeated(form)
    for integral in form.integrals():
        _check_numbers(integral.integrand())
        if integral.integral_type() == "interior_facet":
            _check_restricted(integral)


def check_levels(kept: Sequence[PointField], share: float, problem: str) -> None:
    """Compare the level of carried fields with the level at which a problem balances forces.

    Args:
        kept: Fields that a form carries.
        share: Share of the step at which the problem balances forces.
        problem: Name of the problem.

    Raises:
        FormError: The levels differ.
    """
    for field in kept:
        if not isinstance(field, CarriedField) or field.level is None:
            continue
        if abs(field.level - share) > 1e-12:
            raise FormError(
                f"the form carries '{field.name}' by a rule for forces that balance at "
                f"{field.level:.6g} of a step, but {problem} balances forces at {share:.6g}: for "
                f"GeneralisedAlpha give mpm.poromechanics the same rho_inf, {1 / share - 1:.6g} "
                "here, and for any other problem none; your own form sets the `level` of its "
                "fields, see mpm.carried, or takes rho_inf=0"
            )


def check_fields(form: ufl.Form, spaces: Sequence[Space]) -> None:
    """Check that the form determines every field.

    Args:
        form: Weak form whose terms have been checked.
        spaces: Spaces of the increments that the problem solves for.

    Raises:
        FormError: No term depends on the increments, or no term has the test function of a field.
    """
    increments = [space.increment for space in spaces]
    coefficients = [c for integral in form.integrals() for c in extract_coefficients(integral)]
    if not any(isinstance(c, PointOperator) or any(c is u for u in increments)
               for c in coefficients):  # fmt: skip
        raise FormError(
            "no term of the weak form depends on the increments that are solved for; add internal "
            "forces, such as mpm.momentum(law, points, u, v)"
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
        return "an equation; give the residual, left side minus right side"
    if isinstance(form, fem.Form):
        return "a compiled dolfinx.fem.Form; give the UFL form"
    if isinstance(form, Space):
        return "a Space; the arguments are form, increment, points, bcs"
    if isinstance(form, Expr):
        return "an expression; integrate it, as in expression * points.dX"
    return shown(form) if isinstance(form, (int, float)) else f"a {type(form).__name__}"


def check_signs(form: ufl.Form) -> None:
    """Refuse loads, penalties and conditions that are subtracted, and conditions that are scaled.

    The metadata of such terms contain their original integrand, see `dolfinmpm.body.formsigns`. A
    sign in the form is then a factor of this integrand. Rewritten terms, for example by
    `ufl.replace`, are not checked.

    Args:
        form: Weak form, as the user wrote it.

    Raises:
        FormError: A term has the wrong sign, is in the form twice but may be there only once, or
            is a condition with a factor.
    """
    seen: set[tuple[str, Hashable]] = set()
    for integral in form.integrals():
        acting = (integral.metadata() or {}).get(MARK)
        if acting is None:
            continue
        if acting.once and (acting.name, acting.kind) in seen:
            raise FormError(f"the form has {acting.name} twice: leave one out")
        seen.add((acting.name, acting.kind))
        factor = _factor(integral.integrand(), acting.integrand)
        if factor is None:
            continue
        if factor[0] < 0:
            raise FormError(
                f"{acting.name} is subtracted from the weak form; all forces are added: write "
                "F += ..., and give a load that acts the other way a negative value"
            )
        if "condition" in integral.metadata() and factor != (1.0, True):
            raise FormError(
                f"{acting.name} is scaled in the weak form, and would not be in balance with the "
                "stresses of the body: write F += ..., without a factor, and give penalty=... or "
                "stiffness_per_area=... for another strength"
            )


def check_laws(form: ufl.Form, points: MaterialPoints) -> None:
    """Refuse internal forces of laws that are subtracted.

    Args:
        form: Weak form, as the user wrote it.
        points: Its material points.

    Raises:
        FormError: A term of `mpm.momentum` has a negative factor.
        ParameterError: A footing was made with a modulus far below those of the laws.
    """
    moduli: list[tuple[Any, Any]] = []
    for integral in form.integrals():
        number = (integral.metadata() or {}).get("law")
        if number not in points.declarations:
            continue
        declaration = points.declarations[number]
        moduli.append((getattr(declaration.law, "values", {}).get("E"), declaration.law))
        for part in declaration.terms:
            factor = _factor(integral.integrand(), part)
            if factor is not None and factor[0] < 0:
                raise FormError(
                    f"the internal forces (mpm.momentum) of {declaration.law!r} are subtracted, "
                    "and stresses would have the wrong sign: write F = mpm.momentum(...), and "
                    "subtract loads"
                )
    if moduli and all(isinstance(E, float) for E, _ in moduli):
        _check_given(form, *min(moduli, key=lambda pair: float(pair[0])))
        _refuse_stiff(form, max(float(E) for E, _ in moduli))


def _check_given(form: ufl.Form, E: float, law: Any) -> None:
    """Refuse the penalty of a footing that goes with a modulus far below those of the laws.

    The footing would sink into the body by itself: its load was 7 % too low with kPa for Pa.

    Args:
        form: Weak form, as the user wrote it.
        E: Least Young's modulus of the laws (Pa).
        law: Its law.
    """
    for field in extract_coefficients(form):
        given, owner, has = getattr(field, "softest", None) or (E, "", "")
        if given < E / FAR_MODULI:
            raise ParameterError(
                f"{owner} has {has}, and {law!r} is {E / given:.3g} times stiffer, more than "
                f"{FAR_MODULI:g} times: the footing would sink into the body by itself. Give it "
                "E=, the Young's modulus of the body, in the unit of the law, or a larger "
                "stiffness= (Pa/m)"
            )


def _refuse_stiff(form: ufl.Form, E: float) -> None:
    """Refuse the penalty of a footing whose gaps are lost by rounding.

    Its load follows from them: it was off by 1.5 % with a modulus of 1e7 times that of the law, and
    had the wrong sign with 1e12 times.

    Args:
        form: Weak form, as the user wrote it.
        E: Largest Young's modulus of the laws (Pa).
    """
    for field in extract_coefficients(form):
        given, owner, has = getattr(field, "softest", None) or (E, "", "")
        if given > _STIFFEST * E:
            raise ParameterError(
                f"{owner} has {has}, more than {_STIFFEST:g} times that of the body, {E:.3g} Pa: "
                "its load follows from gaps, and these would be lost by rounding. Give E=, the "
                "Young's modulus of the body, and not of the footing"
            )


def check_explicit(form: ufl.Form, increment: Any, points: MaterialPoints) -> None:
    """Refuse terms of increments that explicit steps never see: they find their forces at zero.

    Args:
        form: Weak form.
        increment: Increment of the displacement.
        points: Material points of the form.

    Raises:
        FormError: The form has rates, or a term over cells or facets of the grid depends on the
            increment, or a term over the points is 0 for an increment of 0.
    """
    where = "increments are 0 where explicit steps find their forces"
    if points.dt in extract_constants(form):
        raise FormError(
            f"the form has rates over points.dt, and {where}; take Newmark or Transient, or "
            "bulk_viscosity and damping"
        )
    for integral in form.integrals():
        on_points = integral.integral_type() == "custom" or term_of(integral) is not None
        if not on_points and depends_on(integral.integrand(), [increment]):
            raise FormError(
                f"the term '{brief(integral.integrand())}' over the grid depends on the increment, "
                f"and {where}, so that it would do nothing; take Newmark, or for cut cells "
                'stabilisation="ghost" or "aggregation"'
            )
        if integral.integral_type() == "custom" and term_of(integral) is None:
            _refuse_without_force(integral, increment, where)


def _refuse_without_force(integral: Any, increment: Any, where: str) -> None:
    """Raise FormError if a term over points depends on the increment, and is 0 without it."""
    if not any(c is increment for c in extract_coefficients(integral.integrand())):
        return
    none = {increment: ufl.zero(increment.ufl_shape)}
    for own in expand_derivatives(ufl.Form([integral])).integrals():
        for term in summands(own.integrand()):
            depends = any(c is increment for c in extract_coefficients(term))
            if depends and isinstance(ufl.replace(term, none), Zero):
                raise FormError(
                    f"the term '{brief(term)}' over the points is 0 without the increment, and "
                    f"{where}, so that it would do nothing; state the force by fields of the "
                    "points, such as points.x - points.x0, or take Newmark"
                )


def check_moving(laws: Sequence[Declaration], increments: Sequence[Any]) -> None:
    """Refuse laws of a displacement that moves no points.

    Args:
        laws: Declarations of the laws in a form.
        increments: Increments of the fields that move points.

    Raises:
        FormError: A law is of another increment, so that its strains would never add up.
    """
    for law in laws:
        if not any(law.u is u for u in increments):
            raise FormError(
                f"mpm.momentum of {law.law!r} is of a displacement that moves no points: the first "
                "field of a problem moves them, or the displacements whose Spaces have tags; give "
                "this increment first"
            )


def _check_numbers(integrand: Expr) -> None:
    for node in unique_pre_traversal(integrand):
        if isinstance(node, ScalarValue) and not np.isfinite(complex(node).real):
            raise FormError(
                f"the form has the number {node}, which is not finite; nan is the result of a "
                "failed computation"
            )
        if isinstance(node, ComplexValue):
            raise FormError(f"the form has the complex number {node}: the solver is of real ones")


def _factor(term: Expr, part: Expr) -> tuple[float, bool] | None:
    """Product of the numbers that multiply a part of a term, or None if it is no such product.

    Returns:
        The product, and whether nothing else multiplies the part. Constants and fields are the
        user's loads: the sign of their values is not the form's sign.
    """
    if term is part or term == part:
        return 1.0, True
    if not isinstance(term, (Division, Product)):
        return None
    a, b = term.ufl_operands
    found, factor = _factor(a, part), b
    if found is None and isinstance(term, Product):
        found, factor = _factor(b, part), a
    if found is None or not isinstance(factor, ScalarValue):
        return found and (found[0], False)
    value = float(factor)
    return found[0] * (1.0 / value if isinstance(term, Division) else value), found[1]


def _check_restricted(integral: Any) -> None:
    try:
        restrict(expand_derivatives(ufl.Form([integral])))
    except ValueError as error:
        text = str(error)
        if "restrict" not in text:
            raise
        raise FormError(
            f"the term '{brief(integral.integrand())}' on inner facets has "
            "a part that differs between the two sides of a facet, or is restricted twice "
            f"({text.rstrip('.')}): write v('+'), ufl.jump(v) or ufl.avg(v) for v"
        ) from None
