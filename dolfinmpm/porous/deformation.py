"""Volume changes by a step's increment, and spatial gradients at the end of the step."""

from __future__ import annotations

from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

from dolfinmpm.body.axisymmetry import gradient, in_section
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.inverse import inverse

__all__ = ["Kinematics", "kinematics"]


@dataclass(frozen=True)
class Kinematics:
    """Volume change and spatial gradients after a step's increment.

    Attributes:
        points: Material points.
        J: det F at the end of the step (-).
        growth: J at the end of the step minus J at its start (-).
        inverse: Inverse of the step's deformation gradient, which turns gradients by positions at
            the start of the step into spatial gradients at its end. None for small strain.
    """

    points: MaterialPoints
    J: Expr | float
    growth: Expr
    inverse: Expr | None

    def grad(self, w: Expr) -> Expr:
        """Spatial gradient at the end of the step, with the hoop term if any; see `gradient`.

        Args:
            w: Scalar or vector field of the grid.
        """
        points, inverse = self.points, self.inverse
        if w.ufl_shape == ():
            slope = ufl.grad(w)
            inverse = inverse if inverse is None else in_section(points, inverse)
        else:
            slope = gradient(points, w)
        return slope if inverse is None else ufl.dot(slope, inverse)

    def spatial(self, slope: Expr) -> Expr:
        """Spatial gradient of a scalar at the end of the step.

        Args:
            slope: Gradient of the scalar by positions at the start of the step.
        """
        inverse = self.inverse
        return slope if inverse is None else ufl.dot(slope, in_section(self.points, inverse))


def kinematics(
    points: MaterialPoints, u: Expr, strain: str, factor: Expr | None = None
) -> Kinematics:
    """Volume change and spatial gradients after a step's increment, by the strain formulation.

    Args:
        points: Material points.
        u: Increment of the displacement (m).
        strain: Name of the strain formulation.
        factor: Factor that multiplies the increment, or None for 1.
    """
    slope = gradient(points, u)
    if factor is not None:
        slope = factor * slope
    if strain == "small":
        return Kinematics(points, 1.0, ufl.tr(slope), None)
    dF = ufl.Identity(points.strain_dim) + slope
    before = ufl.det(points.F)
    # by invariants of the gradient: a difference of two determinants loses digits of small strains
    growth = ufl.tr(slope)
    if points.strain_dim == 2:
        growth += ufl.det(slope)
    elif points.strain_dim == 3:
        growth += 0.5 * (growth**2 - ufl.tr(slope * slope)) + ufl.det(slope)
    return Kinematics(points, (1 + growth) * before, growth * before, inverse(dF))
