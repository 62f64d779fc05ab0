"""Newmark's family of rules, and the terms of implicit steps that follow from a rule.

A rule gives velocities and accelerations from the increment of a step. So inertia and dashpots are
terms of the increments, outside the weak form.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from dolfinmpm.assembly.stencilsums import add_product
from dolfinmpm.assembly.term import ActiveTerm
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.dynamics.nodalmass import Mass

__all__ = ["Dashpots", "Inertia", "NewmarkRule"]

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

    def level_velocity(self, u: Array, V: Array, A: Array, dt: float) -> Array:
        """Velocities at the level of balance (m/s), by the increments of the whole step."""
        end = self.velocity(V, A, self.acceleration(u, V, A, dt), dt)
        return np.asarray((1 - self.alpha_f) * end + self.alpha_f * V)

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


class Inertia(ActiveTerm):
    """Inertial forces M a, and penalties on the change of velocity in a step.

    Accelerations are a linear function of the increments, a = factor u + known. Penalties act on
    u − expected, the increments beyond those by the velocities at the start.

    Args:
        here: The activation.
        masses: Number of a field that moves points → its mass.
        factor: Derivative of the accelerations by the increments (1/s²).
        known: Number of the field → other part of the accelerations (m/s²), shape (nodes, d).
        expected: Number of the field → increments without penalty (m), shape (nodes, d).
    """

    kind, is_load = "inertia", False

    def __init__(
        self,
        here: Activation,
        masses: Mapping[int, Mass],
        factor: float,
        known: Mapping[int, Array],
        expected: Mapping[int, Array],
    ):
        self._known, self._expected = known, expected
        self._masses = [b for mass in masses.values() for b in mass.blocks]
        self._changes = here.blocks_of("changes")
        inertial = [replace(b, values=factor * b.values) for b in self._masses]
        self.stiffness = [*self._changes, *inertial]

    def external(self, out: Sequence[Array]) -> None:
        """See `ActiveTerm`. M times the known accelerations acts like a load."""
        for b in self._masses:
            add_product(b, self._on_all(self._known, out), out)
        for b in self._changes:
            add_product(replace(b, values=-b.values), self._on_all(self._expected, out), out)

    @staticmethod
    def _on_all(given: Mapping[int, Array], out: Sequence[Array]) -> list[Array]:
        """Nodal values of all fields, with zeros for fields without values."""
        return [given.get(k, np.zeros_like(force)) for k, force in enumerate(out)]


class Dashpots(ActiveTerm):
    """Dashpots on the nodes of the first field.

    Args:
        blocks: Derivative of the forces by the increments.
        start: Part of the forces without the increments (N), shape (nodes, d).
        owned: Nodes of this rank.
    """

    kind, is_load = "inertia", False

    def __init__(self, blocks: Blocks, start: Array, owned: npt.NDArray[np.int32]):
        self.stiffness, self._start, self._owned = [blocks], start, owned

    def external(self, out: Sequence[Array]) -> None:
        """See `ActiveTerm`."""
        out[0][self._owned] += self._start[self._owned]
