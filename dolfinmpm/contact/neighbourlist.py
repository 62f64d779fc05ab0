"""A neighbour list: the points near a rigid body, listed once for many explicit steps."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.candidates import MARGIN
from dolfinmpm.contact.corners import CornerLayout, DisplacementBasis, Rows, longest
from dolfinmpm.contact.protocols import RigidContactTerm
from dolfinmpm.contact.tunnelling import travelled, within

__all__ = ["NeighbourList"]

Array = npt.NDArray[np.float64]


# Corners are searched within this multiple of the last motion of nodes and body, and within this
# many cells in addition
_SPARE, _LEAST = 2.0, 0.04


class NeighbourList:
    """Points that may touch a body until points and body have moved by a cell.

    The candidates of `ActiveRigidContact` in each of these steps are in the list.

    Args:
        contact: The contact.

    Attributes:
        contact: The argument.
        distance: Largest distance from the body of corners that can touch in this step (m);
            infinite if it is unknown.
        cell: Largest motion of a point across a cell in one direction (m).
    """

    _rows: Rows | None = None
    _left = 0.0

    def __init__(self, contact: RigidContactTerm):
        self.contact = contact

    def forget(self, displacement: DisplacementBasis, cell: Array) -> None:
        """List the points anew before the next step: points have changed, or their order.

        Args:
            displacement: The basis functions of the displacement.
            cell: Size of the smallest cell (m), shape (gdim,).
        """
        self._displacement, self._rows = displacement, None
        self.cell, self.distance = float(np.linalg.norm(cell)), math.inf
        self._bounded = self._layout().boxes
        # points that touched keep their forces until the end of the next step
        normal_forces = self.contact.points[self.contact.names.normal_force]
        self._held = np.unique(np.flatnonzero(normal_forces) // normal_forces.shape[1])

    def rows(self, path: float) -> Rows:
        """The points, increasing, with the body at the end of the step.

        Args:
            path: Expected largest path of nodes in the step (m).
        """
        body, contact = self.contact.body, self.contact
        of_body = self.body_path()
        if self._rows is None or self._left < of_body:
            self._rows, self._room = self._listed()
            self._left = self.cell
        self.distance = _SPARE * (of_body + path) + _LEAST * self.cell
        # only corners of domains move no further than nodes, and multipliers act at any distance
        if not self._bounded or contact.law.penetration is not None or body.time == 0.0:
            self.distance = math.inf
        if math.isinf(self.distance):
            return self._rows
        # since the points were listed they have come nearer by no more than the largest path
        return self._rows[self._room - (self.cell - self._left) <= self.distance]

    def travelled(self, path: float) -> bool:
        """Record the largest path of points and body in a step.

        Args:
            path: Largest path of a point plus that of the body (m).

        Returns:
            Whether no point outside the list can have reached the body.
        """
        self._left -= path
        return self._left >= 0.0

    def body_path(self) -> float:
        """Largest motion of the body in the step, at its present pose (m)."""
        body = self.contact.body
        endless = not np.isfinite(body.surface.low).all()
        if endless and np.any(body.pose.turn != body.start.turn):
            # the motion of an infinite surface that turns has no bound
            return math.inf
        return travelled(body.surface, body.start, body.pose)

    def keep(self, active: ActiveRigidContact) -> None:
        """Write the state of the contact at the end of a step to the points."""
        points, c = self.contact.points, active.corners
        for name, values in active.end_state():
            points[name][self._held] = 0.0
            points[name][c.rows, c.which] = values
        self._held = c.rows[active.now.normal != 0.0]

    def _layout(self) -> CornerLayout:
        contact = self.contact
        return CornerLayout(contact.points, self._displacement, contact.surface, contact.material)

    def _listed(self) -> tuple[Rows, Array]:
        """The points, and lower bounds of the distances of their corners from the body (m)."""
        points, body = self.contact.points, self.contact.body
        x, reach = points["x"], self._layout().reach()
        # corners that follow the material move away from their points as it is stretched
        limit = 2 * reach + MARGIN * longest(points["l0"]) + self.cell
        poses = [body.start, body.pose]
        rows = np.flatnonzero(within(poses, body.surface, x, limit[:, None]))
        first, last = (body.surface.probe(pose.back(x[rows]))[0] for pose in poses)
        near = np.minimum(first, last) < limit[rows]
        return rows[near], first[near] - reach[rows[near]]
