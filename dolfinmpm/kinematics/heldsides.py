"""Points beside a side of the grid that does not move along its normal.

A point moves with the mean of the displacement over the part of its domain inside the grid. If soil
flows towards a held side, as against a wall, or to the axis behind a tool, this mean moves a point
beyond the side in the end. The displacement vanishes at the side and is linear beside it: at the
distance s it is g s, and its mean up to s + l is ū = g (s + l)/2. So a point that would cross the
side goes on to the distance s (1 + g) = s (1 + 2 ū/(s + l)).
"""

from __future__ import annotations

import functools
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.body.location import bounds
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.lattice import largest_cell

__all__ = ["held_sides", "inside_sides", "keep_inside"]

Array = npt.NDArray[np.float64]

# Part of a cell by which nodes are beside a side, and least new part of the distance from it
_AT_SIDE, _LEAST = 1e-6, 1e-3


@numba.njit(cache=True, error_model="numpy")
def inside_sides(held, axis, low, high, x, half, going):
    """Displacement of a point along an axis that leaves it inside held sides (m).

    Args:
        held: Which sides are held along their normals, see `held_sides`.
        axis: The axis.
        low, high: Coordinates of the sides (m).
        x, half: Coordinate of the point, and half-length of its domain (m).
        going: Its displacement (m).
    """
    distance = -1.0
    if x + going < low and held[axis, 0]:
        distance = x - low
    elif x + going > high and held[axis, 1]:
        distance = high - x
    if distance <= 0.0:
        return going
    part = 1.0 - 2.0 * abs(going) / (distance + half)
    left = max(part, _LEAST) * distance
    return left - distance if going < 0.0 else distance - left


def held_sides(fixed: npt.NDArray[np.bool_], values: Array, on: Any) -> npt.NDArray[np.bool_]:
    """Which sides of the grid do not move along their normals, shape (d, 2).

    Args:
        fixed: Mask of the prescribed components, shape (nodes, d).
        values: Prescribed values, shape (nodes, d).
        on: Function from an axis and an end (0, 1) to the nodes of this rank on that side.
    """
    d = fixed.shape[1]
    held = np.zeros((d, 2), np.bool_)
    for axis in range(d):
        for end in range(2):
            nodes = on(axis, end)
            still = fixed[nodes, axis] & (values[nodes, axis] == 0.0)
            held[axis, end] = nodes.size > 0 and bool(still.all())
    return held


def keep_inside(points: MaterialPoints, here: Any, x: Array) -> None:
    """Keep points inside sides that do not move along their normals. Collective.

    Args:
        points: Material points.
        here: The activation.
        x: New positions (m), shape (points, gdim); changed.
    """
    low, high = bounds(points.grid)
    cell = largest_cell(points.grid)
    outside = np.flatnonzero(np.any((x < low) | (x > high), axis=1))
    if not outside.size:
        return
    for k in here.movers:
        field, fixed, values = here.fields[k], here.unknowns.fields[k].fixed, here.prescribed[k]
        if not field.basis.averaged:
            continue
        rows = outside
        if field.space.tags is not None:
            rows = rows[np.isin(points["tag"][rows], field.space.tags)]
        nodes = field.basis.node_coordinates()[:, : points.gdim]
        for p in rows:
            old = points["x"][p]
            near = np.flatnonzero(np.all(np.abs(nodes - old) < 1.5 * cell, axis=1))
            on = functools.partial(_on_side, near, nodes[near], (low, high), _AT_SIDE * cell)
            held = held_sides(fixed, values, on)
            for a in range(points.gdim):
                own = low[a], high[a], old[a], points["l"][p, a], x[p, a] - old[a]
                x[p, a] = old[a] + inside_sides(held, a, *own)


def _on_side(
    numbers: npt.NDArray[np.intp], x: Array, sides: tuple[Array, Array], least: float, axis: int,
    end: int,
) -> npt.NDArray[np.intp]:  # fmt: skip
    """Nodes on a side, by their numbers and positions (m)."""
    return numbers[np.abs(x[:, axis] - sides[end][axis]) < least]
