"""Tractions of a wall on a body in UFL: at the end of a step, and in the mean over a step in time.

The formulas are in `dolfinmpm.kinematics.walls`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl
from ufl.core.expr import Expr

__all__ = ["WallTractions"]


@dataclass(frozen=True)
class WallTractions:
    """The fields of a wall at its markers, and the tractions that follow from an increment.

    Attributes:
        normal, area: Normal out of the body's room, and area of the markers (m^(d−1)).
        on: 1 where the body is in front, else 0.
        gap, shear, rubbed: At the start of the step: gap (m), shear traction (Pa), work of friction
            so far (J).
        k, stick: Stiffnesses of contact and against slip (Pa/m).
        friction: Coefficient μ; None for a smooth wall.
        still: Slip that has no direction (m).
        weight: Weight of the mean traction in the balance; 0 for the traction at the end.
    """

    normal: Expr
    area: Expr
    on: Expr
    gap: Expr
    shear: Expr
    rubbed: Expr
    k: Expr
    stick: Expr
    friction: Expr | None
    still: Expr
    weight: Expr

    def _chosen(self, mean: Any, end: Any) -> Any:
        """What belongs to the mean over the step, or to its end."""
        return _either(ufl.gt(self.weight, 0.0), mean, end)

    def _pressures(self, u: Expr) -> tuple[Any, Any, Any]:
        """Gap at the end of the step (m), and pressures at its end and in the mean (Pa)."""
        first = self.on * self.gap
        last = self.on * (self.gap + ufl.dot(self.normal, u))
        # a body that just touches is pushed back from the first iteration on
        end = self.k * ufl.conditional(ufl.ge(last, 0.0), last, 0.0)
        return last, end, self.k * _mean(first, last)

    def _returned(self, trial: Expr, p: Expr, just: Any = None) -> tuple[Any, Any]:
        """The shear traction under a pressure (Pa), and whether the marker slips.

        Args:
            trial: Shear traction of a marker that sticks (Pa).
            p: Pressure (Pa).
            just: Where a marker without pressure touches. It sticks until it moves, for otherwise
                nothing but friction would hold a body that is about to be pressed on.
        """
        least = self.stick * self.still
        size, bound = ufl.sqrt(ufl.dot(trial, trial) + least**2), self.friction * p
        slips = ufl.gt(size, bound)
        if just is not None:
            rests = ufl.And(ufl.eq(ufl.dot(trial, trial), 0.0), just)
            slips = ufl.And(slips, ufl.Not(rests))
        # the traction is continuous at the bound, so that Newton's method takes either branch
        held = self.on * ufl.conditional(slips, bound / size, 1.0) * trial
        return held, self.on * ufl.conditional(slips, 1.0, 0.0)

    def _trials(self, u: Expr) -> tuple[Any, Any]:
        """Shear tractions of markers that stick (Pa): in the mean over the step, and at its end."""
        change = self.stick * (u - ufl.dot(self.normal, u) * self.normal)
        return self.shear - 0.5 * change, self.shear - change

    def mean_or_end(self, u: Expr) -> Any:
        """The traction (Pa) in the mean over the step, or at its end.

        Args:
            u: Increment of the whole step (m).
        """
        last, p_end, p_mean = self._pressures(u)
        mean, end = -p_mean * self.normal, -p_end * self.normal
        if self.friction is not None:
            trial_mean, trial_end = self._trials(u)
            mean += self._returned(trial_mean, p_mean)[0]
            end += self._returned(trial_end, p_end, ufl.ge(last, 0.0))[0]
        return self._chosen(mean, end)

    def in_balance(self, u: Expr) -> Any:
        """The traction with its weight in the balance of forces (Pa)."""
        return self._chosen(self.weight, 1.0) * self.mean_or_end(u)

    def new_fields(self, u: Expr) -> dict[str, Any]:
        """Fields at the end of the step, by name: gap, and with friction shear, slips, rubbed.

        Args:
            u: Increment of the whole step (m).
        """
        last, p_end, p_mean = self._pressures(u)
        if self.friction is None:
            return {"gap": last}
        (trial_mean, trial_end), t = self._trials(u), self.shear
        mean, slips = self._returned(trial_mean, p_mean)
        end, slips_at_end = self._returned(trial_end, p_end)
        stick = ufl.conditional(ufl.gt(self.stick, 0.0), self.stick, 1.0)
        touches = ufl.gt(last, 0.0)
        # the work is that of the mean traction on slip without that of the stiffness
        rubbed = 2.0 * ufl.dot(mean, trial_mean - mean) / stick
        # what lifts off loses the energy of the stiffness, too
        lifts = ufl.dot(mean, 2.0 * (trial_mean - t)) + 0.5 * ufl.dot(t, t)
        rubbed = ufl.conditional(touches, rubbed, lifts / stick)
        rubbed_at_end = 0.5 * ufl.dot(t + end, trial_end - end) / stick
        return {
            "gap": last,
            "shear": self._chosen(_either(touches, 2.0 * mean - t, 0.0 * t), end),
            "slips": self._chosen(slips, slips_at_end),
            "rubbed": self.rubbed + self.area * self._chosen(rubbed, rubbed_at_end),
        }


def _either(condition: Any, true: Any, false: Any) -> Any:
    """A conditional of numbers or vectors."""
    if ufl.shape(true) == ():
        return ufl.conditional(condition, true, false)
    parts = range(ufl.shape(true)[0])
    return ufl.as_vector([ufl.conditional(condition, true[i], false[i]) for i in parts])


def _mean(q0: Expr, q1: Expr) -> Any:
    """(⟨q₁⟩² − ⟨q₀⟩²) / (2 (q₁ − q₀)), without a division of zeros."""
    apart = ufl.conditional(ufl.eq(q1, q0), 1.0, 2.0 * (q1 - q0))
    returns = ufl.conditional(ufl.gt(q1, 0.0), q1**2 / apart, 0.0)
    leaves = ufl.conditional(ufl.ge(q1, 0.0), 0.5 * (q0 + q1), -(q0**2) / apart)
    return ufl.conditional(ufl.ge(q0, 0.0), leaves, returns)
