"""Small strain: strains add up, and equilibrium is that of the body at first."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from dolfinmpm.kinematics.frameworks import Framework
from dolfinmpm.kinematics.measures import StrainMeasure

__all__ = ["SmallStrain"]


class _Small(StrainMeasure):
    logarithmic = False

    def trial(self, G: Expr, old: Expr) -> Expr:
        return old + ufl.sym(G)

    def flux(self, stress: Expr, H: Expr, F: Expr) -> Expr:
        return stress


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
    kinematics = _Small
