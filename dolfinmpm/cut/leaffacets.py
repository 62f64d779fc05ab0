"""Ghost facets between leaves: sides of the smaller one of two neighbours."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import LeafBasis
from dolfinmpm.grid.leafsearch import node_at

__all__ = ["ghost_facets_of_leaves"]


@numba.njit(cache=True, error_model="numpy")
def _across(k, c, low, size, axis, upper, sample):
    """Write the finest cell beyond a side of leaf c: the sample-th of 2^(d − 1) in its quarters."""
    half = size[c] // 2
    for j in range(k.size):
        if j == axis:
            k[j] = low[c, j] + (size[c] if upper else -1)
        else:
            k[j] = low[c, j] + (half if sample & 1 else 0)
            sample >>= 1


@numba.njit(cache=True, error_model="numpy")
def _beside_inactive(low, size, owned, active, cell_of, search, boundary):
    """Mark active leaves with an inactive neighbour, or with a side that active ones only share."""
    levels, shape, tree_low, tree_size, child = search
    d = low.shape[1]
    k = np.empty(d, np.int64)
    for c in range(owned):
        if not active[c]:
            continue
        for axis in range(d):
            for upper in range(2):
                for sample in range(1 << (d - 1)):
                    _across(k, c, low, size, axis, upper, sample)
                    node = node_at(k, levels, shape, tree_low, tree_size, child)
                    if node >= 0 and (cell_of[node] < 0 or not active[cell_of[node]]):
                        boundary[c] = True


@numba.njit(cache=True, error_model="numpy")
def _facets(low, size, owned, active, cell_of, search, boundary, rows):
    """Write the facets as (cell, local facet, cell, local facet), the smaller cell first."""
    levels, shape, tree_low, tree_size, child = search
    d = low.shape[1]
    k = np.empty(d, np.int64)
    number = 0
    for c in range(owned):
        if not active[c]:
            continue
        for axis in range(d):
            for upper in range(2):
                _across(k, c, low, size, axis, upper, 0)
                node = node_at(k, levels, shape, tree_low, tree_size, child)
                other = cell_of[node] if node >= 0 else -1
                if other < 0 or not active[other] or size[other] < size[c]:
                    continue
                if size[other] == size[c] and not upper:
                    continue
                if boundary[c] or boundary[other]:
                    if number < rows.shape[0]:
                        rows[number, 0], rows[number, 1] = c, 2 * axis + upper
                        rows[number, 2], rows[number, 3] = other, 2 * axis + 1 - upper
                    number += 1
    return number


def ghost_facets_of_leaves(
    active: npt.NDArray[np.bool_], empty: npt.NDArray[np.bool_], basis: LeafBasis
) -> npt.NDArray[np.int32]:
    """Facets between active leaves of which at least one borders on an inactive cell. Collective.

    A local facet is 2 axis, or 2 axis + 1 for the upper side. The facet is a side of the first
    cell, and the second cell is not smaller. A side at the edge of the grid makes no boundary cell.

    Args:
        active: Mask of the active cells of the basis.
        empty: Mask of those that are boundary cells wherever they lie.
        basis: The basis on leaves.

    Returns:
        Rows (cell, local facet, cell, local facet), flattened.
    """
    tree, leaves = basis.leaves.tree, basis.leaves
    low, size = leaves.low[basis.leaf], leaves.size[basis.leaf]
    cell_of = basis.cells_of_nodes()
    _, _, *search = tree.search
    boundary = empty.copy()
    graph = low, size, basis.cells.owned, active, cell_of, tuple(search)
    _beside_inactive(*graph, boundary)
    boundary = basis.cells.share_flags(boundary)
    rows = np.empty((0, 4), np.int32)
    for _ in range(2):  # first count, then fill
        number = _facets(*graph, boundary, rows)
        if number <= len(rows):
            break
        rows = np.empty((number, 4), np.int32)
    return rows.ravel()
