"""Interfaces of contact terms, as active contacts use them."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surface import Surface
from dolfinmpm.contact.contactlaw import ContactLaw
from dolfinmpm.contact.meanforces import MeanForceWeights
from dolfinmpm.contact.rigidbody import RigidBody

__all__ = ["CornerFields", "MarkerFields", "RigidContactTerm", "TwoBodyContactTerm"]


class CornerFields(NamedTuple):
    """Names of the points' fields that hold the state of contact with a rigid body.

    Attributes:
        tangential_force: Tangential forces on the corners in the frame of the body (N).
        normal_force: Normal forces on the corners (N).
        modulus: Young's modulus of the points in their first state (Pa).
        stiffness: Stiffness of touching corners (N/m).
        closing: Closing of the gaps of the corners in the last step (m).
    """

    tangential_force: str
    normal_force: str
    modulus: str
    stiffness: str
    closing: str


class MarkerFields(NamedTuple):
    """Names of the markers' fields that hold the state of contact of two bodies.

    Attributes:
        tangential_force, normal_force: Forces on the first body (N).
        work: Work dissipated by friction (J).
        steps: Number of steps.
        stored: Energy stored by the penalties (J).
        spare: Spare energy (J), see `dolfinmpm.contact.storedenergy`.
    """

    tangential_force: str
    normal_force: str
    work: str
    steps: str
    stored: str
    spare: str


class RigidContactTerm(Protocol):
    """Contact with a rigid body, see `dolfinmpm.contact.rigidcontact.RigidContact`."""

    body: RigidBody
    points: MaterialPoints
    u: Any
    surface: Surface | None
    material: bool
    tags: Tags
    law: ContactLaw
    names: CornerFields
    dissipated: float
    means: MeanForceWeights | None
    in_time: bool
    limit: float

    def chosen(self, rows: Any = slice(None)) -> npt.NDArray[np.bool_]:
        """Which of the given points, or of all points, have the tags of the contact."""

    def stiffness_at(self, rows: npt.NDArray[np.integer]) -> npt.NDArray[np.float64]:
        """Penalty per area at some points (Pa/m), shape (len(rows),)."""


class TwoBodyContactTerm(Protocol):
    """Contact of two bodies, see `dolfinmpm.contact.twobodycontact.TwoBodyContact`."""

    boundaries: tuple[Boundary, Boundary]
    u: tuple[Any, Any]
    law: ContactLaw
    stiffness: float
    name: str
    names: MarkerFields

    @property
    def points(self) -> MaterialPoints:
        """The points of both bodies."""

    @property
    def begun(self) -> bool:
        """Whether at least one step has been taken. Collective."""

    def check_sides(self) -> None:
        """Raise unless each boundary has its body behind it. Collective."""
