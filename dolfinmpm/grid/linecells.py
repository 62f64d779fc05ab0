"""Cells on a line of grid coordinates, for compiled loops."""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["SNAP", "cell_of"]

# Lengths below this share of a cell are rounding errors. Examples are the overlap of a domain with
# a cell, and the distance of a point without a domain from a grid line. Rounding errors must not
# make cells or nodes active.
SNAP = 1e-10


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
