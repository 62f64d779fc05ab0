"""Sharp edges of rigid bodies that meet corners of points, where the normal jumps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.facetedsurface import FacetedSurface

__all__ = ["at_sharp_edge"]

Array = npt.NDArray[np.float64]

# Distance from an edge of a corner in line with it, as a share of the point's longest half-length
_IN_LINE = 0.01


def at_sharp_edge(active: ActiveRigidContact) -> bool:
    """Whether corners of points with friction begin the step at a sharp edge, on this rank.

    Args:
        active: The contact.
    """
    body, points = active.contact.body, active.contact.points
    if not isinstance(body.surface, FacetedSurface) or not active.contact.law.friction:
        return False
    touches = active.start.gap <= active.now.path
    x = active.local_start[touches]
    reach = _IN_LINE * points["l"].max(axis=1)[active.corners.rows[touches]]
    return any(bool(np.any(_distances(x, *ends) <= reach)) for ends in body.surface.sharp_edges())


def _distances(x: Array, a: Array, b: Array) -> Array:
    """Distances of positions from a segment (m), shape (n,)."""
    along = b - a
    square = float(along @ along)
    t = np.clip((x - a) @ along / square, 0.0, 1.0) if square else np.zeros(len(x))
    return np.linalg.norm(x - a - t[:, None] * along, axis=1)
