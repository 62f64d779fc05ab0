"""Small tensors of many points: eigenvalues and eigenvectors, products, determinants."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt


@numba.njit(cache=True, error_model="numpy")
def eigen_2(xx, yy, xy):
    """Eigenvalues of a symmetric 2x2 tensor, and cosine c and sine s of its axes.

    One Jacobi rotation (Golub & Van Loan, Matrix Computations, §8.5).
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
def _in_plane(a, values, vectors, i, j):
    """Eigenvalues and eigenvectors of a matrix whose other off-diagonal components are 0."""
    values[i], values[j], c, s = eigen_2(a[i, i], a[j, j], a[i, j])
    vectors[i, i] = vectors[j, j] = c
    vectors[j, i], vectors[i, j] = -s, s


@numba.njit(cache=True, error_model="numpy")
def _in_space(a, values, vectors):
    """Eigenvalues and eigenvectors of a full 3x3 matrix.

    The eigenvalue that lies apart from both others comes from the trigonometric formula, and its
    eigenvector from a cross product. One Jacobi rotation across this axis gives the others, so that
    equal eigenvalues do no harm (Eberly 2014, A Robust Eigensolver for 3x3 Symmetric Matrices).
    """
    mean = (a[0, 0] + a[1, 1] + a[2, 2]) / 3.0
    xx, yy, zz = a[0, 0] - mean, a[1, 1] - mean, a[2, 2] - mean
    xy, yz, xz = a[0, 1], a[1, 2], a[0, 2]
    p = math.sqrt((xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + yz * yz + xz * xz)) / 6.0)
    scale = 1.0 / p
    xx, yy, zz, xy, yz, xz = xx * scale, yy * scale, zz * scale, xy * scale, yz * scale, xz * scale
    minors = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    # the largest eigenvalue, or the smallest
    eigenvalue = 2.0 * math.cos(math.acos(min(0.5 * abs(minors), 1.0)) / 3.0)
    if minors < 0.0:
        eigenvalue = -eigenvalue
    # cross products of the rows of a - root are along the axis; the longest is the most exact
    x0, y0, z0 = xx - eigenvalue, yy - eigenvalue, zz - eigenvalue
    u0, u1, u2 = xy * yz - xz * y0, xz * xy - x0 * yz, x0 * y0 - xy * xy
    v0, v1, v2 = xy * z0 - xz * yz, xz * xz - x0 * z0, x0 * yz - xy * xz
    w0, w1, w2 = y0 * z0 - yz * yz, yz * xz - xy * z0, xy * yz - y0 * xz
    u, v, w = u0 * u0 + u1 * u1 + u2 * u2, v0 * v0 + v1 * v1 + v2 * v2, w0 * w0 + w1 * w1 + w2 * w2
    if v > w:
        w, w0, w1, w2 = v, v0, v1, v2
    if u > w:
        w, w0, w1, w2 = u, u0, u1, u2
    scale = 1.0 / math.sqrt(w)
    w0, w1, w2 = w0 * scale, w1 * scale, w2 * scale
    if abs(w0) > abs(w1):
        scale = 1.0 / math.sqrt(w0 * w0 + w2 * w2)
        u0, u1, u2 = -w2 * scale, 0.0, w0 * scale
    else:
        scale = 1.0 / math.sqrt(w1 * w1 + w2 * w2)
        u0, u1, u2 = 0.0, w2 * scale, -w1 * scale
    v0, v1, v2 = w1 * u2 - w2 * u1, w2 * u0 - w0 * u2, w0 * u1 - w1 * u0
    a0, a1, a2 = (
        xx * u0 + xy * u1 + xz * u2,
        xy * u0 + yy * u1 + yz * u2,
        xz * u0 + yz * u1 + zz * u2,
    )
    b0, b1, b2 = (
        xx * v0 + xy * v1 + xz * v2,
        xy * v0 + yy * v1 + yz * v2,
        xz * v0 + yz * v1 + zz * v2,
    )
    first, second, c, s = eigen_2(
        u0 * a0 + u1 * a1 + u2 * a2, v0 * b0 + v1 * b1 + v2 * b2, u0 * b0 + u1 * b1 + u2 * b2
    )
    values[0], values[1] = mean + p * first, mean + p * second
    values[2] = mean - p * (first + second)
    vectors[0, 0], vectors[1, 0], vectors[2, 0] = c * u0 - s * v0, c * u1 - s * v1, c * u2 - s * v2
    vectors[0, 1], vectors[1, 1], vectors[2, 1] = s * u0 + c * v0, s * u1 + c * v1, s * u2 + c * v2
    vectors[0, 2], vectors[1, 2], vectors[2, 2] = w0, w1, w2


@numba.njit(cache=True, error_model="numpy")
def eigen(d, a, values, vectors):
    """Eigenvalues and eigenvectors of the leading d x d block of a symmetric matrix a.

    Their errors are those of rounding relative to the largest eigenvalue, also where eigenvalues
    are equal. A diagonal matrix keeps its axes, and so does an axis without off-diagonal terms.

    Args:
        d: Size of the block, 1 to 3.
        a: The matrix, shape (≥ d, ≥ d).
        values: Written: eigenvalues, shape (≥ d,).
        vectors: Written: eigenvectors in columns, shape (≥ d, ≥ d).
    """
    size = off = 0.0
    for i in range(d):
        values[i] = a[i, i]
        size += a[i, i] * a[i, i]
        for j in range(d):
            vectors[i, j] = 1.0 if i == j else 0.0
            if j < i:
                off += a[i, j] * a[i, j]
    if off <= 1e-32 * size:
        return
    if d == 2:
        _in_plane(a, values, vectors, 0, 1)
        return
    xy, yz, xz = a[0, 1] != 0.0, a[1, 2] != 0.0, a[0, 2] != 0.0
    if not yz and not xz:
        _in_plane(a, values, vectors, 0, 1)
    elif not xy and not xz:
        _in_plane(a, values, vectors, 1, 2)
    elif not xy and not yz:
        _in_plane(a, values, vectors, 0, 2)
    else:
        _in_space(a, values, vectors)


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


@numba.njit(cache=True, error_model="numpy")
def invert(A, out):
    """Write the inverse of a tensor, shape (d, d), d = 1, 2 or 3."""
    d = A.shape[0]
    if d == 1:
        out[0, 0] = 1.0 / A[0, 0]
    elif d == 2:
        scale = 1.0 / (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0])
        out[0, 0], out[1, 1] = A[1, 1] * scale, A[0, 0] * scale
        out[0, 1], out[1, 0] = -A[0, 1] * scale, -A[1, 0] * scale
    else:
        for i in range(3):
            for j in range(3):
                a, b, c, e = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
                out[i, j] = A[a, c] * A[b, e] - A[a, e] * A[b, c]
        scale = 1.0 / (A[0, 0] * out[0, 0] + A[0, 1] * out[1, 0] + A[0, 2] * out[2, 0])
        for i in range(3):
            for j in range(3):
                out[i, j] *= scale


@numba.njit(cache=True, error_model="numpy")
def inverses(A):
    """Inverses of the tensors of many points, ten times as fast as LAPACK.

    Args:
        A: Tensors, shape (n, d, d), d = 1, 2 or 3.

    Returns:
        The inverses, likewise; not finite for a singular tensor.
    """
    found = np.empty(A.shape)
    for p in range(A.shape[0]):
        invert(A[p], found[p])
    return found


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
