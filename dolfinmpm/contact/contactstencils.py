"""Stencils of contact points: the motion of the points with the nodes, forces and tangent.

In steps in time, force and motion of contact points must be conjugate, or contact makes energy. So
forces reach the nodes by the transpose of the matrix that moves the points. A corner of a domain
that grows with its point moves by u ± ∂l/∂F : (∇u F). Then the components of its displacement
depend on several components of the nodal ones, and the matrix has blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
import scipy

from dolfinmpm.assembly.stencilsums import Entries

__all__ = ["ContactStencils", "add_tangent", "growth_by_gradient", "mixed"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int32]

# Row starts, nodes, and values: N, shape (n,), or blocks ∂x_i/∂u_j, shape (n, d, d)
StencilRows = tuple[Rows, Rows, Array]


@dataclass(frozen=True)
class ContactStencils:
    """Stencils of contact points of one body.

    Attributes:
        nodes: Nodes in the stencils, shape (k,).
        matrix: Values N, shape (points, k), if all components move alike. Otherwise blocks
            ∂x_i/∂u_j in a block matrix of shape (points d, k d).
    """

    nodes: npt.NDArray[np.int32]
    matrix: scipy.sparse.csr_matrix | scipy.sparse.bsr_matrix

    @staticmethod
    def of(matrix: scipy.sparse.csr_matrix | scipy.sparse.bsr_matrix, count: int):
        """Stencils from a matrix of all nodes of a field.

        Args:
            matrix: Values, or blocks, in the columns of all nodes.
            count: Number of the nodes.
        """
        # a table of all nodes is cheaper than sorting the nodes of all points
        column = np.zeros(count, np.int32)
        column[matrix.indices] = 1
        nodes: npt.NDArray[np.int32] = np.flatnonzero(column).astype(np.int32)
        column[nodes] = np.arange(nodes.size)
        parts = matrix.data, column[matrix.indices], matrix.indptr
        rows = matrix.indptr.size - 1
        if matrix.data.ndim == 1:
            return ContactStencils(nodes, scipy.sparse.csr_matrix(parts, shape=(rows, nodes.size)))
        d = matrix.data.shape[1]
        shape = d * rows, d * nodes.size
        blocks = scipy.sparse.bsr_matrix(parts, shape=shape, blocksize=(d, d))
        return ContactStencils(nodes, blocks)

    def displacement(self, u: Array) -> Array:
        """Displacements of the points (m), shape (points, d), from those of the field's nodes."""
        return self.of_nodes(u[self.nodes])

    def of_nodes(self, u: Array) -> Array:
        """Displacements of the points (m), shape (points, d), from those of `nodes`."""
        blocks = self.matrix.data.ndim == 3
        moved = self.matrix @ (u.ravel() if blocks else u)
        return np.asarray(moved).reshape(-1, u.shape[1])

    def add(self, forces: Array, out: Array) -> None:
        """Add forces at the points, shape (points, d, ...), to those of the field's nodes."""
        flat = forces.reshape(self.matrix.shape[0], -1)
        out[self.nodes] += np.asarray(self.matrix.T @ flat).reshape(-1, *forces.shape[1:])

    def rows(self) -> StencilRows:
        """The stencils as rows of a sparse matrix, with the field's numbers of the nodes."""
        return self.matrix.indptr, self.nodes[self.matrix.indices], self.matrix.data


def growth_by_gradient(F: Array, l0: Array, growth: str) -> Array:
    """∂l_i/∂(∇u)_jk of half-lengths l(F) as F becomes (I + ∇u) F (m), shape (points, d, d, d).

    Args:
        F: Deformation gradients, shape (points, d, d).
        l0: Initial half-lengths (m), shape (points, d).
        growth: The rule, see `dolfinmpm.basis.gimp.update_domains`.
    """
    n, d = l0.shape
    if growth == "fixed":
        return np.zeros((n, d, d, d))
    if growth == "volume":
        lengths = l0 * (np.linalg.det(F) ** (1.0 / d))[:, None]
        return np.asarray(lengths[:, :, None, None] / d * np.eye(d))
    values, Q = np.linalg.eigh(np.einsum("pki,pkj->pij", F, F))
    stretch = np.sqrt(values)
    # U dU + dU U = dC = Fᵀ (∇u + ∇uᵀ) F, in the frame of the eigenvectors
    G = F @ Q
    weight = 2.0 / (stretch[:, :, None] + stretch[:, None, :])
    T = np.einsum("pia,pib,pab,pja,pkb->pijk", Q, Q, weight, G, G, optimize=True)
    return np.asarray(l0[:, :, None, None] * T)


