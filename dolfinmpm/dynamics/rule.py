"""Newmark's family of rules: velocities and accelerations from the increment of a step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Rule"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Rule:
    """Parameters of a rule of Newmark's family, with α_m = α_f = 0 Newmark's own.

    Attributes:
        beta, gamma, alpha_m, alpha_f: See `dolfinmpm.dynamics.newmark`.
        by_forces: Whether each step begins with the accelerations that the forces give, M a = f.
            Else these are means of those that the points have from the last step, which have lost
            what does not vary smoothly, and energy with it.
    """

    beta: float
    gamma: float
    alpha_m: float = 0.0
    alpha_f: float = 0.0
    by_forces: bool = False

    def acceleration(self, u: Array, V: Array, A: Array, dt: float) -> Array:
        """a' at the nodes (m/s²)."""
        return (u - dt * V) / (self.beta * dt**2) - (0.5 / self.beta - 1.0) * A

    def velocity(self, V: Array, A: Array, A_end: Array, dt: float) -> Array:
        """v' at the nodes (m/s)."""
        return V + dt * ((1 - self.gamma) * A + self.gamma * A_end)

    def pushed(self, V_end: Array, A_end: Array, push: Array, dt: float) -> tuple[Array, Array]:
        """v' and a' where contact has pushed besides, by its mean accelerations (m/s²).

        Its impulse is that of the whole step, and accelerations go on without it.

        Args:
            V_end, A_end: Those that `velocity` and `acceleration` give of the increment.
            push: M⁻¹ times the mean forces.
            dt: Length of the step (s).
        """
        V_end = V_end + dt * (1.0 - 0.5 * self.gamma / self.beta) * push
        return V_end, A_end - 0.5 / self.beta * push

    def known(self, V: Array, A: Array, dt: float) -> Array:
        """What of the accelerations at the level of balance does not depend on the increment."""
        start = V / (self.beta * dt) + (0.5 / self.beta - 1.0) * A
        return self.alpha_m * A - (1 - self.alpha_m) * start

    def factor(self, dt: float) -> float:
        """Its derivative by the increment at that level (1/s²)."""
        return (1 - self.alpha_m) / (self.beta * dt**2 * (1 - self.alpha_f))
