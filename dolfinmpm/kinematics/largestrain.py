"""Large strain: logarithmic strain and Kirchhoff stress.

The grid is undeformed at the start of every step. Gradients are therefore taken by positions at
the start of the step (Charlton, Coombs & Augarde 2017, doi 10.1016/j.compstruc.2017.05.004). The
increment gives ΔF = I + ∇ũ and the trial tensor b = ΔF b_n ΔFᵀ. The law gets the principal
logarithmic strains ½ ln λ_i of b and gives the Kirchhoff stress τ. The flux per initial volume is
S = τ ΔF⁻ᵀ, which multiplies ∇̃v.
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from dolfinmpm.forms.inverse import inverse
from dolfinmpm.kinematics.strainformulation import StrainFormulation
from dolfinmpm.kinematics.strainfunctions import StrainFunctions

__all__ = ["LargeStrain"]


class _Large(StrainFunctions):
    logarithmic = True

    def trial(self, G: Expr, old: Expr) -> Expr:
        dF = ufl.Identity(self.d) + G
        return dF * old * dF.T

    def flux(self, stress: Expr, H: Expr, F: Expr) -> Expr:
        return stress * inverse(ufl.Identity(self.d) + H).T

    def volume(self, H: Expr, F: Expr) -> Expr:
        return ufl.det(ufl.Identity(self.d) + H) * ufl.det(F)

    def positive(self, H: Expr) -> list[Expr]:
        return [ufl.det(ufl.Identity(self.d) + H)]


class LargeStrain(StrainFormulation):
    """A law with large strain: b = ΔF b_n ΔFᵀ, ε = ½ ln b, flux S = τ ΔF⁻ᵀ.

    The state is the field `be`, the elastic left Cauchy–Green tensor; see `StrainFormulation`.
    """

    strain = "large"
    multiplicative = True
    state = "be"
    rest = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    functions = _Large
