"""The state of a body at the markers of a boundary: that of the nearest material point.

Markers of walls, in front of which the body moves, take the point with the nearest domain. The
nearest centre may be that of a thin domain at the edge of a body, which is not at the marker.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm.body.boundary import OWN, Boundary
from dolfinmpm.body.exchange import exchange
from dolfinmpm.body.markerdistance import APART

__all__ = ["keys_of", "leave_with_removed", "nearest", "nearest_of_all", "take_state"]

Array = npt.NDArray[np.float64]

# What is of the markers themselves
_OWN = frozenset({"id", "cell", "x", "x0", "V", "V0", "l", "l0", "area", "area0", OWN, APART})
# Where the point is that the state is of, for markers that ask
_PLACE = {"body_x": "x", "body_l": "l", "body_x0": "x0"}
# Points that are as near as another but for this share are equally near: one of them is chosen by
# a sum of its first coordinates, with weights that no lattice has ties for
_SAME = 1e-7
# Share of the distance of centres beside that of domains: of domains that meet, the nearest centre
# counts
_CENTRES = 0.01
_WEIGHTS = np.sqrt([2.0, 3.0, 7.0])


def take_state(boundary: Boundary, tags: Tags = None) -> None:
    """Give each marker the state of the nearest material point as it is now. Collective.

    Fields that the markers alone have stay as they are.

    Args:
        boundary: The boundary.
        tags: Tags of the points of its body, or None for all.
    """
    points, markers = boundary.points, boundary.markers
    # what follows the body keeps its neighbours, which first positions tell exactly
    x = "x0" if markers.configuration == "total" and boundary.follows else "x"
    names = {name: name for name in points.fields if name not in _OWN}
    names |= {of: name for of, name in _PLACE.items() if of in markers.fields}
    if points.comm.size == 1:
        rows = _nearest(boundary, markers[x], tags, x)[2]
        found: dict[str, npt.NDArray[Any]] = {of: points[name][rows] for of, name in names.items()}
    else:
        found = _from_all(boundary, names, tags, x)
    for name, values in found.items():
        if name in markers.fields:
            markers.fields[name][...] = values
        elif name in points.symbols.fields:
            like = points.symbols.fields[name]
            markers.add_field(name, like.ufl_shape, like.unit)
            markers.fields[name][...] = values
        else:
            markers.fields[name] = values


def leave_with_removed(boundary: Boundary) -> None:
    """Let markers go whose nearest points were removed since the last call. Collective.

    The boundary of a body ends where the body is taken away. Its markers would else go on with the
    state of points far from them.

    Args:
        boundary: A boundary that follows its body.
    """
    points, markers, comm = boundary.points, boundary.markers, boundary.points.comm
    removals, boundary.removed = boundary.removed, []
    if not removals:
        return
    total = markers.configuration == "total"
    x = "x0" if total else "x"
    at = np.concatenate(comm.allgather(markers[x]))
    gone = np.concatenate(removals)[:, int(total)]
    distances = np.array([nearest(rows, np.zeros(len(rows)), at)[0] for rows in (points[x], gone)])
    comm.Allreduce(MPI.IN_PLACE, distances, op=MPI.MIN)
    lost = distances[1] < distances[0] * (1 - _SAME)
    first = sum(comm.allgather(len(markers))[: comm.rank])
    if lost.any():
        if APART not in markers.fields:
            markers.add_field(APART)
        markers.fields[APART][lost[first : first + len(markers)]] = 1.0


def nearest(x: Array, key: Array, at: Array, half: Array | None = None):
    """Distances (m), keys and rows of the places nearest to positions, each of shape (n,).

    Of places that are equally near the one with the least key counts.

    Args:
        x: Places (m), shape (m, gdim).
        key: A number of each that does not depend on the ranks, see `keys_of`.
        at: Positions (m), shape (n, gdim).
        half: Half-lengths of domains at the places (m), shape (m, gdim), if the nearest domain
            counts, of those with the eight nearest centres.
    """
    from scipy.spatial import cKDTree

    if len(x) == 0 or len(at) == 0:
        far = np.full(len(at), np.inf)
        return far, far.copy(), np.zeros(len(at), np.intp)
    count = min(4 if half is None else 8, len(x))
    distance, rows = cKDTree(x).query(at, count)
    distance, rows = distance.reshape(len(at), count), rows.reshape(len(at), count)
    if half is not None:
        outside = np.maximum(np.abs(at[:, None] - x[rows]) - half[rows], 0.0)
        distance = np.linalg.norm(outside, axis=2) + _CENTRES * distance
    least = distance.min(axis=1)
    same = distance <= least[:, None] * (1 + _SAME)
    keys = np.where(same, key[rows], np.inf)
    best = np.argmin(keys, axis=1)
    every = np.arange(len(at))
    return least, keys[every, best], rows[every, best]


def nearest_of_all(
    comm: MPI.Comm, distance: Array, key: Array, rows: npt.NDArray[np.intp]
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Positions whose nearest place on all ranks is one of this rank, and these places. Collective.

    Args:
        comm: The ranks.
        distance, key, rows: Nearest place of this rank to each position, see `nearest`.
    """
    least, first = np.empty_like(distance), np.empty_like(key)
    comm.Allreduce(distance, least, op=MPI.MIN)
    key = np.where(distance <= least * (1 + _SAME), key, np.inf)
    comm.Allreduce(key, first, op=MPI.MIN)
    mine = np.flatnonzero((key == first) & np.isfinite(key) & np.isfinite(distance))
    return mine, rows[mine]


def keys_of(x0: Array) -> Array:
    """Keys of places by first positions (m): numbers of points depend on the ranks."""
    return np.asarray(x0 @ _WEIGHTS[: x0.shape[1]], np.float64)


def _nearest(boundary: Boundary, at: Array, tags: Tags, x: str):
    """`nearest` among the points of some tags of a boundary, at their positions of that name."""
    points = boundary.points
    places = points[x], keys_of(points["x0"])
    half = points["l"] if "body_l" in boundary.markers.fields else None
    if tags is None:
        return nearest(*places, at, half)
    own = np.flatnonzero(np.isin(points["tag"], tags))
    half = None if half is None else half[own]
    distance, key, rows = nearest(places[0][own], places[1][own], at, half)
    return distance, key, own[rows] if own.size else rows


def _from_all(
    boundary: Boundary, names: dict[str, str], tags: Tags, x: str
) -> dict[str, npt.NDArray[Any]]:
    """State of the nearest points of all ranks, in the order of this rank's markers. Collective."""
    points, markers, comm = boundary.points, boundary.markers, boundary.points.comm
    counts = comm.allgather(len(markers))
    at = np.concatenate(comm.allgather(markers[x]))
    mine, rows = nearest_of_all(comm, *_nearest(boundary, at, tags, x))
    to = np.repeat(np.arange(comm.size, dtype=np.int32), counts)[mine]
    sent: dict[str, npt.NDArray[Any]] = {of: points[name][rows] for of, name in names.items()}
    found = exchange(comm, {**sent, "of marker": mine}, to)
    order = np.argsort(found.pop("of marker"))
    return {name: values[order] for name, values in found.items()}
