"""Jaumann's rate of stress: small strain increments on a body that turns."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.kinematics.additive import additive_kernel
from dolfinmpm.kinematics.frameworks import Array, Framework, symmetric, widened

__all__ = ["Jaumann"]


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
    _takes_F = True

    @staticmethod
    def kernel(d: int):
        """The loop over the points in d dimensions."""
        return additive_kernel(d, True)

    def trial_strain(self, operand: Array, rows: npt.NDArray[np.int32]) -> Array:
        """R ε_e,n Rᵀ + sym G; see `Framework.trial_strain`."""
        H, one = widened(operand), np.eye(3)
        inside_out = ~((np.linalg.det(one + H) > 0) & (np.linalg.det(one + 0.5 * H) > 0))
        H[inside_out] = 0.0
        G = H @ np.linalg.inv(one + 0.5 * H)
        half = 0.25 * (G - np.swapaxes(G, -1, -2))
        R = np.linalg.solve(one - half, one + half)
        turned = R @ symmetric(self.points[self.state][rows]) @ np.swapaxes(R, -1, -2)
        trial = turned + 0.5 * (G + np.swapaxes(G, -1, -2))
        trial[inside_out] = np.nan
        return trial
