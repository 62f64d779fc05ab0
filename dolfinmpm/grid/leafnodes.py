"""Nodes of leaves, and hanging nodes: nodes on the side of a larger leaf that are no corner of it.

A function on leaves is continuous if each hanging node follows the corners of the larger leaf: ½
and ½ on an edge, ¼ of four corners in a side. A corner may itself hang on a still larger leaf; the
weights are then products.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.grid.leafsearch import node_at
from dolfinmpm.grid.leaves import Leaves, Tree

if TYPE_CHECKING:
    from scipy import sparse

__all__ = ["LeafNodes"]

Ints = npt.NDArray[np.int32]


@numba.njit(cache=True, error_model="numpy")
def _larger_leaf(fine, levels, shape, low, size, child, number, larger):
    """Write the largest leaf on whose side each node hangs, or -1."""
    d = fine.shape[1]
    k = np.empty(d, np.int64)
    for a in range(fine.shape[0]):
        larger[a] = -1
        most = 0
        for corner in range(1 << d):
            for j in range(d):
                k[j] = fine[a, j] - ((corner >> j) & 1)
            node = node_at(k, levels, shape, low, size, child)
            if node < 0 or number[node] < 0 or size[node] <= most:
                continue
            for j in range(d):
                if low[node, j] < fine[a, j] < low[node, j] + size[node]:
                    larger[a], most = number[node], size[node]


@dataclass(frozen=True, eq=False)
class LeafNodes:
    """Nodes of all leaves, the same on all ranks, in the order of their lines.

    Attributes:
        fine: Numbers of their lines on the finest level, shape (nodes, gdim).
        corners: Nodes of each leaf, the last direction fastest, shape (leaves, 2^gdim).
        first: Lowest leaf of each node, shape (nodes,).
        hanging: Mask of the hanging nodes, shape (nodes,).
        matrix: Values of all nodes from the values of those that do not hang, shape (nodes, nodes).
    """

    fine: Ints
    corners: Ints
    first: Ints
    hanging: npt.NDArray[np.bool_]
    matrix: sparse.csr_matrix

    @classmethod
    def of(cls, leaves: Leaves) -> LeafNodes:
        """The nodes of some leaves."""
        low, size, tree = leaves.low, leaves.size, leaves.tree
        gdim = low.shape[1]
        offsets = np.array(list(np.ndindex(*(2,) * gdim)), np.int32)
        every = (low[:, None] + offsets * size[:, None, None]).reshape(-1, gdim)
        extent = (np.array(tree.lattice.shape, np.int64) << tree.levels) + 1
        keys = np.ravel_multi_index(tuple(every.T), tuple(extent)) if len(every) else every[:, 0]
        _, at, corner = np.unique(keys, return_index=True, return_inverse=True)
        fine, corners = every[at], corner.reshape(-1, 1 << gdim).astype(np.int32)
        # entries of a leaf stand together, and the first entry of a node is in its lowest leaf
        first = (at // (1 << gdim)).astype(np.int32)
        larger = np.empty(len(fine), np.int32)
        _, _, *search = tree.search
        _larger_leaf(fine.astype(np.int64), *search, leaves.number, larger)
        return cls(fine, corners, first, larger >= 0, _followed(leaves, fine, corners, larger))

    def inner_knots(self, tree: Tree) -> npt.NDArray[np.float64]:
        """Inner knots of the functions: positions of the nodes (m), shape (nodes, gdim, 1)."""
        return tree.coordinates(self.fine)[:, :, None]

    def at(self, leaves: Leaves, fine: Ints, of: Ints) -> sparse.csr_matrix:
        """Values at positions in leaves from the values of the nodes, shape (n, nodes).

        Args:
            leaves: The leaves of these nodes.
            fine: Numbers of the positions' lines on the finest level, shape (n, gdim).
            of: A leaf that contains each position, shape (n,).
        """
        return _in_leaves(leaves, self.corners, fine, of, len(self.fine))


def _in_leaves(leaves: Leaves, corners: Ints, fine: Ints, of: Ints, count: int):
    """Values at lines of the finest level from the corners of leaves, shape (n, count)."""
    from scipy import sparse

    gdim = fine.shape[1]
    share = (fine - leaves.low[of]) / leaves.size[of, None]
    weights = np.ones((len(fine), 1 << gdim))
    for a, offset in enumerate(np.ndindex(*(2,) * gdim)):
        for d, upper in enumerate(offset):
            weights[:, a] *= share[:, d] if upper else 1.0 - share[:, d]
    start = (1 << gdim) * np.arange(len(fine) + 1)
    shape = len(fine), count
    matrix = sparse.csr_matrix((weights.ravel(), corners[of].ravel(), start), shape=shape)
    matrix.eliminate_zeros()
    return matrix


def _followed(leaves: Leaves, fine: Ints, corners: Ints, larger: Ints) -> sparse.csr_matrix:
    """The matrix of hanging nodes."""
    from scipy import sparse

    n = len(fine)
    free, rows = np.flatnonzero(larger < 0), np.flatnonzero(larger >= 0)
    hanging = _in_leaves(leaves, corners, fine[rows], larger[rows], n).tocoo()
    i = np.concatenate([free, rows[hanging.row]])
    j = np.concatenate([free, hanging.col])
    values = np.concatenate([np.ones(free.size), hanging.data])
    matrix = sparse.csr_matrix((values, (i, j)), shape=(n, n))
    # masters that hang follow their own masters
    while matrix.nnz and np.any(larger[matrix.indices] >= 0):
        matrix = sparse.csr_matrix(matrix @ matrix)
    matrix.sort_indices()
    return matrix
