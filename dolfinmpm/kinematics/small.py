"""Small strain: strains add up, and equilibrium is that of the body at first."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.kinematics.additive import additive_kernel
from dolfinmpm.kinematics.frameworks import Array, Framework, symmetric, widened

__all__ = ["SmallStrain"]


class SmallStrain(Framework):
    """A law under small strain: ε = ε_e,n + sym ∇ũ, flux S = σ per initial volume.

    Strain and stress of the law are those of the linear theory, where logarithmic and
    engineering strain, and Cauchy's, Kirchhoff's and Piola's stress, are the same.
    Nothing rotates and no volume changes. In plane strain the elastic strain across
    stays where plastic strain opposes it. Points still move with the grid, and each
    step takes its gradients where they then are: errors are those of the linear theory,
    of the order of strains and rotations.

    The state is the field `elastic_strain`; see `Framework`.
    """

    measure = "small"
    multiplicative = False
    state = "elastic_strain"
    rest = (0.0,) * 6

    @staticmethod
    def kernel(d: int):
        """The loop over the points in d dimensions."""
        return additive_kernel(d, False)

    def trial_strain(self, operand: Array, rows: npt.NDArray[np.int32]) -> Array:
        """ε_e,n + sym ∇ũ; see `Framework.trial_strain`."""
        strain = 0.5 * (operand + np.swapaxes(operand, -1, -2))
        return symmetric(self.points[self.state][rows]) + widened(strain)
