"""Tractions and pressures on boundaries and surfaces, from numbers or in UFL."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from dolfinmpm._platform.argumentchecks import coordinates, number, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.axisymmetry import gradient, in_section
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.constants import own_constant

__all__ = ["area_at_end", "own_grid", "pressure_of", "vector_of"]


def vector_of(points: MaterialPoints, what: str, given: Any) -> Expr:
    """A vector for UFL, from one or from numbers.

    Args:
        points: Material points that it acts on.
        what: Name of the argument.
        given: The argument.

    Raises:
        ParameterError: It is no vector of the dimension of space, or of another grid.
    """
    d = points.gdim
    if isinstance(given, Expr):
        if given.ufl_shape != (d,):
            raise ParameterError(
                f"{what} '{str(given)[:100]}' has shape {given.ufl_shape} and must be a vector of "
                f"{d} components; pressure acts along the normal"
            )
        own_grid(points, what, given)
        return given
    if not isinstance(given, (Sequence, np.ndarray)) or isinstance(given, str) or len(given) != d:
        raise ParameterError(
            f"{what} = {shown(given)} must be a vector of {d} components: numbers, a "
            "dolfinx.fem.Constant or a UFL expression"
        )
    if any(isinstance(c, Expr) for c in given):
        own_grid(points, what, ufl.as_vector(list(given)))
        return ufl.as_vector(list(given))
    numbers = coordinates(what, given)
    components = [number(f"{what}[{k}]", c) for k, c in enumerate(numbers)]
    return own_constant(points.grid, components)


def pressure_of(points: MaterialPoints, p: Any) -> Expr:
    """A pressure for UFL (Pa), from one or from a number.

    Args:
        points: Material points that it acts on.
        p: The argument.

    Raises:
        ParameterError: It is no scalar, or of another grid.
    """
    if not isinstance(p, Expr):
        return own_constant(points.grid, number("p", p, unit="Pa"))
    if p.ufl_shape != ():
        raise ParameterError(
            f"pressure '{str(p)[:100]}' has shape {p.ufl_shape} and must be a scalar; a vector "
            "is a traction"
        )
    own_grid(points, "pressure", p)
    return p


def own_grid(points: MaterialPoints, what: str, given: Expr) -> None:
    """Raise ParameterError unless an expression lives on the grid of the points."""
    if any(domain != points.grid.ufl_domain() for domain in extract_domains(given)):
        raise ParameterError(
            f"{what} '{str(given)[:100]}' lives on another grid than the points: make it on "
            "points.grid, as in dolfinx.fem.Constant(points.grid, ...)"
        )


def area_at_end(points: MaterialPoints, normal: Expr, u: Expr) -> Expr:
    """Area vector at the end of a step per area at its start, ΔJ ΔF⁻ᵀ n, by Nanson's formula.

    Args:
        points: Markers of the boundary.
        normal: Unit normal n at the start of the step.
        u: Increment of the displacement (m).
    """
    dF = ufl.Identity(points.strain_dim) + gradient(points, u)
    return ufl.det(dF) * ufl.dot(normal, in_section(points, ufl.inv(dF)))
