"""Exact pieces of boxes inside a polygon: areas, centroids and spreads of clipped polygons.

A polygon is cut by the four lines of a box one after the other (Sutherland & Hodgman 1974, doi
10.1145/360767.360802). Its moments are sums over its edges. Edges that run back along a line of the
box, as between two parts of a polygon that is not convex, have no moments.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

__all__ = ["moments_in_boxes", "touched_boxes"]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def touched_boxes(corners, low, high):
    """Which boxes a polygon's edges enter.

    Args:
        corners: Corners of the polygon (m), shape (c, 2).
        low, high: Corners of the boxes (m), shape (n, 2).
    """
    found = np.zeros(len(low), np.bool_)
    for k in range(len(corners)):
        ax, ay = corners[k, 0], corners[k, 1]
        bx, by = corners[(k + 1) % len(corners), 0], corners[(k + 1) % len(corners), 1]
        left, right, bottom, top = min(ax, bx), max(ax, bx), min(ay, by), max(ay, by)
        for p in range(len(low)):
            if found[p] or left >= high[p, 0] or right <= low[p, 0]:
                continue
            if bottom >= high[p, 1] or top <= low[p, 1]:
                continue
            # corners of the box on both sides of the edge's line
            least, most = np.inf, -np.inf
            for x in (low[p, 0], high[p, 0]):
                for y in (low[p, 1], high[p, 1]):
                    side = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
                    least, most = min(least, side), max(most, side)
            found[p] = least < 0.0 < most
    return found


@numba.njit(cache=True, error_model="numpy")
def _keep_below(x, y, count, limit, new_x, new_y):
    """Cut a polygon at x = limit and keep what is below; returns its number of corners."""
    kept = 0
    for k in range(count):
        j = (k + 1) % count
        inside, next_inside = x[k] <= limit, x[j] <= limit
        if inside:
            new_x[kept], new_y[kept] = x[k], y[k]
            kept += 1
        if inside != next_inside:
            share = (limit - x[k]) / (x[j] - x[k])
            new_x[kept], new_y[kept] = limit, y[k] + share * (y[j] - y[k])
            kept += 1
    return kept


@numba.njit(cache=True, error_model="numpy")
def moments_in_boxes(corners, low, high):
    """Moments of what boxes have of a polygon, about the middles of the boxes.

    Args:
        corners: Corners of the polygon (m), shape (c, 2).
        low, high: Corners of the boxes (m), shape (n, 2).

    Returns:
        ∫1, ∫x, ∫y, ∫x², ∫y² (m² to m⁴), shape (n, 5).
    """
    # each of four cuts may double the number of corners
    size = 16 * len(corners) + 16
    x, y, u, v = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    out = np.zeros((len(low), 5))
    for p in range(len(low)):
        cx, cy = 0.5 * (low[p, 0] + high[p, 0]), 0.5 * (low[p, 1] + high[p, 1])
        half_x, half_y = high[p, 0] - cx, high[p, 1] - cy
        count = len(corners)
        for k in range(count):
            x[k], y[k] = corners[k, 0] - cx, corners[k, 1] - cy
        for sign in (1.0, -1.0):
            # −x is below its limit where x is above: both cuts are one loop
            for k in range(count):
                x[k], y[k] = sign * x[k], sign * y[k]
            count = _keep_below(x, y, count, half_x, u, v)
            count = _keep_below(v, u, count, half_y, y, x)
            for k in range(count):
                x[k], y[k] = sign * x[k], sign * y[k]
        for k in range(count):
            j = (k + 1) % count
            cross = x[k] * y[j] - x[j] * y[k]
            out[p, 0] += cross / 2.0
            out[p, 1] += cross * (x[k] + x[j]) / 6.0
            out[p, 2] += cross * (y[k] + y[j]) / 6.0
            out[p, 3] += cross * (x[k] * x[k] + x[k] * x[j] + x[j] * x[j]) / 12.0
            out[p, 4] += cross * (y[k] * y[k] + y[k] * y[j] + y[j] * y[j]) / 12.0
    return out
