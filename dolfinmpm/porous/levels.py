"""Rates of the water's volume by the generalised-α method of first-order equations.

Jansen, Whiting & Hulbert (2000, doi 10.1016/S0045-7825(00)00203-6): of a volume ζ that flows off
by f, with the level s = α_f = 1/(1 + ρ∞) of a step at whose end forces balance, which is that of
Chung and Hulbert's method for the motion, and α_m = (3 − ρ∞)/(2 (1 + ρ∞)),

    ζ̇_α + f(t_n + s Δt) = 0,    ζ̇_α = c r − (c − 1) ζ̇_n,    ζ̇_{n+1} = (1 + ρ∞) r − ρ∞ ζ̇_n,

where r = (ζ_{n+1} − ζ_n)/Δt and c = α_m/γ = (3 − ρ∞)/2. It is of second order, and keeps the share
ρ∞ of what changes fastest, with the inertia of soil and water too.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import number
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.grid.constants import own_constant

__all__ = ["Level"]


class Level:
    """Where in a step forces balance, and how rates are there. Increments are those up to there.

    Args:
        points: Material points, whose `dt` is the time up to there.
        rho_inf: ρ∞.

    Attributes:
        share: s, the share of the step up to there.
        whole: 1/s for UFL, by which what changes up to there is what changes in the step.
        weight: c.
    """

    def __init__(self, points: MaterialPoints, rho_inf: float):
        rho = number("rho_inf", rho_inf, 0.0, 1.0, closed=True)
        self.share, self.weight = 1.0 / (1.0 + rho), 0.5 * (3.0 - rho)
        self._points = points
        self.whole, self._kept, self._weight = (
            own_constant(points.grid, value) for value in (1.0 + rho, rho, self.weight)
        )

    def end(self, before: Expr, here: Expr) -> Expr:
        """What is at the end of a step, of what was at its start and is at the level."""
        return before + self.whole * (here - before)

    def change(self, name: str, change: Expr, unit: str) -> tuple[Expr, CarriedField]:
        """What changes up to the level at the rate that is there, ζ̇_α s Δt; and ζ̇ as it is carried.

        Args:
            name: Name of the field of the points that has ζ̇.
            change: Change in the whole step.
            unit: Unit of the rate.
        """
        points = self._points
        first: Any = np.zeros(change.ufl_shape)
        rate = CarriedField(points, name, change.ufl_shape, unit, first)
        mean = change / (self.whole * points.dt)
        rate.update = self.whole * mean - self._kept * rate
        here = self._weight * mean - (self._weight - 1) * rate
        return points.dt * here, rate
