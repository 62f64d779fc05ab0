"""Grids of studies: equal cells in a box, or cells between given lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

__all__ = ["box_grid", "grid_of_lines", "growing", "halved", "lines"]


def box_grid(
    corners: Sequence[Any], cells: Sequence[int], comm: MPI.Comm = MPI.COMM_WORLD
) -> mesh.Mesh:
    """A grid of equal intervals, rectangles or boxes. Collective.

    Args:
        corners: Lowest and highest corner (m), shape (2, d).
        cells: Number of cells in each direction, shape (d,).
        comm: Its ranks.
    """
    if len(cells) == 1:
        return mesh.create_interval(comm, cells[0], [corner[0] for corner in corners])
    if len(cells) == 2:
        return mesh.create_rectangle(comm, corners, cells, mesh.CellType.quadrilateral)
    return mesh.create_box(comm, corners, cells, mesh.CellType.hexahedron)


def grid_of_lines(*axes: np.ndarray) -> mesh.Mesh:
    """A grid of rectangles or boxes between lines on all ranks. Collective.

    Args:
        axes: Coordinates of the lines in each direction (m), growing.
    """
    n = [len(axis) - 1 for axis in axes]
    grid = box_grid([(0.0,) * len(n), n], n)
    x = grid.geometry.x
    for k, axis in enumerate(axes):
        x[:, k] = axis[np.rint(x[:, k]).astype(int)]
    return grid


def lines(length, at, h, coarsest):
    """Ends of cells in [0, length], a line at `at`, where their size is h (m)."""

    def half(reach):
        sizes = [h]
        while sum(sizes) < reach - 1e-9:
            sizes.append(min(1.2 * sizes[-1], coarsest))
        return np.cumsum(sizes) * reach / sum(sizes) if reach > 0 else np.empty(0)

    return np.r_[at - half(at)[::-1], at, at + half(length - at)]


def growing(h, length, growth):
    """Ends of cells on a length, each larger than the one before, the first more than h (m)."""
    if length < 0.5 * h:
        return np.empty(0)
    sizes = [h * growth]
    while sum(sizes) < length - 1e-9:
        sizes.append(sizes[-1] * growth)
    return np.cumsum(sizes) * (length / sum(sizes))


def halved(args, place):
    """Arguments of a space whose cells are halved towards a place (m), or none if none are.

    Args:
        args: `refine`, the least size (m) or None; `growth` with distance (-); `coarsest`, the size
            of the grid's cells (m); and `points_per_cell`.
        place: The place, shape (d,).
    """
    if args.refine is None:
        return {}

    def size(x):
        apart = np.linalg.norm(x[: len(place)] - np.reshape(place, (-1, 1)), axis=0)
        return np.maximum(args.refine, args.growth * apart) * 1.0001

    levels = max(0, math.ceil(math.log2(args.coarsest / args.refine) - 1e-3))
    return {"refine": size, "levels": levels, "per_cell": args.points_per_cell}
