"""Signed distance to surfaces of segments (2D) and triangles (3D), by a tree of boxes.

The nearest point on the nearest facet gives the distance. The sign follows from the outward
pseudo-normal of the facet, edge or corner with this point (Bærentzen & Aanæs 2005, doi
10.1109/TVCG.2005.49). The corners of a facet have the order that makes its normal point outwards:
anticlockwise around a polygon.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.surfaces import Probe

__all__ = ["FacetedSurface", "facet_normals"]

Array = npt.NDArray[np.float64]

# Facets in a leaf of the tree
_LEAF = 4
# Below this distance, in sizes of the surface, the direction to the surface is rounding
_NEAR = 1e-13


def facet_normals(x: Array, facets: npt.NDArray[np.integer]) -> Array:
    """Normals of facets times their length, or twice their area, shape (n, gdim)."""
    a = x[facets]
    along = a[:, 1] - a[:, 0]
    if x.shape[1] == 2:
        return np.column_stack([along[:, 1], -along[:, 0]])
    return np.asarray(np.cross(along, a[:, 2] - a[:, 0]))


class FacetedSurface:
    """A closed surface of segments or triangles.

    Args:
        x: Its corners (m), shape (corners, gdim).
        facets: Corners of each facet, shape (facets, gdim), without degenerate ones.

    Attributes:
        x, facets: The arguments.
    """

    def __init__(self, x: Array, facets: npt.NDArray[np.integer]):
        self.x = np.ascontiguousarray(x, np.float64)
        self.facets = np.ascontiguousarray(facets, np.int64)
        self.gdim = self.x.shape[1]
        used = self.x[np.unique(self.facets)]
        self.low, self.high = used.min(axis=0), used.max(axis=0)
        normals = facet_normals(self.x, self.facets)
        self._normal = normals / np.linalg.norm(normals, axis=1)[:, None]
        self._at_corner, self._at_edge = self._pseudo_normals()
        self._tree = _tree(self.x[self.facets])

    def _pseudo_normals(self) -> tuple[Array, Array]:
        """Normals at corners, shape (corners, gdim), and at edges, shape (facets, 3, gdim)."""
        x, facets, n = self.x, self.facets, self._normal
        at_corner = np.zeros_like(x)
        if self.gdim == 2:
            for k in range(2):
                np.add.at(at_corner, facets[:, k], n)
            return at_corner, np.zeros((len(facets), 3, 2))
        for k in range(3):
            here, one, other = (x[facets[:, (k + i) % 3]] for i in range(3))
            a, b = one - here, other - here
            size = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
            angle = np.arccos(np.clip(np.sum(a * b, axis=1) / size, -1.0, 1.0))
            np.add.at(at_corner, facets[:, k], angle[:, None] * n)
        edges = np.concatenate([facets[:, [k, (k + 1) % 3]] for k in range(3)])
        _, which = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
        which = which.reshape(-1)
        sums = np.zeros((which.max() + 1, 3))
        np.add.at(sums, which, np.tile(n, (3, 1)))
        return at_corner, np.ascontiguousarray(
            sums[which].reshape(3, len(facets), 3).transpose(1, 0, 2)
        )

    def probe(self, x: Array) -> Probe:
        """See `RigidSurface`."""
        n, d = x.shape
        gap, normal, curvature = np.empty(n), np.empty((n, d)), np.zeros((n, d, d))
        near = _NEAR * float(np.max(self.high - self.low))
        _probe(
            np.ascontiguousarray(x), self.x, self.facets, self._normal, self._at_corner,
            self._at_edge, *self._tree, near, gap, normal, curvature,
        )  # fmt: skip
        return gap, normal, curvature

    def outline(self, low: Array, high: Array) -> Array:
        """See `RigidSurface`."""
        return self.x[self.facets]

    def sharp_edges(self) -> Array:
        """Ends of the edges at which normals turn by 20 degrees or more (m), shape (n, 2, gdim).

        In 2D both ends are a corner.
        """
        flat = 2 * np.cos(np.radians(10.0))
        if self.gdim == 2:
            corners = self.x[np.linalg.norm(self._at_corner, axis=1) < flat]
            return np.stack([corners, corners], axis=1)
        ends = np.stack([self.facets, np.roll(self.facets, -1, axis=1)], axis=2)
        return self.x[ends[np.linalg.norm(self._at_edge, axis=2) < flat]]


def _tree(corners: Array) -> tuple[Array, Array, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """A tree of boxes around facets: corners and parts of the boxes, and order of the facets.

    Args:
        corners: Corners of the facets, shape (n, gdim, gdim).

    Returns:
        Lower and upper corners, shape (boxes, gdim). First and last position in the order, and
        first of two children or -1, shape (boxes, 3). The order, shape (n,).
    """
    low, high, middle = corners.min(axis=1), corners.max(axis=1), corners.mean(axis=1)
    order = np.arange(len(corners))
    boxes: list[tuple[Array, Array]] = []
    parts: list[list[int]] = []

    def box(first: int, last: int) -> None:
        own = order[first:last]
        boxes.append((low[own].min(axis=0), high[own].max(axis=0)))
        parts.append([first, last, -1])

    box(0, len(corners))
    at = 0
    while at < len(parts):
        first, last, _ = parts[at]
        if last - first > _LEAF:
            own = order[first:last]
            axis = int(np.argmax(np.ptp(middle[own], axis=0)))
            half = (last - first) // 2
            order[first:last] = own[np.argpartition(middle[own, axis], half)]
            parts[at][2] = len(parts)
            box(first, first + half)
            box(first + half, last)
        at += 1
    lower, upper = (np.array([b[k] for b in boxes]) for k in (0, 1))
    return lower, upper, np.array(parts, np.int64), order


@numba.njit(cache=True, error_model="numpy")
def _nearest_on_segment(p, a, b, y):
    """Nearest point y of a segment. Returns 0 or 1 for an end, 2 for a point between."""
    along, size = 0.0, 0.0
    for i in range(2):
        along += (p[i] - a[i]) * (b[i] - a[i])
        size += (b[i] - a[i]) ** 2
    t = along / size
    kind = 2
    if t <= 0.0:
        t, kind = 0.0, 0
    elif t >= 1.0:
        t, kind = 1.0, 1
    for i in range(2):
        y[i] = a[i] + t * (b[i] - a[i])
    return kind


@numba.njit(cache=True, inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, error_model="numpy")
def _along(x, to, p, q):
    """(to − x)·(p − q) without temporary arrays, which would cost more than the sum."""
    first = (to[0] - x[0]) * (p[0] - q[0])
    return first + (to[1] - x[1]) * (p[1] - q[1]) + (to[2] - x[2]) * (p[2] - q[2])


@numba.njit(cache=True, error_model="numpy")
def _nearest_on_triangle(p, a, b, c, y):
    """Nearest point y of a triangle.

    Returns 0, 1, 2 for a corner, 3, 4, 5 for the edge after the corner, 6 for the inside.

    Ericson, Real-Time Collision Detection (2005), 5.1.5.
    """
    d1, d2 = _along(a, b, p, a), _along(a, c, p, a)
    if d1 <= 0.0 and d2 <= 0.0:
        y[:] = a
        return 0
    d3, d4 = _along(a, b, p, b), _along(a, c, p, b)
    if d3 >= 0.0 and d4 <= d3:
        y[:] = b
        return 1
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        share = d1 / (d1 - d3)
        for i in range(3):
            y[i] = a[i] + share * (b[i] - a[i])
        return 3
    d5, d6 = _along(a, b, p, c), _along(a, c, p, c)
    if d6 >= 0.0 and d5 <= d6:
        y[:] = c
        return 2
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        share = d2 / (d2 - d6)
        for i in range(3):
            y[i] = a[i] + share * (c[i] - a[i])
        return 5
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        share = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        for i in range(3):
            y[i] = b[i] + share * (c[i] - b[i])
        return 4
    whole = va + vb + vc
    for i in range(3):
        y[i] = a[i] + vb / whole * (b[i] - a[i]) + vc / whole * (c[i] - a[i])
    return 6


@numba.njit(cache=True, error_model="numpy")
def _square_to_box(p, low, high):
    total = 0.0
    for i in range(p.size):
        if p[i] < low[i]:
            total += (low[i] - p[i]) ** 2
        elif p[i] > high[i]:
            total += (p[i] - high[i]) ** 2
    return total


@numba.njit(cache=True, error_model="numpy")
def _probe(
    points, x, facets, face_normal, corner_normal, edge_normal, low, high, parts, order, near,
    gap, normal, curvature,
):  # fmt: skip
    d = x.shape[1]
    stack = np.empty(128, np.int64)
    y, best_y = np.empty(d), np.empty(d)
    for q in range(points.shape[0]):
        p = points[q]
        best, facet, kind = np.inf, -1, -1
        top = 1
        stack[0] = 0
        while top > 0:
            top -= 1
            box = stack[top]
            if _square_to_box(p, low[box], high[box]) > best:
                continue
            child = parts[box, 2]
            if child >= 0:
                one = _square_to_box(p, low[child], high[child])
                other = _square_to_box(p, low[child + 1], high[child + 1])
                # the nearer child is searched first
                stack[top] = child + 1 if one <= other else child
                stack[top + 1] = child if one <= other else child + 1
                top += 2
                continue
            for at in range(parts[box, 0], parts[box, 1]):
                f = order[at]
                if d == 2:
                    k = _nearest_on_segment(p, x[facets[f, 0]], x[facets[f, 1]], y)
                else:
                    k = _nearest_on_triangle(
                        p, x[facets[f, 0]], x[facets[f, 1]], x[facets[f, 2]], y
                    )
                square = 0.0
                for i in range(d):
                    square += (p[i] - y[i]) ** 2
                # at equal distance a face wins, because its normal is certain
                if square < best or (square == best and k == (2 if d == 2 else 6)):
                    best, facet, kind = square, f, k
                    best_y[:] = y
        distance = math.sqrt(best)
        if d == 2:
            side = face_normal[facet] if kind == 2 else corner_normal[facets[facet, kind]]
        elif kind == 6:
            side = face_normal[facet]
        elif kind < 3:
            side = corner_normal[facets[facet, kind]]
        else:
            side = edge_normal[facet, kind - 3]
        along, size = 0.0, 0.0
        for i in range(d):
            along += side[i] * (p[i] - best_y[i])
            size += side[i] * side[i]
        sign = 1.0 if along >= 0.0 else -1.0
        gap[q] = sign * distance
        inner = (d == 2 and kind == 2) or kind == 6
        if inner or distance <= near:
            for i in range(d):
                normal[q, i] = side[i] / math.sqrt(size)
            continue
        for i in range(d):
            normal[q, i] = sign * (p[i] - best_y[i]) / distance
        for i in range(d):
            for j in range(d):
                curvature[q, i, j] = -normal[q, i] * normal[q, j] / gap[q]
            curvature[q, i, i] += 1.0 / gap[q]
        if d == 3 and kind >= 3:
            # the normal does not change along the edge
            a, b = x[facets[facet, kind - 3]], x[facets[facet, (kind - 2) % 3]]
            e = (b - a) / math.sqrt(_dot(b - a, b - a))
            for i in range(3):
                for j in range(3):
                    curvature[q, i, j] -= e[i] * e[j] / gap[q]
