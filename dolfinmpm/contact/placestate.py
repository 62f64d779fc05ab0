"""Numbers of the places that may touch: what they have at the start of a step, and its forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.penalty import FREE

__all__ = ["PlaceForces", "PlaceStart"]

Array = npt.NDArray[np.float64]


@dataclass
class PlaceStart:
    """What m places have at the start of a step.

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
    """Forces on m places, as they were last found.

    Attributes:
        forces: Forces (N), shape (m, gdim).
        traction: Forces along the surface at the end of the step (N), likewise.
        pressures: Normal forces (N), shape (m,).
        slope: Derivative of the forces by the places (N/m), shape (m, gdim, gdim).
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
