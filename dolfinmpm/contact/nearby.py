"""The points that are near a rigid body, listed once for many steps."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.active import MARGIN, ActiveContact, within
from dolfinmpm.contact.corners import Rows, Sight, Sites
from dolfinmpm.contact.rigid import travelled
from dolfinmpm.contact.terms import Contact

__all__ = ["Nearby"]

Array = npt.NDArray[np.float64]


class Nearby:
    """Points that may touch a body until it and they have gone a cell further.

    All that `ActiveContact` has to look at in one of these steps are among them.

    Args:
        contact: The contact.

    Attributes:
        contact: The argument.
        cell: The most that a point moves which crosses a cell in one direction (m).
    """

    _rows: Rows | None = None
    _left = 0.0

    def __init__(self, contact: Contact):
        self.contact = contact

    def forget(self, sight: Sight, cell: Array) -> None:
        """List the points anew before the next step: they are others, or in another order.

        Args:
            sight: How they see the displacement.
            cell: Size of the smallest cell (m), shape (gdim,).
        """
        self._sight, self._rows = sight, None
        self.cell = float(np.linalg.norm(cell))
        # what touched keeps forces until the end of the next step
        self._held = np.flatnonzero(self.contact.points[self.contact.names[1]].any(axis=1))

    def rows(self, distance: float) -> Rows:
        """The points, increasing, in a step that the body has been put to the end of.

        Args:
            distance: How near to the body corners are that can touch in this step (m).
        """
        if self._rows is None or self._left < self.way():
            self._rows, self._room = self._listed()
            self._left = self.cell
        if math.isinf(distance):
            return self._rows
        # since then points have come no nearer than all have gone
        return self._rows[self._room - (self.cell - self._left) <= distance]

    def travelled(self, way: float) -> bool:
        """Take note of how far points and body have gone in a step.

        Args:
            way: How far any of them has gone together with the body (m).

        Returns:
            Whether none that is not listed can have got to the body.
        """
        self._left -= way
        return self._left >= 0.0

    def way(self) -> float:
        """How far the body goes in the step, as it has been put now, at most (m)."""
        body = self.contact.body
        endless = not np.isfinite(body.surface.low).all()
        if endless and np.any(body.pose.turn != body.start.turn):
            # far away it goes as far as one likes
            return math.inf
        return travelled(body.surface, body.start, body.pose)

    def keep(self, active: ActiveContact) -> None:
        """Give the points what they keep of the contact at the end of a step."""
        points, c = self.contact.points, active.corners
        for name, values in active.kept():
            points[name][self._held] = 0.0
            points[name][c.rows, c.which] = values
        self._held = c.rows[active.pressures != 0.0]

    def _listed(self) -> tuple[Rows, Array]:
        """The points, and how far their corners are from the body at least (m)."""
        contact, points = self.contact, self.contact.points
        body, x = contact.body, points["x"]
        reach = Sites(points, self._sight, contact.surface, contact.material).reach()
        # corners that follow the material get further away as it is stretched
        limit = 2 * reach + MARGIN * points["l0"].max(axis=1, initial=0.0) + self.cell
        poses = [body.start, body.pose]
        rows = np.flatnonzero(within(poses, body.surface, x, limit[:, None]))
        first, last = (body.surface.probe(pose.back(x[rows]))[0] for pose in poses)
        near = np.minimum(first, last) < limit[rows]
        return rows[near], first[near] - reach[rows[near]]
