"""Small strain: strain increments are added, and equilibrium is on the initial volume."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from dolfinmpm.kinematics.strainformulation import StrainFormulation
from dolfinmpm.kinematics.strainfunctions import StrainFunctions

__all__ = ["SmallStrain"]


class _Small(StrainFunctions):
    logarithmic = False

    def trial(self, G: Expr, old: Expr) -> Expr:
        return old + ufl.sym(G)

    def flux(self, stress: Expr, H: Expr, F: Expr) -> Expr:
        return stress


class SmallStrain(StrainFormulation):
    """A law with small strain: ε = ε_e,n + sym ∇ũ, flux S = σ per initial volume.

    Strain and stress of the law are the strain and stress of the linear theory. In this theory
    logarithmic and engineering strain are the same, and so are the stresses of Cauchy, Kirchhoff
    and Piola. Rotations and volume changes have no effect. In plane strain, the elastic strain out
    of the plane is kept, because plastic strain balances it. Points still move with the grid, and
    each step takes gradients at their present positions. The errors are the errors of the linear
    theory, of the order of strains and rotations.

    The state is the field `elastic_strain`; see `StrainFormulation`.
    """

    strain = "small"
    multiplicative = False
    state = "elastic_strain"
    rest = (0.0,) * 6
    functions = _Small
