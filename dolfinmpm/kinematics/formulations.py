"""The strain formulations: large strain, small strain, and small increments with Jaumann's rate."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from dolfinmpm.forms.inverse import cofactors, inverse
from dolfinmpm.kinematics.strainformulation import StrainFormulation
from dolfinmpm.kinematics.strainfunctions import StrainFunctions

__all__ = ["FORMULATIONS", "Jaumann", "LargeStrain", "SmallStrain"]


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

    The grid is undeformed at the start of every step. Gradients are therefore taken by positions at
    the start of the step (Charlton, Coombs & Augarde 2017, doi 10.1016/j.compstruc.2017.05.004).
    The increment gives ΔF = I + ∇ũ. The law gets the principal logarithmic strains ½ ln λ_i of b,
    and gives the Kirchhoff stress τ. The flux per initial volume is S, which multiplies ∇̃v.

    The state is the field `be`, the elastic left Cauchy–Green tensor; see `StrainFormulation`.
    """

    strain = "large"
    multiplicative = True
    state = "be"
    rest = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    functions = _Large


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


class _Jaumann(StrainFunctions):
    logarithmic = False

    def rate(self, H: Expr) -> Expr:
        return H * inverse(ufl.Identity(self.d) + 0.5 * H)

    def trial(self, G: Expr, old: Expr) -> Expr:
        W = ufl.skew(G)
        # (1 − W/2)⁻¹ (1 + W/2) without the inverse: W³ = −½ (W : W) W in up to three dimensions
        R = ufl.Identity(self.d) + (W + 0.5 * W * W) / (1 + ufl.inner(W, W) / 8)
        return R * old * R.T + ufl.sym(G)

    def flux(self, stress: Expr, H: Expr, F: Expr) -> Expr:
        dF = ufl.Identity(self.d) + H
        return ufl.det(F) * stress * cofactors(dF)

    def positive(self, H: Expr) -> list[Expr]:
        one = ufl.Identity(self.d)
        return [ufl.det(one + H), ufl.det(one + 0.5 * H)]


class Jaumann(StrainFormulation):
    """A law with Jaumann's rate: the old elastic strain rotates, and the increment is added.

    ε = R ε_e,n Rᵀ + sym G with R = (1 − W/2)⁻¹ (1 + W/2), W = skew G and G = ∇ũ (1 + ∇ũ/2)⁻¹.
    G is the increment's gradient by the configuration in the middle of the step (Hughes & Winget
    1980, doi 10.1002/nme.1620151210). A rotation by any angle below 180° then rotates the stress
    exactly and makes no strain. With ∇ũ in place of G, this would hold only for small angles. The
    law gives the Cauchy stress σ. The flux per initial volume is S = J σ ΔF⁻ᵀ, with the volume
    ratio J at the end of the step. Equilibrium therefore holds at the end of the step. The tangent
    contains the derivatives of G, R, J and ΔF⁻ᵀ. For isotropic laws, rotating the strain is the
    same as rotating the stress. Components out of the plane do not rotate. As in the publication,
    the increment itself is not rotated by half of R; the method is of first order in the step.

    Limits: the rate does not follow from an energy. In simple shear γ with small steps, the stress
    σ₁₂ = μ sin γ oscillates (Dienes 1979, doi 10.1007/BF01181469). After a closed cycle of elastic
    shear, stress and work remain, and they grow from cycle to cycle. Below some 10 % of strain
    these errors are small. For larger strains and for many cycles, take `strain="large"`.

    The state is the field `elastic_strain`; see `StrainFormulation`.
    """

    strain = "jaumann"
    multiplicative = False
    state = "elastic_strain"
    rest = (0.0,) * 6
    functions = _Jaumann


# by the argument `strain` of `momentum`
FORMULATIONS: dict[str, type[StrainFormulation]] = {
    one.strain: one for one in (LargeStrain, SmallStrain, Jaumann)
}
