"""Inverses of small tensors in UFL that cost one division."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

__all__ = ["cofactors", "inverse"]


def cofactors(A: Expr) -> Expr:
    """Cofactors of a tensor, (det A) A⁻ᵀ, shape (d, d). `ufl.cofac` lacks d = 1."""
    return ufl.cofac(A) if A.ufl_shape[0] > 1 else ufl.Identity(1)


def inverse(A: Expr) -> Expr:
    """Inverse of a tensor, shape (d, d).

    `ufl.inv` divides each component, and each component of the derivative, by the determinant.
    Divisions take most of the time of such an expression.
    """
    return cofactors(A).T * (1 / ufl.det(A))
