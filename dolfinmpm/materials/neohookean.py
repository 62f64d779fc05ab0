"""Neo-Hookean elasticity in UFL."""

from __future__ import annotations

from typing import Any

import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials.base import ELASTIC, lame
from dolfinmpm.materials.parametrised import Parametrised, Value

__all__ = ["NeoHookean"]


class NeoHookean(Parametrised):
    """Compressible neo-Hookean law: ψ = ½μ (tr FᵀF − d) − μ ln J + ½λ (ln J)².

    d is the dimension of space. In plane strain the out-of-plane direction has no strain.
    (Bonet & Wood 2008, Nonlinear Continuum Mechanics, eq. 6.27.)

    Args:
        E: Young's modulus (Pa), positive: a number, or one value per point as in any `Law`.
        nu: Poisson's ratio, -1 < ν < 0.5, likewise.

    Raises:
        ParameterError: A parameter is outside its range.

    The modulus grows with the height:

    >>> import dolfinmpm as mpm
    >>> law = mpm.materials.NeoHookean(E=lambda x: 1e6 + 1e5 * x[1], nu=0.3)
    >>> law.varies
    True
    """

    parameters = ELASTIC
    symmetric = True

    def __init__(self, E: Value, nu: Value):
        super().__init__(E=E, nu=nu)

    def energy(self, F: Expr, E: Any = None, nu: Any = None) -> Expr:
        """Energy per initial volume (J/m^d).

        Args:
            F: Deformation gradient, shape (d, d).
            E: Young's modulus in UFL (Pa), such as a constant; the law's number by default.
            nu: Poisson's ratio, likewise.
        """
        _check_tensor(F)
        lmbda, mu = self._lame(E, nu)
        log_J = ufl.ln(ufl.det(F))
        stretch = ufl.inner(F, F) - F.ufl_shape[0]
        return 0.5 * mu * stretch - mu * log_J + 0.5 * lmbda * log_J**2

    def cauchy_stress(self, F: Expr, E: Any = None, nu: Any = None) -> Expr:
        """Cauchy stress (Pa), shape (3, 3), plane strain in fewer dimensions.

        Args:
            F, E, nu: See `energy`.
        """
        _check_tensor(F)
        lmbda, mu = self._lame(E, nu)
        d = F.ufl_shape[0]
        J = ufl.det(F)
        inside = mu * (F * F.T - ufl.Identity(d)) + lmbda * ufl.ln(J) * ufl.Identity(d)
        across = lmbda * ufl.ln(J)
        rows = [
            [inside[i, j] / J if i < d and j < d else (across / J if i == j else 0.0 * J)
             for j in range(3)]
            for i in range(3)
        ]  # fmt: skip
        return ufl.as_tensor(rows)

    def _lame(self, E: Any, nu: Any) -> tuple[Any, Any]:
        return lame(self.E if E is None else E, self.nu if nu is None else nu)


def _check_tensor(F: Any) -> None:
    """Raise ParameterError unless it is a tensor of UFL."""
    shape: tuple[int, ...] = getattr(F, "ufl_shape", ())
    if len(shape) != 2 or shape[0] != shape[1]:
        raise ParameterError(
            f"F = {shown(F)} must be a deformation gradient in UFL, of shape (d, d), such as "
            "points.F"
        )
