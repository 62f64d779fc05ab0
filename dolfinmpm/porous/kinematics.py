"""What a step's increment does to the volumes that hold water, and to gradients."""

from __future__ import annotations

from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

from dolfinmpm.body.axisymmetry import gradient, in_section
from dolfinmpm.body.points import MaterialPoints

__all__ = ["Kinematics", "kinematics"]


@dataclass(frozen=True)
class Kinematics:
    """What a step's increment does to volumes and gradients.

    Attributes:
        points: Material points.
        J: det F at the end of the step.
        growth: J less that at the start of the step.
        inverse: From gradients at the start of the step to spatial ones at its end.
    """

    points: MaterialPoints
    J: Expr | float
    growth: Expr
    inverse: Expr | None

    def grad(self, w: Expr) -> Expr:
        """Spatial gradient at the end of the step, with any hoop term; see `gradient`."""
        points, inverse = self.points, self.inverse
        if w.ufl_shape == ():
            slope = ufl.grad(w)
            inverse = inverse if inverse is None else in_section(points, inverse)
        else:
            slope = gradient(points, w)
        return slope if inverse is None else ufl.dot(slope, inverse)

    def spatial(self, slope: Expr) -> Expr:
        """Gradient of a scalar at the end of the step, from that by positions at its start."""
        inverse = self.inverse
        return slope if inverse is None else ufl.dot(slope, in_section(self.points, inverse))


def kinematics(
    points: MaterialPoints, u: Expr, strain: str, factor: Expr | None = None
) -> Kinematics:
    """What a step's increment does to volumes and gradients, by the measure of strain.

    Args:
        points: Material points.
        u: The increment.
        strain: Measure of strain.
        factor: What it is multiplied by, or None.
    """
    slope = gradient(points, u)
    if factor is not None:
        slope = factor * slope
    if strain == "small":
        return Kinematics(points, 1.0, ufl.tr(slope), None)
    dF = ufl.Identity(points.strain_dim) + slope
    before = ufl.det(points.F)
    # by invariants, for the difference of two determinants would lose small strains
    growth = ufl.tr(slope)
    if points.strain_dim == 2:
        growth += ufl.det(slope)
    elif points.strain_dim == 3:
        growth += 0.5 * (growth**2 - ufl.tr(slope * slope)) + ufl.det(slope)
    return Kinematics(points, (1 + growth) * before, growth * before, ufl.inv(dF))
