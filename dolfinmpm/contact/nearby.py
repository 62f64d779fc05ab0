"""The points that are near a rigid body, listed once for many steps."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.activecontact import ActiveContact
from dolfinmpm.contact.candidates import MARGIN
from dolfinmpm.contact.corners import Rows, Sight, Sites, longest
from dolfinmpm.contact.declared import DeclaredContact
from dolfinmpm.contact.passing import travelled, within

__all__ = ["Nearby"]

Array = npt.NDArray[np.float64]


# How much more than what nodes and body have gone in a step they may go in the next one before
# corners are looked for anew, and how far at least, in cells
_SPARE, _LEAST = 2.0, 0.04


class Nearby:
    """Points that may touch a body until it and they have gone a cell further.

    All that `ActiveContact` has to look at in one of these steps are among them.

    Args:
        contact: The contact.

    Attributes:
        contact: The argument.
        distance: How near to the body corners are that can touch in this step (m); infinite where
            that is not known.
        cell: The most that a point moves which crosses a cell in one direction (m).
    """

    _rows: Rows | None = None
    _left = 0.0

    def __init__(self, contact: DeclaredContact):
        self.contact = contact

    def forget(self, sight: Sight, cell: Array) -> None:
        """List the points anew before the next step: they are others, or in another order.

        Args:
            sight: How they see the displacement.
            cell: Size of the smallest cell (m), shape (gdim,).
        """
        self._sight, self._rows = sight, None
        self.cell, self.distance = float(np.linalg.norm(cell)), math.inf
        self._bounded = self._sites().boxes
        # what touched keeps forces until the end of the next step
        pressures = self.contact.points[self.contact.names[1]]
        self._held = np.unique(np.flatnonzero(pressures) // pressures.shape[1])

    def rows(self, way: float) -> Rows:
        """The points, increasing, in a step that the body has been put to the end of.

        Args:
            way: How far nodes may be expected to go in it (m).
        """
        body, contact = self.contact.body, self.contact
        of_body = self.way()
        if self._rows is None or self._left < of_body:
            self._rows, self._room = self._listed()
            self._left = self.cell
        self.distance = _SPARE * (of_body + way) + _LEAST * self.cell
        # other corners than those of domains may go further than nodes, multipliers act anywhere
        if not self._bounded or contact.penetration is not None or body.time == 0.0:
            self.distance = math.inf
        if math.isinf(self.distance):
            return self._rows
        # since then points have come no nearer than all have gone
        return self._rows[self._room - (self.cell - self._left) <= self.distance]

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

    def _sites(self) -> Sites:
        contact = self.contact
        return Sites(contact.points, self._sight, contact.surface, contact.material)

    def _listed(self) -> tuple[Rows, Array]:
        """The points, and how far their corners are from the body at least (m)."""
        points, body = self.contact.points, self.contact.body
        x, reach = points["x"], self._sites().reach()
        # corners that follow the material get further away as it is stretched
        limit = 2 * reach + MARGIN * longest(points["l0"]) + self.cell
        poses = [body.start, body.pose]
        rows = np.flatnonzero(within(poses, body.surface, x, limit[:, None]))
        first, last = (body.surface.probe(pose.back(x[rows]))[0] for pose in poses)
        near = np.minimum(first, last) < limit[rows]
        return rows[near], first[near] - reach[rows[near]]
