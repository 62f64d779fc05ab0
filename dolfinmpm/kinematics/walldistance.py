"""Distance from the markers of a wall to the body in front of the markers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.body.boundary import Boundary
from dolfinmpm.grid.lattice import largest_cell

__all__ = ["in_front", "look_ahead"]

Array = npt.NDArray[np.float64]

# Domains of a deformed body leave gaps. A marker may therefore miss the nearest domain sideways by
# half the domain's half-length, or beside a thin domain by a share of a cell,
_REACH, _BESIDE = 0.5, 1 / 16
# plus a rounding error, as a share of a cell
_SLACK = 1e-6


def look_ahead(boundary: Boundary) -> None:
    """Add fields to the markers for the position and the domain of the nearest point."""
    for name in ("body_x", "body_l"):
        boundary.markers.add_field(name, (boundary.gdim,), "m")


def in_front(
    boundary: Boundary, rows: npt.NDArray[np.integer], sizes: Array
) -> tuple[npt.NDArray[np.bool_], Array]:
    """Whether the body is in front of each marker, and its distance along the normal.

    Args:
        boundary: The wall, after `look_ahead`.
        rows: Markers in active cells.
        sizes: Sizes of the cells at the markers (m), shape (markers,).

    Returns:
        The answers, shape (markers,), and the distances from the nearest point's domain (m), shape
        (markers,). Distances are negative inside the domain.
    """
    markers = boundary.markers
    n = markers["area"] / markers["V"][:, None]
    offset, half = markers["x"] - markers["body_x"], markers["body_l"]
    normal = np.sum(offset * n, axis=1)
    sideways = np.abs(offset - normal[:, None] * n)
    on = np.zeros(len(markers), bool)
    slack = _SLACK * largest_cell(markers.grid)
    beside = np.maximum(_REACH * half[rows], _BESIDE * sizes[rows, None])
    on[rows] = np.all(sideways[rows] <= half[rows] + beside + slack, axis=1)
    return on, normal - np.sum(np.abs(n) * half, axis=1)
