"""Stabilisation against small cuts, each a few lines of UFL."""

from __future__ import annotations

import math

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinmpm.errors import ParameterError
from dolfinmpm.grid import cell_size
from dolfinmpm.points import MaterialPoints

__all__ = ["ghost"]


def _normal_derivative(w: Expr, side: str, k: int) -> Expr:
    """k-th derivative of w on one side of a facet, along the normal of its first side."""
    derivative = w
    for _ in range(k):
        derivative = ufl.grad(derivative)
    derivative = derivative(side)
    n = ufl.FacetNormal(ufl.domain.extract_unique_domain(w))("+")
    for _ in range(k):
        derivative = ufl.dot(derivative, n)
    return derivative


def ghost(
    points: MaterialPoints,
    u: Expr,
    v: Expr,
    gamma: float | Expr,
    order: int = 1,
    scaling: str = "scaled",
) -> ufl.Form:
    """Ghost penalty: jumps of the increment's normal derivatives across ghost facets.

    Σ_{k=1..q} γ h^{2k+1} / ((2k+1) (k!)²) ∫ [[∂ₙᵏ u]] · [[∂ₙᵏ v]] dΓ
    (Burman 2010; Coombs 2023, doi 10.1002/nme.7332). It acts on the step's
    increment, so that nothing accumulates.

    Args:
        points: Material points; the facets are those of their boundary cells.
        u: Increment of the step.
        v: Test function.
        gamma: γ. For a stiffness E/30 (Pa) works well, for a mass ρ/4 with
            `scaling="literal"`.
        order: q, the polynomial order of the basis.
        scaling: "scaled" divides γ by h², so that the term scales with h as a
            stiffness does and conditioning does not depend on units; "literal" is
            the published form, with γ in Pa/m² (or kg/m³ for a mass).

    Raises:
        ParameterError: γ is negative, or the order or the scaling is not known.
    """
    if isinstance(gamma, (int, float)) and not (math.isfinite(gamma) and gamma >= 0):
        raise ParameterError(f"gamma = {gamma} must be finite and not negative")
    if not isinstance(order, int) or order < 1:
        raise ParameterError(f"order = {order!r} must be a whole number of at least 1")
    if scaling not in ("scaled", "literal"):
        raise ParameterError(f'scaling = {scaling!r} must be "scaled" or "literal"')
    size = cell_size(points.grid)
    h = ufl.avg(size) if isinstance(size, fem.Function) else size
    if scaling == "scaled":
        gamma = gamma / h**2

    def jump(w: Expr, k: int) -> Expr:
        return _normal_derivative(w, "+", k) - _normal_derivative(w, "-", k)

    terms = [
        gamma
        * h ** (2 * k + 1)
        / ((2 * k + 1) * math.factorial(k) ** 2)
        * ufl.inner(jump(u, k), jump(v, k))
        for k in range(1, order + 1)
    ]
    return sum(terms[1:], start=terms[0]) * points.dS
