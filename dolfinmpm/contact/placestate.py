"""Numbers of the places that may touch: what they have at the start of a step, and its forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.assembly.term import ActiveTerm
from dolfinmpm.contact.penalty import FREE, SLIPS, STICKS

__all__ = ["ContactPlaces", "PlaceForces", "PlaceStart"]

Array = npt.NDArray[np.float64]


@dataclass
class PlaceStart:
    """State of m places at the start of a step.

    Attributes:
        gap: Gaps (m), shape (m,).
        traction: Forces along the surface (N), shape (m, gdim).
        pressure: Normal forces (N), shape (m,).
        stiffness: Penalties (N/m), likewise.
        multiplier: Multipliers of the normal force (N), likewise.
        areas: Areas (m^(d-1)), likewise.
        closing: By how much gaps have closed in the last step (m), likewise.
    """

    gap: Array
    traction: Array
    pressure: Array
    stiffness: Array
    multiplier: Array
    areas: Array
    closing: Array


@dataclass
class PlaceForces:
    """Last computed forces on m places.

    Attributes:
        forces: Forces in the frame of the grid (N), shape (m, gdim).
        traction: Forces along the surface at the end of the step (N), in the frame of the rigid
            body if there is one, shape (m, gdim).
        pressures: Normal forces (N), shape (m,).
        slope: Derivative of the forces by the places (N/m), in the frame of traction, shape
            (m, gdim, gdim).
        states: Whether places are free, stick or slip, shape (m,).
        gap: Gaps (m), likewise; infinite where nobody looked.
        way: How far places have gone in the frame of the body (m), likewise.
        loss: Work that friction takes (J), likewise.
        closed: By how much gaps have closed in the step (m), likewise.
    """

    forces: Array
    traction: Array
    pressures: Array
    slope: Array
    states: npt.NDArray[np.int8]
    gap: Array
    way: Array
    loss: Array
    closed: Array

    @staticmethod
    def nothing(m: int, d: int) -> PlaceForces:
        """No forces on m places in d dimensions."""
        return PlaceForces(
            np.zeros((m, d)), np.zeros((m, d)), np.zeros(m), np.zeros((m, d, d)),
            np.full(m, FREE, np.int8), np.full(m, np.inf), np.zeros(m), np.zeros(m), np.zeros(m),
        )  # fmt: skip

    def clear(self) -> None:
        """Take all forces away."""
        self.gap[:], self.states[:] = np.inf, FREE
        for values in (self.forces, self.pressures, self.traction, self.slope, self.closed):
            values[:] = 0.0

    @property
    def by_law(self) -> tuple[Array, ...]:
        """What the law of contact gives of each place: forces, traction, pressures, slope."""
        return self.forces, self.traction, self.pressures, self.slope


class ContactPlaces(ActiveTerm):
    """Base of contacts: places with a state at the start of the step, and forces on the places.

    Attributes:
        contact: The contact, as the form declares it.
        start: State of the places at the start of the step.
        found: Forces on the places.
    """

    kind = "contact"
    contact: Any
    start: PlaceStart
    found: PlaceForces

    @property
    def forces(self) -> Array:
        """Last computed forces on the places (N), shape (m, gdim)."""
        return self.found.forces

    @property
    def pressures(self) -> Array:
        """Normal parts of the forces (N), shape (m,)."""
        return self.found.pressures

    @property
    def states(self) -> npt.NDArray[np.int8]:
        """States of the places (free, sticking or slipping), shape (m,)."""
        return self.found.states

    @property
    def count(self) -> tuple[int, int]:
        """Numbers of places of this rank that stick, or touch without friction, and that slip."""
        return int(np.sum(self.states == STICKS)), int(np.sum(self.states == SLIPS))

    def augment(self) -> bool:
        """See `ActiveTerm`: normal forces become multipliers where places are too deep. Collective.

        Returns:
            Whether a place was too deep, so that balance must be found again.
        """
        bound = self.contact.penetration
        if bound is None:
            return False
        deepest = float(-self.found.gap.min(initial=0.0))
        deepest = self.contact.points.comm.allreduce(deepest, op=MPI.MAX)
        if deepest <= bound:
            return False
        self.start.multiplier = self.pressures.copy()
        return True
