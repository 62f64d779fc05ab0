"""Conditions and sides of the grid that act on each of several bodies at the nodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinmpm.cut.activation import Activation
from dolfinmpm.dynamics.collision import BodyAtNodes
from dolfinmpm.dynamics.facesatnodes import Faces
from dolfinmpm.dynamics.kinks import Kinks

__all__ = ["BodiesAtSides"]

Array = npt.NDArray[np.float64]


class BodiesAtSides:
    """What conditions and sides of the grid do to the nodes of each body in an explicit step.

    Args:
        faces: Sides that act on the bodies, or None.
        bodies: Nodal sums of each body.
        here: The activation.
        held: Prescribed velocities (m/s), shape (nodes, d).
        kick: Time during which forces act (s).
        kinks: Where the nodes that touch and slip are kept, or None.
    """

    def __init__(
        self,
        faces: Faces | None,
        bodies: Sequence[BodyAtNodes],
        here: Activation,
        held: Array,
        kick: float,
        kinks: Kinks | None,
    ):
        unknowns = here.unknowns.fields[0]
        self._faces, self._bodies, self._held = faces, bodies, held
        self._kick, self._kinks = kick, kinks
        self._fixed, self._owned = unknowns.fixed, unknowns.owned_nodes
        self._moving = np.zeros_like(self._fixed)
        if here.driven:
            own = self._owned
            self._moving[own] = self._fixed[own] & (held[own] != 0.0)
        # velocities taken by frictional sides, and by dashpots
        self._stopped: list[Array] = [np.zeros_like(held) for _ in bodies]
        self._absorbed: list[Array] = []

    def hold(self, velocities: Sequence[Array]) -> None:
        """Set the velocities of prescribed components (m/s), shape (nodes, d) per body."""
        for V in velocities:
            V[self._fixed] = self._held[self._fixed]

    def absorb(self, velocities: Sequence[Array]) -> None:
        """Apply dashpots. Bodies at one node share a dashpot in proportion to their masses.

        Args:
            velocities: Velocities of each body (m/s), shape (nodes, d) each. Changed.
        """
        if self._faces is None or self._faces.dashpots is None:
            return
        m = sum(body.mass for body in self._bodies)
        rate = self._kick * self._faces.dashpots / np.where(m > 0.0, m, np.inf)[:, None]
        for V in velocities:
            V /= 1.0 + rate
            # no side acts on what a condition holds
            self._absorbed.append(np.where(self._fixed, 0.0, rate * V))

    def stop(self, velocities: Sequence[Array]) -> float:
        """Apply frictional sides and conditions.

        A second call in a step acts on what both calls have found: its friction may reach the limit
        by the whole impulse of the side.

        Args:
            velocities: Velocities of each body at the end of the step (m/s), shape (nodes, d) each.
                Changed.

        Returns:
            Work of the prescribed motions at nodes of this rank (J).
        """
        work, moving, held = 0.0, self._moving, self._held
        for body, V, stopped in zip(self._bodies, velocities, self._stopped):
            if self._faces is not None:
                V += stopped
                stopped[:] = V
                self._faces.rub(V, self._kinks)
                stopped -= V
                stopped[self._fixed] = 0.0
            m = np.broadcast_to(body.mass[:, None], V.shape)[moving]
            work += float(np.sum(m * (held[moving] - V[moving]) * held[moving]))
        self.hold(velocities)
        return work

    def settle(self, mapped: Sequence[Array]) -> None:
        """Hold nodes that frictional sides have stopped, see `Faces.settle`.

        Args:
            mapped: Velocities mapped from the points of each body (m/s), shape (nodes, d) each.
                Changed.
        """
        if self._faces is None:
            return
        for V, stopped in zip(mapped, self._stopped):
            self._faces.settle(stopped, V, self._kinks)
        self.hold(mapped)

    def losses(self, strains: Sequence[Array], dt: float) -> Array:
        """Works taken by frictional sides and by dashpots, at nodes of this rank (J), shape (2,).

        Args:
            strains: Velocities by which each body strains (m/s), shape (nodes, d) each.
            dt: Length of the step (s).
        """
        taken = np.zeros(2)
        for k, arrays in enumerate((self._stopped, self._absorbed)):
            for body, V, one in zip(self._bodies, strains, arrays):
                taken[k] += np.sum((body.mass[:, None] * one * V)[self._owned])
        return dt / self._kick * taken
