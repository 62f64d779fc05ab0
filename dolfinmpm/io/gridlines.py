"""Lines of the background grid in pictures, also those of the leaves of a refined space."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm.basis.refinement import leaves_on
from dolfinmpm.grid.lattice import lattice_of

__all__ = ["grid_lines", "lines_of_boxes", "lines_of_lattice"]

Array = npt.NDArray[Any]

_AXES = "xyz"
# with more lines the grid would look like a grey area
_MOST_CELLS = 200_000


def grid_lines(grid, cut) -> Array | None:
    """Ends of the grid's lines (m) in a plane, shape (lines, 2, 2), on rank 0. Collective."""
    lattice, dim, leaves = lattice_of(grid), grid.geometry.dim, leaves_on(grid)
    if leaves is not None and (dim == 2 or cut is not None):
        low, high = leaves.tree.corners(np.flatnonzero(leaves.tree.child < 0))
        if cut is not None:
            k = _AXES.index(cut[0])
            met = (low[:, k] <= cut[1]) & (cut[1] < high[:, k])
            low, high = (np.delete(ends[met], k, axis=1) for ends in (low, high))
        return lines_of_boxes(low, high)
    if lattice is not None and (dim == 2 or cut is not None):
        kept = [d for d in range(dim) if cut is None or _AXES[d] != cut[0]]
        a, b = (lattice.lines[d] for d in kept)
        return lines_of_lattice(a, b)
    cells = grid.topology.index_map(grid.topology.dim)
    if dim == 3 or cells.size_global > _MOST_CELLS:
        return None
    corners = grid.geometry.x[geometry_dofmap(grid)[: cells.size_local], :2]
    order = {3: (0, 1, 2), 4: (0, 1, 3, 2)}[corners.shape[1]]
    pieces = grid.comm.gather(np.stack([corners[:, order], np.roll(corners[:, order], -1, 1)], 2))
    if pieces is None:
        return None
    ends = np.concatenate([piece.reshape(-1, 2, 2) for piece in pieces])
    # an edge of two cells, in opposite directions, is drawn once
    first, last = ends[:, 0], ends[:, 1]
    turned = (first[:, 0] > last[:, 0]) | ((first[:, 0] == last[:, 0]) & (first[:, 1] > last[:, 1]))
    ends[turned] = ends[turned, ::-1]
    return np.unique(ends, axis=0)


def lines_of_lattice(a: Array, b: Array) -> Array:
    """Ends of the lines of a rectangular grid (m), from its coordinates along x and y."""
    return np.array([((s, b[0]), (s, b[-1])) for s in a] + [((a[0], s), (a[-1], s)) for s in b])


def lines_of_boxes(low: Array, high: Array) -> Array:
    """Sides of boxes that touch (m), each drawn once, shape (lines, 2, 2).

    The side of a box next to smaller boxes is left out: the smaller boxes have the same line.

    Args:
        low, high: Lowest and highest corners (m), shape (n, 2).
    """
    x = np.concatenate([low, high])
    unit = 1e-9 * np.ptp(x, axis=0).max(initial=1e-300)
    corners = np.stack([low, np.column_stack([high[:, 0], low[:, 1]]), high, low + 0.0], axis=1)
    corners[:, 3, 1] = high[:, 1]
    found = []
    # sides along x, and along y
    for pairs in ((0, 1), (3, 2)), ((0, 3), (1, 2)):
        sides = np.concatenate([corners[:, pair] for pair in pairs])
        numbers = np.rint(sides / unit).astype(np.int64)
        _, first = np.unique(numbers.reshape(-1, 4), axis=0, return_index=True)
        sides, numbers = sides[first], numbers[first]
        ends = {tuple(end) for end in numbers.reshape(-1, 2).tolist()}
        middles = np.rint(sides.mean(axis=1) / unit).astype(np.int64).tolist()
        found.append(sides[[tuple(middle) not in ends for middle in middles]])
    return np.concatenate(found)
