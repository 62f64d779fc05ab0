"""Neo-Hookean elasticity, stated purely in UFL."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from dolfinmpm.materials.base import ELASTIC, lame

__all__ = ["NeoHookean"]


class NeoHookean:
    """Compressible neo-Hookean law: ψ = ½μ (tr FᵀF − d) − μ ln J + ½λ (ln J)².

    d is the dimension of space; in plane strain the direction across carries no
    strain. (Bonet & Wood 2008, Nonlinear Continuum Mechanics, eq. 6.27.)

    Args:
        E: Young's modulus (Pa), positive.
        nu: Poisson's ratio, -1 < ν < 0.5.

    Raises:
        ParameterError: A parameter is outside its range.
    """

    def __init__(self, E: float, nu: float):
        for name, value in (("E", E), ("nu", nu)):
            ELASTIC[name].check("NeoHookean", name, float(value))
        self.lmbda, self.mu = lame(E, nu)

    def energy(self, F: Expr) -> Expr:
        """Energy per initial volume (J/m^d) of a deformation gradient, shape (d, d)."""
        log_J = ufl.ln(ufl.det(F))
        stretch = ufl.inner(F, F) - F.ufl_shape[0]
        return 0.5 * self.mu * stretch - self.mu * log_J + 0.5 * self.lmbda * log_J**2

    def cauchy_stress(self, F: Expr) -> Expr:
        """Cauchy stress (Pa), shape (3, 3), plane strain in fewer dimensions."""
        d = F.ufl_shape[0]
        J = ufl.det(F)
        inside = self.mu * (F * F.T - ufl.Identity(d)) + self.lmbda * ufl.ln(J) * ufl.Identity(d)
        across = self.lmbda * ufl.ln(J)
        rows = [
            [inside[i, j] / J if i < d and j < d else (across / J if i == j else 0.0 * J)
             for j in range(3)]
            for i in range(3)
        ]  # fmt: skip
        return ufl.as_tensor(rows)
