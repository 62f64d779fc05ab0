"""Points beside a side of the grid that does not move along its normal.

A point moves with the average of the displacement over its domain. If soil flows towards a held
side, as towards the axis behind a tool, this average moves a point beyond the side in the end. The
displacement itself vanishes at the side, and is linear beside it: the distance of a point from the
side is then stretched by the component of ΔF along the normal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.body.location import bounds
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.lattice import largest_cell

__all__ = ["keep_inside"]

Array = npt.NDArray[np.float64]

# Part of a cell by which nodes are beside a side, and least stretch of a distance from it
_AT_SIDE, _LEAST = 1e-6, 1e-3


def keep_inside(points: MaterialPoints, here: Any, x: Array, gradient: Array) -> None:
    """Keep points inside sides that do not move along their normals. Collective.

    Args:
        points: Material points.
        here: The activation.
        x: New positions (m), shape (points, gdim); changed.
        gradient: ΔF − 1 of the points, shape (points, d, d).
    """
    low, high = bounds(points.grid)
    cell = largest_cell(points.grid)
    for k in here.movers:
        field = here.fields[k]
        if not field.basis.averaged:
            continue
        for a, side, beyond in _sides(x, low, high):
            rows = np.flatnonzero(beyond)
            if field.space.tags is not None:
                rows = rows[np.isin(points["tag"][rows], field.space.tags)]
            if not rows.size:
                continue
            nodes = field.basis.node_coordinates()[:, : points.gdim]
            at = np.flatnonzero(np.abs(nodes[:, a] - side) < _AT_SIDE * cell)
            free = ~here.unknowns.fields[k].fixed[at, a] | (here.prescribed[k][at, a] != 0.0)
            for p in rows:
                away = np.abs(np.delete(nodes[at] - points["x"][p], a, axis=1)).max(axis=1)
                near = away < 1.5 * cell
                if near.any() and not free[near].any():
                    stretch = max(1.0 + gradient[p, a, a], _LEAST)
                    x[p, a] = side + stretch * (points["x"][p, a] - side)


def _sides(x: Array, low: Array, high: Array) -> list[tuple[int, float, npt.NDArray[np.bool_]]]:
    """Direction and coordinate of each side, and which points are beyond it."""
    found = [(a, float(low[a]), x[:, a] < low[a]) for a in range(len(low))]
    return found + [(a, float(high[a]), x[:, a] > high[a]) for a in range(len(high))]
