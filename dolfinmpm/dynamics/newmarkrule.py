"""Newmark's family of rules: velocities and accelerations from the increment of a step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["NewmarkRule"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class NewmarkRule:
    """Parameters of a rule of Newmark's family, with α_m = α_f = 0 Newmark's own.

    Attributes:
        beta, gamma, alpha_m, alpha_f: See `dolfinmpm.dynamics.newmark`.
        by_forces: Whether accelerations at the start of each step follow from the forces, M a = f.
            Else they are mapped from the points. The mapping smooths them, and so loses energy.
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

    def with_contact(
        self, V_end: Array, A_end: Array, push: Array, dt: float
    ) -> tuple[Array, Array]:
        """v' (m/s) and a' (m/s²) with the mean accelerations by contact.

        The impulse of contact is that of the whole step. The new accelerations do not contain it.

        Args:
            V_end, A_end: Results of `velocity` and `acceleration`.
            push: M⁻¹ times the mean forces of contact (m/s²).
            dt: Length of the step (s).
        """
        V_end = V_end + dt * (1.0 - 0.5 * self.gamma / self.beta) * push
        return V_end, A_end - 0.5 / self.beta * push

    def known(self, V: Array, A: Array, dt: float) -> Array:
        """Part of the accelerations at the level of balance without the increment (m/s²)."""
        start = V / (self.beta * dt) + (0.5 / self.beta - 1.0) * A
        return self.alpha_m * A - (1 - self.alpha_m) * start

    def factor(self, dt: float) -> float:
        """Derivative of these accelerations by the increment at this level (1/s²)."""
        return (1 - self.alpha_m) / (self.beta * dt**2 * (1 - self.alpha_f))
