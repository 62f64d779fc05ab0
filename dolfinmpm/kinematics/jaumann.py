"""Jaumann's rate of stress: small strain increments on a body that turns."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from dolfinmpm.kinematics.frameworks import Framework
from dolfinmpm.kinematics.measures import StrainMeasure

__all__ = ["Jaumann"]


class _Jaumann(StrainMeasure):
    logarithmic = False

    def rate(self, H: Expr) -> Expr:
        return H * ufl.inv(ufl.Identity(self.d) + 0.5 * H)

    def trial(self, G: Expr, old: Expr) -> Expr:
        W = ufl.skew(G)
        # (1 − W/2)⁻¹ (1 + W/2) without the inverse: W³ = −½ (W : W) W in up to three dimensions
        R = ufl.Identity(self.d) + (W + 0.5 * W * W) / (1 + ufl.inner(W, W) / 8)
        return R * old * R.T + ufl.sym(G)

    def flux(self, stress: Expr, H: Expr, F: Expr) -> Expr:
        dF = ufl.Identity(self.d) + H
        return ufl.det(dF) * ufl.det(F) * stress * ufl.inv(dF).T

    def positive(self, H: Expr) -> list[Expr]:
        one = ufl.Identity(self.d)
        return [ufl.det(one + H), ufl.det(one + 0.5 * H)]


class Jaumann(Framework):
    """A law under Jaumann's rate: the old elastic strain turns, the increment is added.

    ε = R ε_e,n Rᵀ + sym G with R = (1 − W/2)⁻¹ (1 + W/2), W = skew G and G = ∇ũ (1 + ∇ũ/2)⁻¹,
    the increment's gradient by the configuration in the middle of the step (Hughes &
    Winget 1980, doi 10.1002/nme.1620151210): a rotation of any angle below 180° turns the
    stress exactly and strains nothing, as it would with ∇ũ in place of G only for small
    angles. The law gives Cauchy's stress σ, and the flux per initial volume is S = J σ ΔF⁻ᵀ
    with J the volume ratio at the end of the step: equilibrium is that of the end, and
    the tangent takes in G, R, J and ΔF⁻ᵀ. For isotropic laws it is the same to turn
    the strain or the stress. Dimensions across the plane do not turn. As published, the
    increment itself is not turned by the half of R: it is of order 1 in the step.

    Limits: the rate derives from no energy. Under simple shear γ in small steps
    σ₁₂ = μ sin γ oscillates (Dienes 1979, doi 10.1007/BF01181469), a cycle of elastic shear
    that is closed in the strain leaves stress and work behind, and it drifts from cycle
    to cycle. Below some ten per cent of strain this is of little consequence; beyond,
    and under many cycles, take `strain="large"`.

    The state is the field `elastic_strain`; see `Framework`.
    """

    measure = "jaumann"
    multiplicative = False
    state = "elastic_strain"
    rest = (0.0,) * 6
    kinematics = _Jaumann
