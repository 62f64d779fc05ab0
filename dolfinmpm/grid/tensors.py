"""Small tensors of many points: eigenvalues and eigenvectors, products, determinants."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt


@numba.njit(cache=True, error_model="numpy")
def eigen_2(xx, yy, xy):
    """Eigenvalues of a symmetric 2x2 tensor, and cosine c and sine s of its axes.

    One Jacobi rotation gives the same result as `eigen`, and compiles three times as fast.
    The first axis is (c, -s), the second axis is (s, c).

    Args:
        xx, yy, xy: Components of the tensor.
    """
    c, s = 1.0, 0.0
    if not xy * xy <= 1e-32 * (xx * xx + yy * yy):
        theta = 0.5 * (yy - xx) / xy
        t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
        if theta < 0.0:
            t = -t
        c = 1.0 / math.sqrt(t * t + 1.0)
        s = t * c
        xx -= t * xy
        yy += t * xy
    return xx, yy, c, s


@numba.njit(cache=True, error_model="numpy")
def eigen(d, a, values, vectors):
    """Eigenvalues and eigenvectors of the leading d x d block of a symmetric matrix a.

    Closed form for d = 2, cyclic Jacobi rotations for d = 3 (Golub & Van Loan, Matrix
    Computations, §8.5). Both are accurate for equal eigenvalues too.

    Args:
        d: Size of the block, 1 to 3.
        a: The matrix, shape (≥ d, ≥ d); overwritten.
        values: Written: eigenvalues, shape (≥ d,).
        vectors: Written: eigenvectors in columns, shape (≥ d, ≥ d).
    """
    for i in range(d):
        for j in range(d):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(50 if d == 3 else d - 1):
        off = 0.0
        size = 0.0
        for i in range(d):
            size += a[i, i] * a[i, i]
            for j in range(i):
                off += a[i, j] * a[i, j]
        if off <= 1e-32 * size:
            break
        for i in range(d - 1):
            for j in range(i + 1, d):
                if a[i, j] == 0.0:
                    continue
                theta = 0.5 * (a[j, j] - a[i, i]) / a[i, j]
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                a_ij = a[i, j]
                a[i, i] -= t * a_ij
                a[j, j] += t * a_ij
                a[i, j] = a[j, i] = 0.0
                for k in range(d):
                    if k != i and k != j:
                        a_ki, a_kj = a[k, i], a[k, j]
                        a[k, i] = a[i, k] = c * a_ki - s * a_kj
                        a[k, j] = a[j, k] = s * a_ki + c * a_kj
                    v_ki, v_kj = vectors[k, i], vectors[k, j]
                    vectors[k, i] = c * v_ki - s * v_kj
                    vectors[k, j] = s * v_ki + c * v_kj
    for i in range(d):
        values[i] = a[i, i]


@numba.njit(cache=True, error_model="numpy")
def products(A, B):
    """Products of the tensors of many points, and determinants of the products.

    NumPy's products of small matrices and LAPACK's determinants take ten times as long.

    Args:
        A, B: Shape (n, d, d), d = 1, 2 or 3.

    Returns:
        AB, shape (n, d, d), and det AB, shape (n,).
    """
    n, d = A.shape[0], A.shape[1]
    C, J = np.empty((n, d, d)), np.empty(n)
    for p in range(n):
        for i in range(d):
            for j in range(d):
                total = 0.0
                for k in range(d):
                    total += A[p, i, k] * B[p, k, j]
                C[p, i, j] = total
        if d == 1:
            J[p] = C[p, 0, 0]
        elif d == 2:
            J[p] = C[p, 0, 0] * C[p, 1, 1] - C[p, 0, 1] * C[p, 1, 0]
        else:
            J[p] = (
                C[p, 0, 0] * (C[p, 1, 1] * C[p, 2, 2] - C[p, 1, 2] * C[p, 2, 1])
                + C[p, 0, 1] * (C[p, 1, 2] * C[p, 2, 0] - C[p, 1, 0] * C[p, 2, 2])
                + C[p, 0, 2] * (C[p, 1, 0] * C[p, 2, 1] - C[p, 1, 1] * C[p, 2, 0])
            )
    return C, J


def determinants(F: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Determinants of the tensors of many points, ten times as fast as LAPACK.

    Args:
        F: Tensors, shape (n, d, d), d = 1, 2 or 3.

    Returns:
        Determinants, shape (n,).
    """
    if F.shape[1] == 1:
        return F[:, 0, 0].copy()
    if F.shape[1] == 2:
        return F[:, 0, 0] * F[:, 1, 1] - F[:, 0, 1] * F[:, 1, 0]
    a, b, c = (F[:, i] for i in range(3))
    return (
        a[:, 0] * (b[:, 1] * c[:, 2] - b[:, 2] * c[:, 1])
        + a[:, 1] * (b[:, 2] * c[:, 0] - b[:, 0] * c[:, 2])
        + a[:, 2] * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    )
