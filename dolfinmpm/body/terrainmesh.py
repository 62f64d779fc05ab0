"""Triangles around the ground below a raster of heights."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["closed_mesh"]

Array = npt.NDArray[np.float64]


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
