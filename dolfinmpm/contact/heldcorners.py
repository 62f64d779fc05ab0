"""Corners that a fixed side of the grid holds, while a rigid body moves along this side.

A wall that is pushed along a fixed base meets it in a corner. There the displacement is that of the
wall, and zero on the base: it jumps. Functions of the grid are continuous. In the cells beside the
base they move a corner by the share of the free nodes, and the wall cannot push it further. A
penalty that demands the whole motion grows with every step, and does not depend on the soil.

So the contact demands of a corner what the free nodes give it if they follow the body,
Σ_free N_i b, with the motion b of the body at the corner. The rest, Σ_held N_i b, is overlap that
counts as no penetration:

    g' = g + d,    d = max(0, d_n + n · Σ_held N_i (b − u_i)),

with the normal n of the body and the prescribed increments u_i. Conforming elements do the same:
their edges beside a fixed node move by the share of the other node. A corner without contact keeps
no more of d than it is inside the body.

Components of a node count as held if they are prescribed along a side of the grid. Those across the
side do not: a plate that presses a thin layer against the base must not enter it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dolfinmpm.body.location import bounds
from dolfinmpm.contact.contactpoints import ContactForces, ContactStart, CornerFields
from dolfinmpm.contact.meanforces import normal_energy

if TYPE_CHECKING:
    from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
    from dolfinmpm.cut.activation import Activation

__all__ = ["HeldCorners", "overlap_of"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.integer]

# Distance of nodes from a side that is rounding, as a share of the grid's length
_ON_SIDE = 1e-9


@dataclass
class HeldCorners:
    """The overlap of the corners of a contact that held nodes leave.

    Attributes:
        share: Share of the motion of each corner that held nodes have, by component, shape
            (m, gdim).
        given: Motion of each corner by the prescribed increments of these nodes (m), likewise.
        normal: Normals of the body at the start of the step, likewise.
        before: Overlap at the start of the step (m), shape (m,).
        now: Overlap as last computed (m), likewise.
    """

    share: Array
    given: Array
    normal: Array
    before: Array
    now: Array

    @staticmethod
    def of(active: ActiveRigidContact, here: Activation) -> HeldCorners | None:
        """The held corners of a contact on an activation, or None if no held node is near.

        Collective.
        """
        contact, k, s = active.contact, active.field, active.corners.stencils
        points, body = contact.points, contact.body
        low, high = bounds(points.grid)
        before = points[contact.names.overlap][active.corners.rows, active.corners.which]
        fixed, kept = here.unknowns.fields[k].fixed[s.nodes], before.any()
        if not (kept or fixed.any()):
            return None
        d = fixed.shape[1]
        x = here.fields[k].basis.node_coordinates()[s.nodes, :d]
        near = np.minimum(np.abs(x - low), np.abs(x - high))
        on = near <= _ON_SIDE * (high - low).max()
        # nodes of edges of the grid are held across one of their sides
        held = fixed & ~on & on.any(axis=1)[:, None]
        if not (kept or held.any()):
            return None
        share = s.of_nodes(held.astype(np.float64))
        given = s.of_nodes(np.where(held, here.prescribed[k][s.nodes], 0.0))
        normal = body.start.directions(body.surface.probe(active.local_start)[1])
        return HeldCorners(share, given, normal, before, before)

    def update(self, motion: Array) -> None:
        """Find the overlap for a motion of the body at the corners (m), shape (m, gdim)."""
        more = np.einsum("ci,ci->c", self.normal, self.share * motion - self.given)
        self.now = np.maximum(self.before + more, 0.0)

    def released(self, rows: Rows, start: ContactStart) -> Array:
        """Energy that the penalties lose where the overlap grows (J), shape (n,).

        A mean force over a step takes the overlap of its end for that of the whole step.

        Args:
            rows: The corners, shape (n,).
            start: The state of the contact at the start of the step.
        """
        k = start.stiffness[rows]
        q = start.multiplier[rows] - k * start.gap[rows]
        before, now = (
            normal_energy(q - k * self.before[rows], k),
            normal_energy(q - k * self.now[rows], k),
        )
        return np.asarray(before - now)

    def demanded(self, rows: Rows) -> Array:
        """Motion that corners must follow by a motion of the body, shape (n, gdim, gdim).

        Args:
            rows: The corners, shape (n,).
        """
        n, share = self.normal[rows], np.where(self.now[rows, None] > 0.0, self.share[rows], 0.0)
        return np.eye(n.shape[1]) - n[:, :, None] * (share * n)[:, None, :]

    def at_end(self, names: CornerFields, now: ContactForces) -> list[tuple[str, Array]]:
        """The overlap that remains at the end of a step, with the name of its field."""
        inside = np.maximum(self.now - now.gap, 0.0)
        kept = np.where(now.normal > 0.0, self.now, np.minimum(self.now, inside))
        return [(names.overlap, kept)]


def overlap_of(held: HeldCorners | None, rows: Rows) -> Array:
    """Overlap of some corners that counts as no penetration (m), shape (n,)."""
    return np.zeros(rows.size) if held is None else held.now[rows]
