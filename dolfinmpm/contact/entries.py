"""Tangents of contact into the matrix: between the nodes that corners, or places, see."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
import scipy

from dolfinmpm.assembly.points import Entries

__all__ = ["Seen", "add_corners"]

# What places see: N of the nodes that any of them sees, shape (places, k), and these, shape (k,)
Seen = tuple["scipy.sparse.csr_matrix", npt.NDArray[np.int32]]


def add_corners(
    active: npt.NDArray[np.integer],
    rows: Seen,
    columns: Seen,
    K: npt.NDArray[np.float64],
    to: Entries,
) -> None:
    """Add Σ_c N_ca K_c N_cb to the matrix.

    Args:
        active: Which places, shape (n,).
        rows, columns: What they see of the row field and of the column field.
        K: Derivatives of forces by displacements there (N/m), shape (n, d, d).
        to: The matrix between the two fields.
    """
    (A, a), (B, b) = rows, columns
    _add(
        active, A.indptr, a[A.indices], A.data, B.indptr, b[B.indices], B.data, K, to.rows.row_of,
        to.columns.row_of, to.pattern.indptr, to.pattern.indices, to.data, to.prescribed, to.lift,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _add(
    active, a_start, a_nodes, a_N, b_start, b_nodes, b_N, K, row_of, column_of, indptr, indices,
    data, prescribed, lift,
):  # fmt: skip
    d = K.shape[1]
    for e in range(active.size):
        c = active[e]
        for a in range(a_start[c], a_start[c + 1]):
            for b in range(b_start[c], b_start[c + 1]):
                weight = a_N[a] * b_N[b]
                if weight == 0.0:
                    continue
                for i in range(d):
                    row = row_of[a_nodes[a], i]
                    if row < 0:
                        continue
                    for k in range(d):
                        value = weight * K[e, i, k]
                        column = column_of[b_nodes[b], k]
                        if column < 0:
                            lift[a_nodes[a], i] += value * prescribed[b_nodes[b], k]
                            continue
                        begin, end = indptr[row], indptr[row + 1]
                        data[begin + np.searchsorted(indices[begin:end], column)] += value
