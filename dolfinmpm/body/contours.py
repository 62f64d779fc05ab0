"""Quadrature on lines and surfaces that do not fit the grid, piece by piece of its cells.

Functions of the grid have kinks where cells meet: a rule is exact on the pieces of a line
or a surface in each cell, not across them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import whole
from dolfinmpm._platform.errors import ParameterError

__all__ = [
    "along_segments", "contour", "cut_triangles", "gauss", "inside", "kuhn", "no_longer",
    "quartered",
]  # fmt: skip

Array = npt.NDArray[np.float64]

# degree 4 on a triangle (Dunavant 1985, doi 10.1002/nme.1620210612): barycentric points, weights
_NEAR, _FAR = (0.445948490915965, 0.223381589678011), (0.091576213509771, 0.109951743655322)
_TRIANGLE = np.array(
    [np.roll([1 - 2 * a, a, a], k) for a, _ in (_NEAR, _FAR) for k in range(3)], float
)
_WEIGHTS = np.repeat([_NEAR[1], _FAR[1]], 3)
# degree 2, for small pieces of curved surfaces
_COARSE = np.array([np.roll([2 / 3, 1 / 6, 1 / 6], k) for k in range(3)], float)
# pieces smaller than this share of what they are cut from are rounding
_NONE = 1e-13
# Most pieces of a line of cells
_MOST = 1e6


def along_segments(
    ends: Array, lines: Sequence[Array], spacing: float, rule: int
) -> tuple[Array, Array]:
    """Gauss points of segments in the plane and their area vectors.

    Args:
        ends: First and last point of each segment (m), shape (n, 2, 2).
        lines: Grid lines (m) in each direction, where the segments are cut; or none.
        spacing: Longest piece (m). Cells are cut into equal parts first, so that pieces end where
            leaves of a refined space do.
        rule: Gauss points of a piece.

    Returns:
        Positions (m) and area vectors (m), the normals to the right of the segments, both of
        shape (markers, 2).
    """
    at, weights = gauss(rule)
    x, areas = [np.empty((0, 2))], [np.empty((0, 2))]
    for a, b in ends:
        along = b - a
        length = float(np.linalg.norm(along))
        cuts = [np.array([0.0, 1.0])]
        for d, line in enumerate(lines):
            if along[d] != 0:
                near = no_longer(_around(line, a[d], b[d]), spacing)
                cuts.append((near - a[d]) / along[d])
        t = np.unique(np.clip(np.concatenate(cuts), 0.0, 1.0))
        t = no_longer(t, spacing / length)
        steps = np.diff(t)
        keep = steps > _NONE
        middle, half = 0.5 * (t[1:] + t[:-1])[keep], 0.5 * steps[keep]
        places = (middle[:, None] + half[:, None] * at).ravel()
        shares = (half[:, None] * weights).ravel()
        x.append(a + places[:, None] * along)
        areas.append(shares[:, None] * np.array([along[1], -along[0]]))
    return np.concatenate(x), np.concatenate(areas)


def gauss(rule: int) -> tuple[Array, Array]:
    """Places of the Gauss points of a piece between -1 and 1, and their weights."""
    return np.polynomial.legendre.leggauss(whole("rule", rule, 1, 100))


def no_longer(line: Array, longest: float) -> Array:
    """Lines of cells, with each cell cut into equal pieces no longer than some length (m).

    Raises:
        ParameterError: There would be more than a million pieces.
    """
    parts = np.maximum(np.ceil(np.diff(line) / longest - 1e-9), 1)
    if (parts == 1).all():
        return line
    if parts.sum() > _MOST:
        raise ParameterError(
            f"spacing cuts {line[-1] - line[0]:g} m into {parts.sum():.3g} pieces, and {_MOST:g} "
            "is the limit: give the greatest length of a piece in m"
        )
    begin = [
        np.linspace(a, b, n, endpoint=False) for a, b, n in zip(line, line[1:], parts.astype(int))
    ]
    return np.append(np.concatenate(begin), line[-1])


def _around(line: Array, a: float, b: float) -> Array:
    """The lines of the cells between two places (m)."""
    first = int(np.searchsorted(line, min(a, b), side="right")) - 1
    last = int(np.searchsorted(line, max(a, b), side="left"))
    return line[max(first, 0) : last + 1]


def _half(polygon: Array, d: int, level: float, above: bool) -> Array:
    """The part of a convex polygon on one side of a plane across an axis."""
    s = (polygon[:, d] - level) * (1.0 if above else -1.0)
    kept = []
    for k in range(len(polygon)):
        n = (k + 1) % len(polygon)
        if s[k] >= 0:
            kept.append(polygon[k])
        if s[k] * s[n] < 0:
            kept.append(polygon[k] + s[k] / (s[k] - s[n]) * (polygon[n] - polygon[k]))
    return np.array(kept).reshape(-1, 3)


def cut_triangles(
    corners: Array, lines: Sequence[Array] | None, coarse: bool = False
) -> tuple[Array, Array]:
    """Quadrature points of triangles in space and their area vectors.

    Args:
        corners: Corners (m), shape (n, 3, 3); the normal is that of their right-handed turn.
        lines: Grid lines (m) in each direction, where the triangles are cut; or None.
        coarse: Whether three points a piece are enough, instead of six.

    Returns:
        Positions (m) and area vectors (m²), both of shape (markers, 3).
    """
    pieces = []
    for triangle in corners:
        parts = [triangle]
        for d, line in enumerate(lines or ()):
            low, high = triangle[:, d].min(), triangle[:, d].max()
            for level in line[(line > low) & (line < high)]:
                halves = [_half(p, d, level, side) for p in parts for side in (False, True)]
                parts = [p for p in halves if len(p) > 2]
        whole = np.linalg.norm(np.cross(*(triangle[1:] - triangle[0])))
        for polygon in parts:
            for k in range(1, len(polygon) - 1):
                piece = polygon[[0, k, k + 1]]
                if np.linalg.norm(np.cross(*(piece[1:] - piece[0]))) > _NONE * whole:
                    pieces.append(piece)
    made = np.array(pieces).reshape(-1, 3, 3)
    area = 0.5 * np.cross(made[:, 1] - made[:, 0], made[:, 2] - made[:, 0])
    rule, weights = (_COARSE, np.full(3, 1 / 3)) if coarse else (_TRIANGLE, _WEIGHTS)
    x = np.einsum("qk,nki->nqi", rule, made)
    return x.reshape(-1, 3), (area[:, None, :] * weights[:, None]).reshape(-1, 3)


def quartered(corners: Array, longest: float) -> Array:
    """Triangles in space, halved along all sides until no side is longer than a length.

    Args:
        corners: Corners (m), shape (n, 3, 3).
        longest: Longest side (m).

    Returns:
        Triangles with the same normals, shape (pieces, 3, 3).
    """
    done = []
    while len(corners):
        sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
        fits = sides <= longest * (1 + 1e-9)
        done.append(corners[fits])
        a, b, c = np.moveaxis(corners[~fits], 1, 0)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
    return np.concatenate(done) if done else corners


def kuhn(d: int) -> npt.NDArray[np.intp]:
    """Simplices that a cube falls into (Kuhn's), by its corners in the order of `np.ndindex`.

    Returns:
        Shape (d!, d + 1).
    """
    rows = []
    for order in itertools.permutations(range(d)):
        corner, path = [0] * d, [0]
        for axis in order:
            corner[axis] = 1
            path.append(int(np.ravel_multi_index(corner, (2,) * d)))
        rows.append(path)
    return np.array(rows)


def contour(corners: Array, values: Array) -> Array:
    """Where functions that are linear on simplices vanish.

    Args:
        corners: Corners of the simplices (m), shape (n, d + 1, d).
        values: The function there, negative inside, shape (n, d + 1).

    Returns:
        Segments or triangles (m), shape (pieces, d, d), with the outside to the right of a
        segment and on the side of a triangle's right-handed normal.
    """
    d = corners.shape[2]
    pieces = [np.empty((0, d, d))]
    inside = values < 0
    for pattern in np.unique(inside, axis=0):
        inner, outer = np.flatnonzero(pattern), np.flatnonzero(~pattern)
        if not (inner.size and outer.size):
            continue
        chosen = np.all(inside == pattern, axis=1)
        x, f = corners[chosen], values[chosen]

        def at(i, j, x=x, f=f):
            share = f[:, i] / (f[:, i] - f[:, j])
            return x[:, i] + share[:, None] * (x[:, j] - x[:, i])

        points = [at(i, j) for i in inner for j in outer]
        if len(points) == 4:
            # of a tetrahedron: a quadrilateral, whose corners go round
            faces = [[points[k] for k in (0, 1, 3)], [points[k] for k in (0, 3, 2)]]
        else:
            faces = [points]
        away = x[:, outer].mean(axis=1) - x[:, inner].mean(axis=1)
        for face in faces:
            made = np.stack(face, axis=1)
            edges = made[:, 1:] - made[:, :1]
            n = np.cross(edges[:, 0], edges[:, 1]) if d == 3 else edges[:, 0, ::-1] * (1.0, -1.0)
            turned = np.einsum("pi,pi->p", n, away) < 0
            made[turned] = made[turned][:, [1, 0, *range(2, d)]]
            size = np.linalg.norm(n, axis=1)
            largest = np.ptp(x, axis=1).max(axis=1) ** (d - 1)
            pieces.append(made[size > _NONE * largest])
    return np.concatenate(pieces)


def inside(triangles: Array, values: Array) -> Array:
    """Parts of triangles in the plane where functions that are linear on them are negative.

    Args:
        triangles: Corners (m), shape (n, 3, 2).
        values: The function there, shape (n, 3).

    Returns:
        Triangles, shape (pieces, 3, 2).
    """
    order = np.argsort(values, axis=1)
    x = np.take_along_axis(triangles, order[:, :, None], axis=1)
    f = np.take_along_axis(values, order, axis=1)
    count = np.sum(f < 0, axis=1)

    def cut(rows, i, j):
        share = f[rows, i] / (f[rows, i] - f[rows, j])
        return x[rows, i] + share[:, None] * (x[rows, j] - x[rows, i])

    one, two = count == 1, count == 2
    a, b = cut(two, 0, 2), cut(two, 1, 2)
    return np.concatenate(
        [
            x[count == 3],
            np.stack([x[one, 0], cut(one, 0, 1), cut(one, 0, 2)], axis=1),
            np.stack([x[two, 0], x[two, 1], b], axis=1),
            np.stack([x[two, 0], b, a], axis=1),
        ]
    )