def mixed(
    values: scipy.sparse.csr_matrix, blocks: scipy.sparse.bsr_matrix,
    rows: npt.NDArray[np.integer], share: Array,
) -> scipy.sparse.bsr_matrix:  # fmt: skip
    """Stencils that are (1 − w) N + w W in some rows, with both entries of a node, and else N.

    Args:
        values: N, shape (m, nodes).
        blocks: W, shape (rows d, nodes d).
        rows: The rows of W, increasing.
        share: w, shape (m,), zero in other rows.
    """
    d, m = blocks.data.shape[1], values.shape[0]
    number, more = np.diff(values.indptr), np.diff(blocks.indptr)
    own = np.repeat(1.0 - share, number) * values.data
    data = np.concatenate([
        own[:, None, None] * np.eye(d), np.repeat(share[rows], more)[:, None, None] * blocks.data
    ])  # fmt: skip
    # two entries of a node in a row add up wherever the matrix is used
    row = np.concatenate([np.repeat(np.arange(m), number), np.repeat(rows, more)])
    order = np.argsort(row, kind="stable")
    number[rows] += more
    start = np.concatenate([[0], np.cumsum(number)])
    columns = np.concatenate([values.indices, blocks.indices])
    shape = d * m, d * values.shape[1]
    return scipy.sparse.bsr_matrix((data[order], columns[order], start), shape=shape)


def add_tangent(
    active: npt.NDArray[np.integer],
    rows: StencilRows,
    columns: StencilRows,
    K: npt.NDArray[np.float64],
    to: Entries,
) -> None:
    """Add Σ_c W_caᵀ K_c W_cb to the matrix.

    Args:
        active: The contact points that contribute, shape (n,).
        rows, columns: Stencils in the row field and in the column field; either both with values
            N, or both with blocks ∂x_i/∂u_j.
        K: Derivatives of forces by displacements of the points (N/m), shape (n, d, d).
        to: The matrix between the two fields.
    """
    kernel = _add if rows[2].ndim == 1 else _add_blocks
    kernel(
        active, *rows, *columns, K, to.rows.row_of, to.columns.row_of, to.pattern.indptr,
        to.pattern.indices, to.data, to.prescribed, to.lift,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _add(
    active, a_start, a_nodes, a_N, b_start, b_nodes, b_N, K, row_of, column_of, indptr, indices,
    data, prescribed, lift,
):  # fmt: skip
    block = np.empty(K.shape[1:])
    for e in range(active.size):
        c = active[e]
        for a in range(a_start[c], a_start[c + 1]):
            for b in range(b_start[c], b_start[c + 1]):
                weight = a_N[a] * b_N[b]
                if weight == 0.0:
                    continue
                block[:] = weight * K[e]
                _put(
                    block, a_nodes[a], b_nodes[b], row_of, column_of, indptr, indices, data,
                    prescribed, lift,
                )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _add_blocks(
    active, a_start, a_nodes, a_W, b_start, b_nodes, b_W, K, row_of, column_of, indptr, indices,
    data, prescribed, lift,
):  # fmt: skip
    d = K.shape[1]
    left, block = np.empty((d, d)), np.empty((d, d))
    for e in range(active.size):
        c = active[e]
        for a in range(a_start[c], a_start[c + 1]):
            _transposed(a_W[a], K[e], left)
            for b in range(b_start[c], b_start[c + 1]):
                for i in range(d):
                    for k in range(d):
                        block[i, k] = 0.0
                        for j in range(d):
                            block[i, k] += left[i, j] * b_W[b, j, k]
                _put(
                    block, a_nodes[a], b_nodes[b], row_of, column_of, indptr, indices, data,
                    prescribed, lift,
                )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _transposed(W, K, out):
    """Wᵀ K."""
    d = W.shape[0]
    for i in range(d):
        for k in range(d):
            out[i, k] = 0.0
            for j in range(d):
                out[i, k] += W[j, i] * K[j, k]


@numba.njit(cache=True, error_model="numpy")
def _put(block, a, b, row_of, column_of, indptr, indices, data, prescribed, lift):
    """Add the block of two nodes."""
    d = block.shape[0]
    for i in range(d):
        row = row_of[a, i]
        if row < 0:
            continue
        for k in range(d):
            column = column_of[b, k]
            if column < 0:
                lift[a, i] += block[i, k] * prescribed[b, k]
                continue
            begin, end = indptr[row], indptr[row + 1]
            data[begin + np.searchsorted(indices[begin:end], column)] += block[i, k]
