"""Where a body is in front of the markers of a wall, and how far away."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.body.boundary import Boundary
from dolfinmpm.grid.lattice import largest_cell

__all__ = ["in_front", "look_ahead"]

Array = npt.NDArray[np.float64]

# Domains of a deformed body leave gaps: a marker may be beside the nearest one by half its size
_REACH = 1.5
# and by rounding, as a share of a cell
_SLACK = 1e-6


def look_ahead(boundary: Boundary) -> None:
    """Let markers keep where the nearest point and its domain are."""
    for name in ("body_x", "body_l"):
        boundary.markers.add_field(name, (boundary.gdim,), "m")


def in_front(
    boundary: Boundary, rows: npt.NDArray[np.integer]
) -> tuple[npt.NDArray[np.bool_], Array]:
    """Which markers have the body in front of them, and the way to it along the normal.

    Args:
        boundary: The wall, after `look_ahead`.
        rows: Markers in active cells.

    Returns:
        Shapes (markers,); the way (m) is that to the nearest point's domain, negative within it.
    """
    markers = boundary.markers
    n = markers["area"] / markers["V"][:, None]
    away, half = markers["x"] - markers["body_x"], markers["body_l"]
    ahead = np.sum(away * n, axis=1)
    aside = np.abs(away - ahead[:, None] * n)
    on = np.zeros(len(markers), bool)
    slack = _SLACK * largest_cell(markers.grid)
    on[rows] = np.all(aside[rows] <= _REACH * half[rows] + slack, axis=1)
    return on, ahead - np.sum(np.abs(n) * half, axis=1)
