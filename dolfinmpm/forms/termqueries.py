"""Small helpers for terms of a form."""

from collections.abc import Iterator, Sequence
from typing import Any

from ufl.algorithms import extract_coefficients
from ufl.classes import Sum
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import Tags, as_tags
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.forms.operators import PointOperator

__all__ = ["brief", "contact_of", "operators_in", "summands", "tags_of"]


def brief(expression: Expr) -> str:
    """An expression as text for messages, at most 200 characters."""
    text = str(expression)
    return text if len(text) <= 200 else text[:197] + "..."


def summands(expression: Expr) -> Iterator[Expr]:
    """The terms of a sum."""
    if isinstance(expression, Sum):
        for operand in expression.ufl_operands:
            yield from summands(operand)
    else:
        yield expression


def depends_on(expression: Expr, increments: Sequence[Any]) -> bool:
    """Whether an expression depends on the increments, directly or by a law."""
    return any(
        isinstance(c, PointOperator) or any(c is u for u in increments)
        for c in extract_coefficients(expression)
    )


def contact_of(integral) -> Any:
    """The contact of a term, or None; see `dolfinmpm.contact`."""
    return (integral.metadata() or {}).get("contact")


def operators_in(term: Expr) -> list[PointOperator]:
    """The operators (laws) in a term."""
    return [c for c in extract_coefficients(term) if isinstance(c, PointOperator)]


def tags_of(integral) -> Tags:
    """Tags of the points that integrate a term; None means all points.

    Raises:
        FormError: The subdomain of the term's measure is no tag.
    """
    where = integral.subdomain_id()
    try:
        return None if where == "everywhere" else as_tags(where)
    except ParameterError as error:
        raise FormError(
            f"the term '{brief(integral.integrand())}' restricts a measure of points: {error}"
        ) from None
