"""Prolongation: some nodes' values as combinations of others'.

The solver sees the unknowns x of the nodes that remain, the grid sees u = C x. At
the material points C is taken into the stencils, so that what is assembled is
Cᵀ K C and Cᵀ f already; the matrices of DOLFINx's assemblers are multiplied.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse

from dolfinmpm.basis import Stencils
from dolfinmpm.basis.stencils import group_starts, running_sum
from dolfinmpm.errors import ParameterError

__all__ = ["Prolongation", "reduce_blocks"]


def reduce_blocks(matrix: sparse.csr_matrix, rows, columns, blocks):
    """Tᵀ A T of a matrix A given by blocks between nodes; returned in the same form.

    Args:
        matrix: T, shape (nodes of A, nodes of the result).
        rows: Node of each block's row, shape (n,).
        columns: Node of each block's column, shape (n,).
        blocks: The blocks, shape (n, components, components).
    """
    components = blocks.shape[1]
    inner = np.arange(components)
    # only what A touches takes part, however large the grid is
    touched, place = np.unique(np.concatenate([rows, columns]), return_inverse=True)
    part = matrix[touched]
    kept, local = np.unique(part.indices, return_inverse=True)
    part = sparse.csr_matrix((part.data, local, part.indptr), shape=(touched.size, kept.size))
    rows, columns = place[: rows.size], place[rows.size :]
    size = touched.size * components
    i = (rows[:, None, None] * components + inner[:, None]) + 0 * inner
    j = (columns[:, None, None] * components + inner) + 0 * inner[:, None]
    whole = sparse.csr_matrix((blocks.ravel(), (i.ravel(), j.ravel())), shape=(size, size))
    T = sparse.kron(part, sparse.identity(components), format="csr")
    reduced = sparse.bsr_matrix(T.T @ whole @ T, blocksize=(components, components))
    new_rows = np.repeat(np.arange(reduced.indptr.size - 1), np.diff(reduced.indptr))
    return (
        kept[new_rows].astype(np.int32),
        kept[reduced.indices].astype(np.int32),
        np.ascontiguousarray(reduced.data),
    )


class Prolongation:
    """A matrix C from the values of the nodes that remain to those of all nodes.

    Args:
        matrix: C, shape (nodes, nodes) in local numbering. The row of a node that
            remains is its unit row; the column of one that does not is empty.

    Raises:
        ParameterError: The matrix is not of that form.
    """

    def __init__(self, matrix: sparse.spmatrix):
        self.matrix = sparse.csr_matrix(matrix)
        nodes = np.arange(self.matrix.shape[0])
        if self.matrix.shape[0] != self.matrix.shape[1]:
            raise ParameterError(f"C must be square in the nodes, got shape {self.matrix.shape}")
        self.tied = np.diff(self.matrix.indptr) != 1
        single = nodes[~self.tied]
        at = self.matrix.indptr[single]
        self.tied[single] = (self.matrix.indices[at] != single) | (self.matrix.data[at] != 1.0)
        used = np.unique(self.matrix.indices)
        if np.any(self.tied[used]):
            raise ParameterError(
                f"node {used[self.tied[used]][0]} is tied to others and others are tied to it; "
                "multiply the matrices first"
            )

    def __matmul__(self, other: Prolongation) -> Prolongation:
        """First `other`, then this one: u = C₁ C₂ x."""
        return Prolongation(self.matrix @ other.matrix)

    def expand(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Values of all nodes, u = C x, both of shape (nodes, components)."""
        return self.matrix @ x

    def stencils(self, s: Stencils) -> Stencils:
        """Stencils on the nodes that remain, N C and ∇N C."""
        if not np.any(self.tied[s.nodes]):
            return s
        per_group = np.diff(s.groups)
        sizes = np.repeat(np.diff(s.node_start), per_group)
        start = running_sum(sizes, np.int64)
        columns = np.concatenate(
            [np.tile(s.nodes[a:b], k)
             for a, b, k in zip(s.node_start[:-1], s.node_start[1:], per_group)]
        )  # fmt: skip
        shape = (s.order.size, self.matrix.shape[0])
        pieces = []
        for values in (s.N, *s.dN.T):
            product = sparse.csr_matrix((values, columns, start), shape=shape) @ self.matrix
            # the structure does not depend on the values: no entry is dropped
            product.sort_indices()
            pieces.append(product)
        first = group_starts(np.repeat(np.arange(per_group.size), per_group))[:-1]
        indptr = pieces[0].indptr
        nodes = np.concatenate([pieces[0].indices[indptr[p] : indptr[p + 1]] for p in first])
        node_start = running_sum(np.diff(indptr)[first], np.int32)
        return Stencils(
            s.order, s.groups, node_start, nodes.astype(np.int32),
            indptr[s.groups].astype(np.int64),
            pieces[0].data, np.column_stack([piece.data for piece in pieces[1:]]),
            s.cell_start, s.cells,
        )  # fmt: skip
