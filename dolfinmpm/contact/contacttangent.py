"""Assembly of the tangent of contact between the nodes of the contact points' stencils."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.assembly.stencilsums import Entries
from dolfinmpm.contact.contactstencils import StencilRows

__all__ = ["add_tangent"]


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
