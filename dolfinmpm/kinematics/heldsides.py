"""Points beside a side of the grid that does not move along its normal.

A point moves with the mean of the displacement over the part of its domain inside the grid. If soil
flows towards a held side, as against a wall, or to the axis behind a tool, this mean moves a point
beyond the side in the end. The displacement vanishes at the side and is linear beside it: at the
distance s it is g s, and its mean up to s + l is ū = g (s + l)/2. So a point that would cross the
side goes on to the distance s (1 + g) = s (1 + 2 ū/(s + l)).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.body.location import bounds
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.lattice import largest_cell

__all__ = ["held_sides", "inside_sides", "keep_inside"]

Array = npt.NDArray[np.float64]
Nodes = npt.NDArray[np.intp]

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


def held_sides(
    fixed: npt.NDArray[np.bool_], values: Array, on: Sequence[Sequence[Nodes]],
    comm: MPI.Comm = MPI.COMM_SELF,
) -> npt.NDArray[np.bool_]:  # fmt: skip
    """Which sides of the grid do not move along their normals, shape (d, 2). Collective on `comm`.

    Args:
        fixed: Mask of the prescribed components, shape (nodes, d).
        values: Prescribed values, shape (nodes, d).
        on: Nodes of this rank on the two sides across each axis.
        comm: Ranks that have nodes on the sides.
    """
    still = fixed & (values == 0.0)
    found = np.array(
        [[(n.size > 0, not still[n, axis].all()) for n in ends] for axis, ends in enumerate(on)]
    )
    if comm.size > 1:
        comm.Allreduce(MPI.IN_PLACE, found, op=MPI.LOR)
    return np.asarray(found[..., 0] & ~found[..., 1])


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
            away = [np.abs(nodes[near] - side) < _AT_SIDE * cell for side in (low, high)]
            on = [[near[side[:, a]] for side in away] for a in range(points.gdim)]
            held = held_sides(fixed, values, on)
            for a in range(points.gdim):
                own = low[a], high[a], old[a], points["l"][p, a], x[p, a] - old[a]
                x[p, a] = old[a] + inside_sides(held, a, *own)
