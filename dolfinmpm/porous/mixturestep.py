"""A step of a mixture: volume changes, gradients at its end, and rates of the water's volume.

Rates follow from the generalised-α method for first-order equations by Jansen, Whiting & Hulbert
(2000, doi 10.1016/S0045-7825(00)00203-6). A volume ζ of water changes by an outflow f. Forces
balance at the level s = α_f = 1/(1 + ρ∞) of a step, the same level as in Chung and Hulbert's method
for the motion. With α_m = (3 − ρ∞)/(2 (1 + ρ∞)),

    ζ̇_α + f(t_n + s Δt) = 0,    ζ̇_α = c r − (c − 1) ζ̇_n,    ζ̇_{n+1} = (1 + ρ∞) r − ρ∞ ζ̇_n,

where r = (ζ_{n+1} − ζ_n)/Δt and c = α_m/γ = (3 − ρ∞)/2. The method is of second order. Per step it
keeps the share ρ∞ of the fastest changes. Both hold with the inertia of soil and water too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import number
from dolfinmpm.body.axisymmetry import gradient, in_section
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.forms.inverse import inverse
from dolfinmpm.grid.constants import own_constant

__all__ = ["Kinematics", "Level", "kinematics"]


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


class Level:
    """The level in a step at which forces balance, and rates at this level.

    Increments in the form are increments from the start of the step to the level.

    Args:
        points: Material points; their `dt` is the time from the start of the step to the level (s).
        rho_inf: ρ∞, from 0 to 1.

    Attributes:
        share: s, the share of the step from its start to the level.
        whole: 1/s for UFL: factor from a change up to the level to a change in the whole step.
        weight: c.
    """

    def __init__(self, points: MaterialPoints, rho_inf: float):
        rho = number("rho_inf", rho_inf, 0.0, 1.0, closed=True)
        self.share, self.weight = 1.0 / (1.0 + rho), 0.5 * (3.0 - rho)
        self._points = points
        self.whole, self._kept, self._weight = (
            own_constant(points.grid, value) for value in (1.0 + rho, rho, self.weight)
        )

    def end(self, start: Expr, at_level: Expr) -> Expr:
        """Value at the end of a step, from the values at its start and at the level."""
        return start + self.whole * (at_level - start)

    def change(self, name: str, change: Expr, unit: str) -> tuple[Expr, CarriedField]:
        """Change up to the level, ζ̇_α s Δt, with the rate at the level; and the carried rate ζ̇.

        Args:
            name: Name of the field of the points for ζ̇.
            change: Change ζ_{n+1} − ζ_n in the whole step.
            unit: Unit of the rate.
        """
        points = self._points
        first: Any = np.zeros(change.ufl_shape)
        rate = CarriedField(points, name, change.ufl_shape, unit, first)
        mean = change / (self.whole * points.dt)
        rate.update = self.whole * mean - self._kept * rate
        at_level = self._weight * mean - (self._weight - 1) * rate
        return points.dt * at_level, rate
