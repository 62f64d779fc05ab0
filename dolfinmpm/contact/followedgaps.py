"""Gaps that contact follows from step to step, in steps in time.

In steps in time, force and motion of a contact point must be conjugate, or contact makes energy. A
corner of a domain stands for a part of the domain's face. Its forces reach the nodes by the
averages of the functions over this part. So they are in balance with the stress of the point, and
keep the angular momentum. By the same averages the corner moves. The face itself follows the
position and the domain of the point. It moves a little otherwise: by value and gradient at the
point, and without rotation. So the gap of a corner that touches is the one to which its motion has
led, not that of the face. When the corner touches no more and the face is outside of the body, the
gap is that of the face again.

In soil that flows past a body the two gaps would drift apart. A corner then moves with the domain
of its point by a growing share w, and with all of it where the gaps differ by a fifth of the
domain's half-length l:

    w = (|g − g_face|/l − a)/(b − a) within [0, 1],  a = 0.05,  b = 0.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.surfaces import Probe

if TYPE_CHECKING:
    from dolfinmpm.contact.heldcorners import HeldCorners
    from dolfinmpm.contact.rigidcontact import RigidContact

__all__ = ["FollowedGaps"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.integer]

# Differences of the gaps, in half-lengths of the domain: up to the first one a corner moves with
# its face alone, from the second one on with its domain
_FACE, _DOMAIN = 0.05, 0.2


@dataclass(frozen=True)
class FollowedGaps:
    """Gaps of the corners of a contact that are followed from step to step.

    Attributes:
        beyond: Gaps of the corners less those of their faces at the start of the step (m), shape
            (m,).
        share: Shares w by which they move with their domains, shape (m,).
    """

    beyond: Array
    share: Array

    @staticmethod
    def of(contact: RigidContact, rows: Rows, which: Rows, gap: Array) -> FollowedGaps:
        """The followed gaps at the start of a step.

        Args:
            contact: The contact.
            rows, which: Point of each corner, and number at its point, shape (m,).
            gap: Gaps of the parts of faces (m), shape (m,).
        """
        points, names = contact.points, contact.names
        last = points[names.gap][rows, which]
        goes_on = (last != 0.0) & ((points[names.normal_force][rows, which] > 0.0) | (gap < 0.0))
        beyond = np.where(goes_on, last - gap, 0.0)
        size = np.abs(beyond) / points["l"][rows].min(axis=1)
        return FollowedGaps(beyond, np.clip((size - _FACE) / (_DOMAIN - _FACE), 0.0, 1.0))

    @property
    def apart(self) -> npt.NDArray[np.bool_]:
        """Which corners have another gap than their faces, shape (m,)."""
        return self.beyond != 0.0

    def gaps(self, probe: Probe, rows: Rows | slice) -> Probe:
        """Values of the surface with the gaps of some corners.

        Args:
            probe: Values at their faces.
            rows: The corners.
        """
        return probe[0] + self.beyond[rows], *probe[1:]

    def at_end(self, gap: Array, held: HeldCorners | None) -> Array:
        """The gaps at the end of a step (m), shape (m,); zeros where none was computed.

        Args:
            gap: Gaps that make the forces (m), shape (m,); infinite where none was computed.
            held: Overlap of corners that counts as no penetration, which these gaps contain.
        """
        own = gap if held is None else gap - held.now
        return np.where(np.isfinite(gap), own, 0.0)
