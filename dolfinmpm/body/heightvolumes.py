"""Volumes and centroids between two bilinear surfaces on one raster, and triangles around them.

On a cell of the raster the thickness f = top − bottom is bilinear. Where f is not negative at the
four corners, Gauss points give the integrals of f, x f, y f and of (top² − bottom²)/2 exactly.
Where f changes its sign, only the part with f > 0 counts. For given x the function f is linear in
y, so that the part in y is an interval between known ends. In x the cell is divided where f
vanishes on one of its two edges. On each part the integrand is smooth, and 16 Gauss points per
part give it to about 1e-12.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["closed_mesh", "volume_between"]

Array = npt.NDArray[np.float64]

_GAUSS = 16


def volume_between(x: Array, y: Array, top: Array, bottom: Array) -> tuple[float, Array]:
    """Volume between two surfaces where the first is above the second, and its centroid.

    Args:
        x, y: Lines of the raster (m), shapes (nx,) and (ny,).
        top, bottom: Heights of the surfaces (m), shape (nx, ny).

    Returns:
        Volume (m³), and centroid (m), shape (3,); nan without volume.
    """
    f = top - bottom
    corners = np.stack([f[:-1, :-1], f[1:, :-1], f[:-1, 1:], f[1:, 1:]])
    i, j = np.nonzero(corners.max(axis=0) > 0.0)
    whole = corners.min(axis=0)[i, j] >= 0.0
    # from the middle of the raster: far from the origin, the products would cancel
    shift = np.array([x.mean(), y.mean(), float(top.mean())])
    sums = np.zeros(4)
    for part, make in ((whole, _whole), (~whole, _cut)):
        a, b = i[part], j[part]
        if not a.size:
            continue
        cell = [(g[a, b], g[a + 1, b], g[a, b + 1], g[a + 1, b + 1]) for g in (top, bottom)]
        at = x[a] - shift[0], x[a + 1] - x[a], y[b] - shift[1], y[b + 1] - y[b]
        s, t, weight = make(*(np.array(one) for one in cell))
        high, low = (_bilinear(np.array(one), s, t) - shift[2] for one in cell)
        w = weight * (high - low) * (at[1] * at[3])[:, None]
        px = at[0][:, None] + at[1][:, None] * s
        py = at[2][:, None] + at[3][:, None] * t
        sums += [w.sum(), (w * px).sum(), (w * py).sum(), 0.5 * (w * (high + low)).sum()]
    if not sums[0] > 0.0:
        return 0.0, np.full(3, np.nan)
    return float(sums[0]), shift + sums[1:] / sums[0]


def _bilinear(corner: Array, s: Array, t: Array) -> Array:
    """Values at local coordinates of cells, shape (cells, n), from values at the corners."""
    c = corner[:, :, None]
    return (1 - t) * ((1 - s) * c[0] + s * c[1]) + t * ((1 - s) * c[2] + s * c[3])


def _rule(n: int) -> tuple[Array, Array]:
    """Gauss points and weights on [0, 1]."""
    at, weight = np.polynomial.legendre.leggauss(n)
    return 0.5 * (at + 1.0), 0.5 * weight


def _whole(top: Array, bottom: Array) -> tuple[Array, Array, Array]:
    """Points in whole cells: local coordinates and weights, shape (cells, 4)."""
    at, weight = _rule(2)
    shape = top.shape[1], 4
    s, t = np.repeat(at, 2), np.tile(at, 2)
    w = np.repeat(weight, 2) * np.tile(weight, 2)
    return np.broadcast_to(s, shape), np.broadcast_to(t, shape), np.broadcast_to(w, shape)


def _cut(top: Array, bottom: Array) -> tuple[Array, Array, Array]:
    """Points where the thickness is positive, in cells in which it changes its sign."""
    f = top - bottom
    lines: list[Array] = [np.zeros(f.shape[1]), np.ones(f.shape[1])]
    with np.errstate(divide="ignore", invalid="ignore"):
        for a, b in ((f[0], f[1]), (f[2], f[3])):
            root = a / (a - b)
            lines.append(np.where((root > 0.0) & (root < 1.0), root, 0.0))
    ends: Array = np.sort(np.array(lines), axis=0)
    at, weight = _rule(_GAUSS)
    length = np.diff(ends, axis=0)
    # shape (3 parts, cells, Gauss points)
    s = ends[:-1, :, None] + length[:, :, None] * at
    lower, upper = (a[:, None] * (1 - s) + b[:, None] * s for a, b in ((f[0], f[1]), (f[2], f[3])))
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.nan_to_num(lower / (lower - upper))
    first = np.where(lower > 0.0, 0.0, np.where(upper > 0.0, root, 1.0))
    last = np.where(upper > 0.0, 1.0, np.where(lower > 0.0, root, 0.0))
    span = np.maximum(last - first, 0.0)
    points, weights = _rule(2)
    t = first[..., None] + span[..., None] * points
    w = (length[:, :, None] * weight * span)[..., None] * weights
    shape = f.shape[1], -1
    s = np.broadcast_to(s[..., None], t.shape)
    return tuple(np.moveaxis(one, 1, 0).reshape(shape) for one in (s, t, w))  # type: ignore[return-value]


def closed_mesh(x: Array, y: Array, z: Array, bottom: float) -> Any:
    """A closed `meshio.Mesh` between a surface and a level bottom, with outward normals.

    Args:
        x, y: Lines of the raster (m), shapes (nx,) and (ny,).
        z: Heights (m), shape (nx, ny).
        bottom: Height of the bottom (m).
    """
    import meshio

    nx, ny = z.shape
    number_of = np.arange(nx * ny).reshape(nx, ny)
    a, b = number_of[:-1, :-1].ravel(), number_of[1:, :-1].ravel()
    c, d = number_of[1:, 1:].ravel(), number_of[:-1, 1:].ravel()
    # along the lower diagonal the triangles are below the bilinear surface
    flip = (z[:-1, :-1] + z[1:, 1:] > z[1:, :-1] + z[:-1, 1:]).ravel()[:, None]
    top = np.concatenate(
        [
            np.where(flip, np.column_stack([a, b, d]), np.column_stack([a, b, c])),
            np.where(flip, np.column_stack([b, c, d]), np.column_stack([a, c, d])),
        ]
    )
    below = top[:, ::-1] + nx * ny
    # around the edge, anticlockwise as seen from above
    edge = np.concatenate(
        [number_of[:, 0], number_of[-1, 1:], number_of[-2::-1, -1], number_of[0, -2:0:-1]]
    )
    p, q = edge, np.roll(edge, -1)
    low_p, low_q = p + nx * ny, q + nx * ny
    sides = np.concatenate([np.column_stack([p, low_p, low_q]), np.column_stack([p, low_q, q])])
    X, Y = (one.ravel() for one in np.meshgrid(x, y, indexing="ij"))
    upper = np.column_stack([X, Y, z.ravel()])
    lower = np.column_stack([X, Y, np.full(X.size, bottom)])
    return meshio.Mesh(
        np.concatenate([upper, lower]), [("triangle", np.concatenate([top, below, sides]))]
    )
