"""Cells on a line of grid coordinates, for compiled loops, and rounding of coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

__all__ = ["FAR", "SNAP", "cell_of", "coordinate_rounding", "relative_rounding", "rounding"]

# Lengths below this share of a cell are rounding errors. Examples are the overlap of a domain with
# a cell, and the distance of a point without a domain from a grid line. Rounding errors must not
# make cells or nodes active.
SNAP = 1e-10
# Rounding error of a coordinate as a share of the coordinate: far from the origin, as in map
# coordinates, it is more than `SNAP`. Positions are sums, which have some units of the last place.
FAR = 8 * float(np.finfo(float).eps)


@numba.njit(cache=True, inline="always")
def rounding(low, high):
    """Length below which a difference of positions in a cell is a rounding error (m).

    Args:
        low, high: Lower and upper coordinate of the cell (m).
    """
    return max(SNAP * (high - low), FAR * max(abs(low), abs(high)))


def coordinate_rounding(low: npt.ArrayLike, high: npt.ArrayLike, share: float = 1e-9) -> Any:
    """Length within which coordinates are equal but for rounding (m), of the shape of the bounds.

    Args:
        low, high: Bounds of the coordinates (m).
        share: Share of the distance of the bounds that is rounding near the origin.
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    return np.maximum(share * (high - low), FAR * np.maximum(np.abs(low), np.abs(high)))


def relative_rounding(lines: Sequence[npt.NDArray[np.float64]], part: float = 1.0) -> float:
    """Relative rounding error of lengths, areas and volumes in cells (-).

    Args:
        lines: Coordinates of the grid lines in each direction (m).
        part: Size of the smallest part of a cell, as a share of the cell.
    """
    far = [np.abs(line[[0, -1]]).max() / np.diff(line).min() for line in lines]
    return float(max(1e-9, FAR * max(far) / part))


@numba.njit(cache=True, inline="always")
def cell_of(line, uniform, x):
    """Cell that contains a coordinate; the nearest cell outside the line.

    Args:
        line: Coordinates of the grid lines (m).
        uniform: Whether all cells have the same size.
        x: The coordinate (m).
    """
    n = line.size - 1
    if uniform:
        cell = int(np.floor((x - line[0]) / (line[n] - line[0]) * n))
    else:
        # bisection; np.searchsorted takes three times as long to compile
        cell, end = -1, n + 1
        while end - cell > 1:
            middle = (cell + end) // 2
            if line[middle] <= x:
                cell = middle
            else:
                end = middle
    return min(max(cell, 0), n - 1)
