"""What forms over material points may be given: points, increments, test functions."""

from __future__ import annotations

from typing import Any

from dolfinx import fem
from ufl.algorithms import extract_arguments, extract_coefficients
from ufl.core.expr import Expr
from ufl.domain import extract_unique_domain

from dolfinmpm._platform.argumentchecks import check_kind, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.points import MaterialPoints

__all__ = ["check_displacement", "check_increment", "check_points", "check_test"]

_WORDS = {"increment": "increment", "test": "test function"}


def check_points(points: Any) -> None:
    """Raise ParameterError unless it is one set of material points."""
    check_kind("points", points, MaterialPoints, "give one set, what mpm.fill returns")


def check_displacement(points: MaterialPoints, **given: Any) -> None:
    """Raise ParameterError unless u and v are of a displacement of the points.

    Args:
        points: Material points.
        given: u, an increment, or v, a test function, or both.
    """
    shape = (points.gdim,)
    if "u" in given:
        _check("u", given["u"], points, shape, "increment", "a displacement")
    if "v" in given:
        _check("v", given["v"], points, shape, "test", "a displacement")


def check_increment(points: MaterialPoints, u: Any) -> None:
    """Raise ParameterError unless u can be the increment of a field on the points' grid."""
    _check("u", u, points, getattr(u, "ufl_shape", ()), "increment", "a field")


def check_test(points: MaterialPoints, u: Expr, v: Any) -> None:
    """Raise ParameterError unless v can be the test function of the field that u is of."""
    what = f"the field that u is of, of shape {u.ufl_shape}"
    _check("v", v, points, u.ufl_shape, "test", what)


def _check(
    name: str, given: Any, points: MaterialPoints, shape: tuple[int, ...], role: str, of: str
) -> None:
    wanted = f"must be the {_WORDS[role]} of {of}, Space.{role}"
    if not isinstance(given, Expr):
        raise ParameterError(f"{name} = {shown(given)} {wanted}")
    numbers = sorted(argument.number() for argument in extract_arguments(given))
    if role == "test":
        right = numbers == [0]
    else:
        right = not numbers and any(
            isinstance(c, fem.Function) for c in extract_coefficients(given)
        )
    if not right:
        what = {(0,): "a test function", (1,): "a trial function"}.get(tuple(numbers))
        raise ParameterError(f"{name} = {what or shown(given)} {wanted}")
    if given.ufl_shape != shape:
        raise ParameterError(f"{name} has the shape {given.ufl_shape} and {wanted}")
    if extract_unique_domain(given) != points.grid.ufl_domain():
        raise ParameterError(
            f"{name} lives on another grid than the points and {wanted}, of a Space on points.grid"
        )
