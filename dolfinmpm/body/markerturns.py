"""Checks of what a boundary is made of: segments that cross, triangles whose normals disagree."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import ParameterError

__all__ = ["check_crossings", "check_turns"]

Array = npt.NDArray[np.float64]

# Lengths below this share of the size of a boundary are rounding
_ROUNDING = 1e-9


def check_crossings(ends: Array) -> None:
    """Raise if segments of a chain cross: there the body would be to the left and to the right.

    Segments that touch at corners, or lie on each other, do not cross.

    Args:
        ends: Ends of the segments (m), shape (n, 2, 2).

    Raises:
        ParameterError: Two segments cross; the message names them and the place.
    """
    slack = _ROUNDING * float(np.ptp(ends.reshape(-1, 2), axis=0).max())
    order = np.argsort(ends[:, :, 0].min(axis=1), kind="stable")
    a, b = ends[order, 0], ends[order, 1]
    low, high = np.minimum(a, b), np.maximum(a, b)
    # only segments that begin before one ends can cross it
    last = np.searchsorted(low[:, 0], high[:, 0], side="right")
    for k in range(len(order)):
        j = np.arange(k + 1, last[k])
        j = j[(low[j, 1] <= high[k, 1]) & (high[j, 1] >= low[k, 1])]
        if not j.size:
            continue
        here, there = b[k] - a[k], b[j] - a[j]
        sides = _distances(here, a[j] - a[k]), _distances(here, b[j] - a[k])
        others = _distances(there, a[k] - a[j]), _distances(there, b[k] - a[j])
        cross = [np.minimum(*pair) < -slack for pair in (sides, others)]
        cross += [np.maximum(*pair) > slack for pair in (sides, others)]
        found = np.flatnonzero(np.all(cross, axis=0))
        if found.size:
            f = found[0]
            share = others[0][f] / (others[0][f] - others[1][f])
            one, other = sorted((int(order[k]), int(order[j[f]])))
            raise ParameterError(
                f"segments {one} and {other} of the boundary cross at "
                f"{np.array2string(a[k] + share * here, precision=6)} m, and the body would be on "
                "both sides: put the vertices in order, the body to their left"
            )


def _distances(along: Array, to: Array) -> Array:
    """Distances of places from lines, positive to the left (m), shape (n,)."""
    size = np.hypot(along[..., 0], along[..., 1])
    return np.asarray((along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]) / size)


def check_turns(corners: Array) -> None:
    """Raise if two triangles have a side in common and normals that disagree.

    Args:
        corners: Corners of the triangles (m), shape (n, 3, 3).

    Raises:
        ParameterError: A side has the same direction in two triangles; the message names the place.
    """
    if not len(corners):
        return
    x = corners.reshape(-1, 3)
    grid = _ROUNDING * max(float(np.ptp(x, axis=0).max()), 1e-300)
    places, number = np.unique(np.round((x - x.min(axis=0)) / grid), axis=0, return_inverse=True)
    number = number.reshape(-1, 3)
    number = number[np.all(number != np.roll(number, 1, axis=1), axis=1)]
    # triangles that are given twice are told of as such
    _, first = np.unique(np.sort(number, axis=1), axis=0, return_index=True)
    number = number[first]
    directed = np.concatenate([number[:, [k, (k + 1) % 3]] for k in range(3)])
    ways = np.where(directed[:, 0] < directed[:, 1], 1, -1)
    sides, which = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    # at an edge of two bodies that touch, two go either way
    bad = sides[np.abs(np.bincount(which.reshape(-1), ways)) > 1]
    if len(bad):
        middle = x.min(axis=0) + grid * places[bad[0]].mean(axis=0)
        raise ParameterError(
            f"neighbours of {len(bad)} sides of the triangles have normals that disagree, such as "
            f"those at {np.array2string(middle, precision=6)} m: turn triangles, so that all "
            "normals point out of the body"
        )
