"""State and forces of contact points, and what all active contacts have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.assembly.term import ActiveTerm, NewState
from dolfinmpm.contact.contactlaw import FREE, SLIPS, STICKS
from dolfinmpm.contact.meanforces import MeanForceWeights

__all__ = ["ActiveContact", "ContactForces", "ContactStart", "CornerFields", "MarkerFields"]

Array = npt.NDArray[np.float64]


class CornerFields(NamedTuple):
    """Names of the points' fields that hold the state of contact with a rigid body.

    Attributes:
        tangential_force: Tangential forces on the corners in the frame of the body (N).
        normal_force: Normal forces on the corners (N).
        modulus: Young's modulus of the points in their first state (Pa).
        stiffness: Stiffness of touching corners (N/m).
        closing: Closing of the gaps of the corners in the last step (m).
        overlap: Overlap of the corners that fixed nodes leave (m), see `HeldCorners`.
        gap: Gaps of the corners at the end of the last step (m), see
            `dolfinmpm.contact.followedgaps`; 0 if the corner was far away.
        slip_area: Areas of touching corners for a limit of the shear stress (m^(d-1)), see
            `dolfinmpm.contact.sharedsurface`. Only with such a limit.
    """

    tangential_force: str
    normal_force: str
    modulus: str
    stiffness: str
    closing: str
    overlap: str
    gap: str
    slip_area: str


class MarkerFields(NamedTuple):
    """Names of the markers' fields that hold the state of contact of two bodies.

    Attributes:
        tangential_force, normal_force: Forces on the first body (N).
        work: Work dissipated by friction (J).
        steps: Number of steps.
        stored: Energy stored by the penalties (J).
        spare: Spare energy (J), see `dolfinmpm.contact.meanforces`.
        force: Forces on the first body (N), with their directions.
    """

    tangential_force: str
    normal_force: str
    work: str
    steps: str
    stored: str
    spare: str
    force: str


@dataclass
class ContactStart:
    """State of m contact points at the start of a step.

    Attributes:
        gap: Gaps (m), shape (m,).
        tangential: Tangential forces (N), shape (m, gdim).
        normal_force: Normal forces (N), shape (m,).
        stiffness: Penalties ε_N (N/m), shape (m,).
        multiplier: Multipliers of the normal force (N), shape (m,).
        closing: Closing of the gaps in the last step (m), shape (m,).
        limit: Largest forces of friction (N), besides those by its coefficient, shape (m,).
        water: Forces of the water in the pores, which do not rub (N), shape (m,).
        domains: Domains of the points that share the surface of a rigid body, see
            `dolfinmpm.contact.sharedsurface`, or None.
    """

    gap: Array
    tangential: Array
    normal_force: Array
    stiffness: Array
    multiplier: Array
    closing: Array
    limit: Array
    water: Array
    domains: tuple[Array, Array] | None = None


@dataclass
class ContactForces:
    """Forces on m contact points as last computed.

    Attributes:
        forces: Forces in the frame of the grid (N), shape (m, gdim).
        tangential: Tangential forces at the end of the step (N), shape (m, gdim), in the frame of
            the rigid body if there is one.
        normal: Normal forces (N), shape (m,).
        derivative: Derivatives of the forces by the positions (N/m), shape (m, gdim, gdim), in the
            frame of `tangential`.
        states: State of each point: FREE, STICKS, SLIPS or SHEARS, shape (m,).
        gap: Gaps that make the forces (m), shape (m,); infinite where no gap was computed.
        path: Paths of the points in the step, in the frame of the body (m), shape (m,).
        loss: Work dissipated by friction (J), shape (m,).
        closed: Closing of the gaps in the step (m), shape (m,).
    """

    forces: Array
    tangential: Array
    normal: Array
    derivative: Array
    states: npt.NDArray[np.int8]
    gap: Array
    path: Array
    loss: Array
    closed: Array

    @staticmethod
    def zero(m: int, d: int) -> ContactForces:
        """No forces on m points in d dimensions."""
        return ContactForces(
            np.zeros((m, d)), np.zeros((m, d)), np.zeros(m), np.zeros((m, d, d)),
            np.full(m, FREE, np.int8), np.full(m, np.inf), np.zeros(m), np.zeros(m), np.zeros(m),
        )  # fmt: skip

    def clear(self) -> None:
        """Set all forces to zero."""
        self.gap[:], self.states[:] = np.inf, FREE
        for values in (*self.by_law, self.closed):
            values[:] = 0.0

    @property
    def by_law(self) -> tuple[Array, ...]:
        """Arrays that the contact law fills: forces, tangential, normal, derivative."""
        return self.forces, self.tangential, self.normal, self.derivative


class ActiveContact(ActiveTerm):
    """Base of contacts: contact points with a state at the start of the step, and forces.

    `Operator` calls `touch` before each residual and tangent, `QuasiStatic` calls `augment` where
    forces balance and `record` after the step, and `new_state` calls `fault`.

    Attributes:
        contact: The contact of the form.
        mean_weights: Weights of mean forces over a step in its balance; None for forces at its end.
        start: State of the contact points at the start of the step.
        now: Forces on the contact points.
        clings: Whether a contact holds what touched before where nothing has moved yet, so that
            the first iteration of Newton's method takes it along with a body that goes away.
        pushes: Whether it moves the points by a motion of its own, as a rigid body does.
        depths: Largest penetrations at the augmentations of this substep (m).
    """

    kind = "contact"
    depths: Sequence[float] = ()
    clings: bool
    pushes: bool = False
    contact: Any
    mean_weights: MeanForceWeights | None
    start: ContactStart
    now: ContactForces

    @property
    def forces(self) -> Array:
        """Last computed forces on the contact points (N), shape (m, gdim)."""
        return self.now.forces

    @property
    def states(self) -> npt.NDArray[np.int8]:
        """States of the contact points (FREE, STICKS, SLIPS or SHEARS), shape (m,)."""
        return self.now.states

    @property
    def count(self) -> tuple[int, int]:
        """Numbers of points of this rank that stick, or touch without friction, and that slip."""
        return int(np.sum(self.states == STICKS)), int(np.sum(self.states >= SLIPS))

    @property
    def force_weight(self) -> float:
        """Weight of the forces in a step's balance."""
        return 1.0 if self.mean_weights is None else self.mean_weights.weight

    @property
    def tangent_weight(self) -> float:
        """Weight of derivatives of forces by the increments in a step's balance."""
        weights = self.mean_weights
        return 1.0 if weights is None else weights.weight * weights.scale

    def touch(self, u: Sequence[Array], scale: float) -> None:
        """Find the forces at the increments, where rigid bodies are now.

        Args:
            u: Nodal increments, shape (nodes, components) for each field.
            scale: These increments by those at the level where forces balance.
        """
        raise NotImplementedError

    def fault(self, new: NewState) -> str | None:
        """Why a state cannot be taken, the same on all ranks, or None. Collective."""
        raise NotImplementedError

    def record(self) -> dict[str, dict[str, list[float]]]:
        """What the record of a step has of it in `bodies`, by its name. Collective."""
        return {}

    def augment(self) -> bool:
        """Take normal forces for multipliers if a penetration exceeds the bound. Collective.

        Returns:
            Whether a penetration exceeded the bound, so that balance must be found again.
        """
        bound = self.contact.law.penetration
        if bound is None:
            return False
        deepest = float(-self.now.gap.min(initial=0.0))
        deepest = self.contact.points.comm.allreduce(deepest, op=MPI.MAX)
        self.depths = [*self.depths, deepest]
        if deepest <= bound:
            return False
        self.start.multiplier = self.now.normal.copy()
        return True
