"""Corners that a fixed side of the grid holds, while a rigid body moves along this side.

A wall that is pushed along a fixed base meets it in a corner. There the displacement is that of the
wall, and zero on the base: it jumps. Functions of the grid are continuous. In the cells beside the
base they move a corner by the share of the free nodes, and the wall cannot push it further. A
penalty that demands the whole motion grows with every step, and does not depend on the soil.

So the contact demands of a corner what the free nodes give it if they follow the body,
Σ_free N_i b, with the motion b of the body at the corner. The rest, Σ_held N_i b, is overlap that
counts as no penetration:

    g' = g + d,    d = max(0, d_n + n · Σ_held N_i (b − u_i)),

with d_n at the end of the last step, the normal n of the body and the prescribed increments u_i.
Conforming elements do the same: their edges beside a fixed node move by the share of the other
node. At the end of a step, a corner without contact keeps d only up to its penetration −g.

Components of a node count as held if they are prescribed along a side of the grid. Those across the
side do not: a plate that presses a thin layer against the base must not enter it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from dolfinmpm.body.location import bounds
from dolfinmpm.contact.contactpoints import ContactForces, ContactStart, CornerFields
from dolfinmpm.contact.meanforces import normal_energy
from dolfinmpm.grid.linecells import coordinate_rounding

if TYPE_CHECKING:
    from dolfinmpm.contact.activerigidcontact import ActiveRigidContact

__all__ = ["HeldCorners", "growth_of", "held_components", "overlap_of"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.integer]
Mask = npt.NDArray[np.bool_]

# Distance of nodes from a side that is rounding, as a share of the grid's length
_ON_SIDE = 1e-9


def held_components(grid: Mesh, fixed: Mask, positions: Callable[[], Array]) -> Mask | None:
    """Components of nodes that are held along a side of the grid, or None if there are none.

    Collective.

    Args:
        grid: The grid.
        fixed: Mask of the prescribed components, shape (nodes, gdim).
        positions: Function that returns the positions of the nodes (m), shape (nodes, gdim).
    """
    low, high = bounds(grid)
    if not fixed.any():
        return None
    x = positions()
    close = coordinate_rounding(low, high, _ON_SIDE).max()
    on = np.minimum(np.abs(x - low), np.abs(x - high)) <= close
    # a node on two sides: components across either side do not count
    held: Mask = fixed & ~on & on.any(axis=1)[:, None]
    return held if held.any() else None


@dataclass
class HeldCorners:
    """The overlap of the corners of a contact that held nodes leave.

    Attributes:
        share: Share of the motion of each corner that held nodes have, by component, shape
            (m, gdim).
        prescribed: Motion of each corner by the increments of these nodes (m), likewise.
        normal: Normals of the body at the start of the step, likewise.
        before: Overlap at the start of the step (m), shape (m,).
        now: Overlap as last computed (m), likewise.
    """

    share: Array
    prescribed: Array
    normal: Array
    before: Array
    now: Array

    @staticmethod
    def of(active: ActiveRigidContact, held: Mask | None, prescribed: Array) -> HeldCorners | None:
        """The held corners of a contact, or None if no corner is held.

        Args:
            active: The contact.
            held: Held components at the nodes of its stencils, shape (nodes, gdim), or None.
            prescribed: Prescribed increments there (m), likewise.
        """
        contact, s = active.contact, active.corners.stencils
        before = contact.points[contact.names.overlap][active.corners.rows, active.corners.which]
        if held is None or not held.any():
            if not before.any():
                return None
            # corners keep the overlap of earlier steps, also where no node is held now
            held = np.zeros(prescribed.shape, bool)
        body = contact.body
        normal = body.start.directions(body.surface.probe(active.local_start)[1])
        share = s.of_nodes(held.astype(np.float64))
        known = s.of_nodes(np.where(held, prescribed, 0.0))
        return HeldCorners(share, known, normal, before, before)

    def update(self, motion: Array) -> None:
        """Find the overlap for a motion of the body at the corners (m), shape (m, gdim)."""
        more = np.einsum("ci,ci->c", self.normal, self.share * motion - self.prescribed)
        self.now = np.maximum(self.before + more, 0.0)

    def loss_in_mean(self, rows: Rows, start: ContactStart) -> Array:
        """Loss of the penalties where the overlap grows, in steps with mean forces (J), shape (n,).

        A mean force over a step takes the overlap of its end for that of the whole step.

        Args:
            rows: The corners, shape (n,).
            start: The state of the contact at the start of the step.
        """
        k = start.stiffness[rows]
        q = start.multiplier[rows] - k * start.gap[rows]
        first, last = (normal_energy(q - k * d[rows], k) for d in (self.before, self.now))
        return np.asarray(first - last)

    def loss_at_end(self, before: Array, now: Array) -> float:
        """Loss where the overlap grows, in steps without mean forces (J).

        Args:
            before, now: Normal forces at the start and at the end of the step (N), shape (m,).
        """
        return float(np.sum(0.5 * (before + now) * (self.now - self.before)))

    def demanded(self, rows: Rows) -> Array:
        """Derivative of the motion that corners must follow by that of the body, (n, gdim, gdim).

        Args:
            rows: The corners, shape (n,).
        """
        n, share = self.normal[rows], np.where(self.now[rows, None] > 0.0, self.share[rows], 0.0)
        return np.eye(n.shape[1]) - n[:, :, None] * (share * n)[:, None, :]

    def at_end(self, names: CornerFields, now: ContactForces) -> list[tuple[str, Array]]:
        """The overlap that remains at the end of a step, with the name of its field."""
        # `now.gap` is g' = g + d, so that this is the penetration
        inside = np.maximum(self.now - now.gap, 0.0)
        kept = np.where(now.normal > 0.0, self.now, np.minimum(self.now, inside))
        return [(names.overlap, kept)]


def growth_of(held: HeldCorners | None, rows: Rows) -> Array:
    """Growth of the overlap of some corners in the step (m), shape (n,)."""
    return np.zeros(rows.size) if held is None else (held.now - held.before)[rows]


def overlap_of(held: HeldCorners | None, rows: Rows) -> Array:
    """Overlap of some corners that counts as no penetration (m), shape (n,)."""
    return np.zeros(rows.size) if held is None else held.now[rows]
