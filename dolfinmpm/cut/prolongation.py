"""Prolongation: values of constrained nodes as combinations of values of independent nodes.

The solver uses the unknowns x of the independent nodes, the grid uses u = C x. The stencils of the
material points contain C. So their assembly directly gives Cᵀ K C and Cᵀ f. The matrices of
DOLFINx's assemblers are multiplied by C.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numba
import numpy as np

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis import Stencils
from dolfinmpm.basis.stencils import running_sum
from dolfinmpm.cut.pattern import Blocks

if TYPE_CHECKING:
    from scipy import sparse

__all__ = ["Prolongation", "reduce_blocks"]


@numba.njit(cache=True, error_model="numpy")
def _prolong(
    groups, node_start, nodes, value_start, N, dN, indptr, indices, weights, place, counts,
    new_start, new_value_start, new_nodes, new_N, new_dN,
):  # fmt: skip
    """Rows of N C and ∇N C of every group; only counts their nodes if the arrays are empty."""
    gdim = dN.shape[1]
    for g in range(groups.size - 1):
        count = 0
        for at in range(node_start[g], node_start[g + 1]):
            for k in range(indptr[nodes[at]], indptr[nodes[at] + 1]):
                if place[indices[k]] < 0:
                    place[indices[k]] = 0
                    if new_start.size:
                        new_nodes[new_start[g] + count] = indices[k]
                    count += 1
        counts[g] = count
        if new_start.size:
            own = new_nodes[new_start[g] : new_start[g] + count]
            own.sort()
            for b in range(count):
                place[own[b]] = b
            m = node_start[g + 1] - node_start[g]
            for position in range(groups[g + 1] - groups[g]):
                old, new = value_start[g] + position * m, new_value_start[g] + position * count
                for b in range(count):
                    new_N[new + b] = 0.0
                    for d in range(gdim):
                        new_dN[new + b, d] = 0.0
                for a in range(m):
                    node = nodes[node_start[g] + a]
                    for k in range(indptr[node], indptr[node + 1]):
                        b = new + place[indices[k]]
                        new_N[b] += N[old + a] * weights[k]
                        for d in range(gdim):
                            new_dN[b, d] += dN[old + a, d] * weights[k]
        for at in range(node_start[g], node_start[g + 1]):
            for k in range(indptr[nodes[at]], indptr[nodes[at] + 1]):
                place[indices[k]] = -1


def reduce_blocks(
    row_matrix: sparse.csr_matrix | None, column_matrix: sparse.csr_matrix | None, blocks: Blocks
) -> Blocks:
    """T_iᵀ A T_j for blocks A, in the same format.

    Args:
        row_matrix, column_matrix: T of the row and of the column field, shape (nodes of A,
            nodes of the result), or None for the identity.
        blocks: A.
    """
    from scipy import sparse

    rows, columns, values = blocks.rows, blocks.columns, blocks.values
    row_part, rows, new_rows = _part(row_matrix, rows)
    column_part, columns, new_columns = _part(column_matrix, columns)
    shape = row_part.shape[0], column_part.shape[0]
    n, m = values.shape[1:]
    scalar = values[:, 0, 0]
    if n == m and np.array_equal(values, scalar[:, None, None] * np.eye(n)):
        # components do not mix, as in a ghost penalty: one product serves all components
        whole = sparse.csr_matrix((scalar, (rows, columns)), shape=shape)
        single = sparse.csr_matrix(row_part.T @ whole @ column_part)
        made = np.repeat(np.arange(new_rows.size), np.diff(single.indptr))
        return replace(
            blocks,
            rows=new_rows[made].astype(np.int32),
            columns=new_columns[single.indices].astype(np.int32),
            values=single.data[:, None, None] * np.eye(n),
        )
    i = rows[:, None, None] * n + np.arange(n)[:, None] + 0 * np.arange(m)
    j = columns[:, None, None] * m + np.arange(m) + 0 * np.arange(n)[:, None]
    size = shape[0] * n, shape[1] * m
    whole = sparse.csr_matrix((values.ravel(), (i.ravel(), j.ravel())), shape=size)
    left = sparse.kron(row_part, sparse.identity(n), format="csr")
    right = sparse.kron(column_part, sparse.identity(m), format="csr")
    reduced = sparse.bsr_matrix(left.T @ whole @ right, blocksize=(n, m))
    made = np.repeat(np.arange(reduced.indptr.size - 1), np.diff(reduced.indptr))
    return replace(
        blocks,
        rows=new_rows[made].astype(np.int32),
        columns=new_columns[reduced.indices].astype(np.int32),
        values=np.ascontiguousarray(reduced.data),
    )


def _part(matrix: sparse.csr_matrix | None, nodes):
    """The rows of T for the nodes of A, the rows' numbers per entry, and the nodes of the columns.

    The cost depends on the nodes of A, not on the size of the grid.
    """
    from scipy import sparse

    touched, place = np.unique(nodes, return_inverse=True)
    if matrix is None:
        return sparse.identity(touched.size, format="csr"), place, touched
    part = matrix[touched]
    kept, local = np.unique(part.indices, return_inverse=True)
    part = sparse.csr_matrix((part.data, local, part.indptr), shape=(touched.size, kept.size))
    return part, place, kept


class Prolongation:
    """A matrix C from values of the independent nodes to values of all nodes.

    Args:
        matrix: C, shape (nodes, nodes) in local numbering. An independent node has a unit row. A
            constrained node has an empty column.

    Attributes:
        matrix: The argument.
        constrained: Mask of the constrained nodes, shape (nodes,).

    Raises:
        ParameterError: The matrix has another form.
    """

    def __init__(self, matrix: sparse.spmatrix):
        from scipy import sparse

        self.matrix = sparse.csr_matrix(matrix)
        nodes = np.arange(self.matrix.shape[0])
        if self.matrix.shape[0] != self.matrix.shape[1]:
            raise ParameterError(f"C must be square in the nodes, got shape {self.matrix.shape}")
        self.constrained = np.diff(self.matrix.indptr) != 1
        single = nodes[~self.constrained]
        at = self.matrix.indptr[single]
        self.constrained[single] = (self.matrix.indices[at] != single) | (
            self.matrix.data[at] != 1.0
        )
        used = np.zeros(self.matrix.shape[0], bool)
        used[self.matrix.indices] = True
        both = np.flatnonzero(used & self.constrained)
        if both.size:
            raise ParameterError(
                f"node {both[0]} is constrained to others, and others are constrained to it; "
                "multiply the matrices first"
            )

    def stencils(self, s: Stencils) -> Stencils:
        """Stencils on the independent nodes, N C and ∇N C."""
        if not np.any(self.constrained[s.nodes]):
            return s
        C = self.matrix.indptr, self.matrix.indices, self.matrix.data
        place = np.full(self.matrix.shape[1], -1, np.int32)
        counts = np.zeros(s.groups.size - 1, np.int64)
        nothing = np.empty(0, np.int32), np.empty(0), np.empty((0, s.dN.shape[1]))
        layout = s.groups, s.node_start, s.nodes, s.value_start, s.N, s.dN
        _prolong(*layout, *C, place, counts, np.empty(0, np.int32), np.empty(0, np.int64), *nothing)
        node_start = running_sum(counts, np.int32)
        value_start = running_sum(counts * np.diff(s.groups), np.int64)
        nodes = np.empty(node_start[-1], np.int32)
        N = np.empty(value_start[-1])
        dN = np.empty((value_start[-1], s.dN.shape[1]))
        _prolong(*layout, *C, place, counts, node_start, value_start, nodes, N, dN)
        return Stencils(
            s.order, s.groups, node_start, nodes, value_start, N, dN, s.cell_start, s.cells
        )
