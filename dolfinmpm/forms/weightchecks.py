"""Loads that a form has twice, such as the weight: by two terms, or by `mpm.poromechanics` too."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.algorithms import extract_arguments, extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.classes import (
    FloatValue,
    Index,
    IntValue,
    Label,
    ListTensor,
    MultiIndex,
    ScalarValue,
    Zero,
)
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm._platform.errors import DoubtfulInputWarning, FormError, warn
from dolfinmpm.body.fields import PointField
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.carriedfields import CARRIED, CarriedField
from dolfinmpm.forms.termqueries import brief, summands, tags_of, term_of

__all__ = ["check_repeated", "check_weights", "same_points", "warn_of_second_inertia"]

Array = npt.NDArray[np.float64]


def check_weights(form: ufl.Form) -> None:
    """Refuse a second weight of a mixture whose form has its weight.

    A term with the field `density` is a second weight if it has the same constants, or the same
    numbers, as `gravity`. Other accelerations, such as those of an earthquake, are allowed.

    Args:
        form: Weak form, as the user wrote it.

    Raises:
        FormError: The weight is there twice at some points.
    """
    heavy = [(i, field) for i in form.integrals() for field in _with_gravity(i)]
    for mixture, field in heavy:
        for integral in form.integrals():
            if integral is mixture or not same_points(mixture, integral):
                continue
            term = integral.integrand()
            if extract_arguments(term) and _has_density(term) and _same_acceleration(field, term):
                raise FormError(
                    f"the weight of the mixture is in the form twice: by mpm.poromechanics("
                    f"gravity=...), and by '{brief(term)}'; leave one out"
                )


def warn_of_second_inertia(form: ufl.Form, points: MaterialPoints, scheme: str) -> None:
    """Warn of a term density times acceleration in a problem that has this inertia itself.

    A term with a factor, or with another density, is an added mass.

    Args:
        form: Weak form, as the user wrote it.
        points: Its material points.
        scheme: Name of the problem's class.
    """
    for integral in form.integrals():
        if CARRIED in (integral.metadata() or {}):
            continue
        for term in summands(integral.integrand()):
            fields = {c.name for c in extract_coefficients(term) if isinstance(c, PointField)}
            if fields != {"density", "start_acceleration"}:
                continue
            factors = [c for c in extract_constants(term) if c is not points.inertia]
            numbers = [
                float(n)
                for n in unique_pre_traversal(term)
                if isinstance(n, (FloatValue, IntValue))
            ]
            if not factors and all(n in (1.0, -1.0) for n in numbers):
                warn(
                    points.comm,
                    f"the term '{brief(term)}' doubles the inertia: {scheme} has that of the "
                    "points' density itself; leave the term out",
                    DoubtfulInputWarning,
                )
                return


def check_repeated(form: ufl.Form) -> None:
    """Refuse a term over the points that is there twice, as if a line of a notebook ran again.

    Args:
        form: Weak form, as the user wrote it.

    Raises:
        FormError: Two terms are the same up to the names of their indices, at some points.
    """
    seen: list[ufl.Integral] = []
    terms = [(i, term_of(i)) for i in form.integrals()]
    # springs that are subtracted have a message of their own
    beds = [
        t for i, t in terms if getattr(t, "kind", "") == "springs" and i.integrand() == t.integrand
    ]
    for k, bed in enumerate(beds):
        if any(bed.surface is other.surface for other in beds[:k]):
            raise FormError(f"the form has {bed!r} twice, and they would act twice: leave one out")
    for integral in form.integrals():
        marks = integral.metadata() or {}
        # laws and terms that are no quadrature, such as a contact, are compared elsewhere
        if "points" not in marks or "law" in marks or term_of(integral) is not None:
            continue
        for other in seen:
            if same_points(integral, other) and _same(integral.integrand(), other.integrand(), {}):
                raise FormError(
                    f"the form has the term '{brief(integral.integrand())}' twice for the same "
                    "points, and it would act twice: leave one out, or write a factor of 2. A line "
                    "F += ... or F -= ... that runs again adds its term again: make F anew before"
                )
        seen.append(integral)


def _same(a: Any, b: Any, names: dict[Any, Any]) -> bool:
    """Whether two expressions are the same, with one's free indices and labels renamed."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, (Index, Label)):
        return names.setdefault(a, b) == b
    if isinstance(a, MultiIndex):
        return len(a) == len(b) and all(_same(i, j, names) for i, j in zip(a, b))
    if not isinstance(a, Expr) or not a.ufl_operands:
        return bool(a == b)
    both = zip(a.ufl_operands, b.ufl_operands)
    return len(a.ufl_operands) == len(b.ufl_operands) and all(_same(x, y, names) for x, y in both)


def _with_gravity(integral: ufl.Integral) -> Iterator[CarriedField]:
    for field in (integral.metadata() or {}).get(CARRIED, ()):
        if getattr(field, "gravity", None) is not None:
            yield field


def same_points(a: ufl.Integral, b: ufl.Integral) -> bool:
    """Whether some points integrate both terms."""
    number = (a.metadata() or {}).get("points")
    if number is None or (b.metadata() or {}).get("points") != number:
        return False
    first, second = tags_of(a), tags_of(b)
    return first is None or second is None or bool(set(first) & set(second))


def _has_density(term: Expr) -> bool:
    return any(
        isinstance(c, PointField) and c.name == "density" for c in extract_coefficients(term)
    )


def _same_acceleration(field: CarriedField, term: Expr) -> bool:
    """Whether a term has the constants, or the numbers, of a gravity."""
    own, other = extract_constants(field.gravity), extract_constants(term)
    if any(a is b for a in own for b in other):
        return True
    wanted = [g for g in _vectors(field.gravity) if g.any()]
    return any(np.array_equal(g, found) for g in wanted for found in _vectors(term))


def _vectors(expression: Expr) -> Iterator[Array]:
    """Values of the constant vectors in an expression now."""
    for node in unique_pre_traversal(expression):
        if isinstance(node, fem.Constant) and len(node.ufl_shape) == 1:
            yield np.asarray(node.value, float)
        if isinstance(node, ListTensor) and all(
            isinstance(part, (ScalarValue, Zero)) for part in node.ufl_operands
        ):
            yield np.array([float(part) for part in node.ufl_operands])
