"""Energy densities of terms of a weak form that are derivatives of an energy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ufl.algorithms import extract_arguments, extract_coefficients
from ufl.classes import CoefficientDerivative, Division, Product, Sum
from ufl.constantvalue import zero
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm.basis.space import Space
from dolfinmpm.forms.termqueries import SPATIAL_DERIVATIVES, depends_on, summands

__all__ = ["density_of"]


def density_of(term: Expr, space: Space) -> Expr | None:
    """Strain energy density of a term that is a derivative of an energy (J per unit of measure).

    The density is found in `ufl.derivative(energy * dX, u, v)` before UFL expands the derivative.
    Parts of the energy without the gradient of u, such as the potential of a load, are left out.
    The density is 0 for a term without the gradient of the test function.

    Args:
        term: The term.
        space: Space of the increment u and the test function v.

    Returns:
        The density, or None if the term is no derivative of an energy.
    """
    if isinstance(term, Sum):
        total: Expr = zero()
        for one in term.ufl_operands:
            part = density_of(one, space)
            if part is None:
                return None
            total = total + part
        return total
    if isinstance(term, (Product, Division)):
        return _scaled(term, space)
    if isinstance(term, CoefficientDerivative):
        energy, variables, directions = term.ufl_operands[:3]
        if list(variables.ufl_operands) != [space.increment]:
            return _other(term, space)
        if list(directions.ufl_operands) != [space.test]:
            return None
        strained = [one for one in summands(energy) if _has_slope(one, [space.increment])]
        return sum(strained, start=zero())
    return _other(term, space)


def _scaled(term: Expr, space: Space) -> Expr | None:
    """Density of a derivative times a factor that does not depend on the increment."""
    first, second = term.ufl_operands
    for part, factor in ((first, second), (second, first)):
        of_test = any(a == space.test for a in extract_arguments(part))
        if not of_test or depends_on(factor, [space.increment]):
            continue
        density = density_of(part, space)
        if density is None:
            return None
        return density / factor if isinstance(term, Division) else density * factor
    return _other(term, space)


def _other(term: Expr, space: Space) -> Expr | None:
    """0 for a term without the test function's gradient, else None: its energy is not known."""
    tests = [a for a in extract_arguments(term) if a == space.test]
    return None if tests and _has_slope(term, tests) else zero()


def _has_slope(expression: Expr, of: Sequence[Any]) -> bool:
    """Whether an expression contains a gradient of one of the functions."""
    return any(
        isinstance(node, SPATIAL_DERIVATIVES)
        and any(c in of for c in (*extract_coefficients(node), *extract_arguments(node)))
        for node in unique_pre_traversal(expression)
    )
