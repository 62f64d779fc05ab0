"""What places that may touch must know of the contact that a form declares."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surface import Surface
from dolfinmpm.contact.means import Means
from dolfinmpm.contact.rigid import RigidBody

__all__ = ["DeclaredBetween", "DeclaredContact"]


class DeclaredContact(Protocol):
    """A contact with a rigid body, see `dolfinmpm.contact.contactterm.Contact`."""

    body: RigidBody
    points: MaterialPoints
    u: Any
    surface: Surface | None
    material: bool
    tags: Tags
    friction: float
    slip_share: float
    penetration: float | None
    names: tuple[str, ...]
    dissipated: float
    means: Means | None
    in_time: bool
    limit: float

    def chosen(self, rows: Any = slice(None)) -> npt.NDArray[np.bool_]:
        """Which points, of some rows or of all, have its tags."""

    def stiffness_at(self, rows: npt.NDArray[np.integer]) -> npt.NDArray[np.float64]:
        """Penalty per area at some points (Pa/m), shape (len(rows),)."""


class DeclaredBetween(Protocol):
    """A contact of two bodies, see `dolfinmpm.contact.between.Between`."""

    boundaries: tuple[Boundary, Boundary]
    u: tuple[Any, Any]
    friction: float
    stiffness: float
    slip_share: float
    penetration: float | None
    name: str
    names: tuple[str, ...]

    @property
    def points(self) -> MaterialPoints:
        """The points of both bodies."""

    @property
    def begun(self) -> bool:
        """Whether a step has been taken. Collective."""

    def check_sides(self) -> None:
        """Raise unless each boundary has its body behind it. Collective."""
