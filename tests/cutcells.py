"""Material points that integrate exactly over the part of each cell that a body fills."""

from __future__ import annotations

import numpy as np

import dolfinmpm as mpm
from dolfinmpm.body.contours import inside, kuhn


def centroids(lines, levels, parts=1):
    """Centroids and areas of triangles that fill a body, cell by cell.

    Args:
        lines: Grid lines in both directions (m).
        levels: Functions of positions, shape (n, 2), all negative in the body.
        parts: Parts of a cell in each direction.
    """
    fine = [np.interp(np.arange(0, len(x) - 1 + 1e-9, 1 / parts), np.arange(len(x)), x)
            for x in lines]  # fmt: skip
    corners = np.stack(np.meshgrid(*(x[:-1] for x in fine), indexing="ij"), axis=-1).reshape(-1, 2)
    sizes = np.stack(np.meshgrid(*map(np.diff, fine), indexing="ij"), axis=-1).reshape(-1, 2)
    cube = np.array(list(np.ndindex(2, 2)), float)
    pieces = (corners[:, None] + cube * sizes[:, None])[:, kuhn(2)].reshape(-1, 3, 2)
    for level in levels:
        pieces = inside(pieces, level(pieces.reshape(-1, 2)).reshape(-1, 3))
    edges = pieces[:, 1:] - pieces[:, :1]
    area = 0.5 * np.abs(np.linalg.det(edges))
    keep = area > 1e-14 * np.prod([x[-1] - x[0] for x in lines])
    return pieces[keep].mean(axis=1), area[keep]


def cut_body(grid, lines, levels, parts=1, density=1.0):
    """The points of such a body."""
    x, area = centroids(lines, levels, parts)
    return mpm.MaterialPoints.from_arrays(grid, x, area, density)


def boxes(lines, low, high, per_cell=2):
    """Centres and half-lengths of boxes that fill a box, each in one cell; any dimension."""
    along = []
    for line, a, b in zip(lines, low, high):
        ends = np.unique(np.concatenate([[a, b], line[(line > a) & (line < b)]]))
        fine = np.interp(np.arange(0, len(ends) - 1 + 1e-9, 1 / per_cell), np.arange(len(ends)),
                         ends)  # fmt: skip
        along.append((0.5 * (fine[1:] + fine[:-1]), 0.5 * np.diff(fine)))
    x = np.stack(np.meshgrid(*(x for x, _ in along), indexing="ij"), axis=-1)
    half = np.stack(np.meshgrid(*(h for _, h in along), indexing="ij"), axis=-1)
    d = len(along)
    return x.reshape(-1, d), half.reshape(-1, d)
