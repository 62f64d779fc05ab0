"""Steps that the loops over the points of all frameworks share, compiled into them.

Symmetric tensors of points are rows of six numbers, xx, yy, zz, xy, yz, xz. Only the
leading d x d block of a tensor turns; what is beyond it stands in its own axes.
"""

from __future__ import annotations

import math

import numba

from dolfinmpm.basis.cells import invert
from dolfinmpm.materials.base import call_law

__all__ = [
    "ask_law",
    "from_axes",
    "multiply",
    "read_symmetric",
    "volume_ratio",
    "write_stress",
    "write_symmetric",
]


@numba.njit(cache=True, error_model="numpy")
def read_symmetric(rows, p, M):
    """The 3 x 3 tensor M of row p."""
    M[0, 0], M[1, 1], M[2, 2] = rows[p, 0], rows[p, 1], rows[p, 2]
    M[0, 1] = M[1, 0] = rows[p, 3]
    M[1, 2] = M[2, 1] = rows[p, 4]
    M[0, 2] = M[2, 0] = rows[p, 5]


@numba.njit(cache=True, error_model="numpy")
def write_symmetric(d, rows, p, values, Q):
    """Row p from values along the axes Q (columns), Σ_a values_a q_a ⊗ q_a."""
    for i in range(3):
        rows[p, i] = values[i] if i >= d else 0.0
        rows[p, 3 + i] = 0.0
    for a in range(d):
        for i in range(d):
            rows[p, i] += values[a] * Q[i, a] * Q[i, a]
        if d > 1:
            rows[p, 3] += values[a] * Q[0, a] * Q[1, a]
        if d > 2:
            rows[p, 4] += values[a] * Q[1, a] * Q[2, a]
            rows[p, 5] += values[a] * Q[0, a] * Q[2, a]


@numba.njit(cache=True, error_model="numpy")
def write_stress(d, sigma, p, tau, Q, scale):
    """The 3 x 3 tensor sigma[p] from scale * tau along the axes Q (columns)."""
    for i in range(3):
        for j in range(3):
            sigma[p, i, j] = scale * tau[i] if i == j and i >= d else 0.0
    for a in range(d):
        for i in range(d):
            for j in range(d):
                sigma[p, i, j] += scale * tau[a] * Q[i, a] * Q[j, a]


@numba.njit(cache=True, error_model="numpy")
def from_axes(d, values, Q, M):
    """The d x d block of M from values along the axes Q (columns)."""
    for i in range(d):
        for j in range(d):
            value = 0.0
            for a in range(d):
                value += values[a] * Q[i, a] * Q[j, a]
            M[i, j] = value


@numba.njit(cache=True, error_model="numpy")
def multiply(d, A, B, C):
    """The d x d block of C = A B; C is neither A nor B."""
    for i in range(d):
        for j in range(d):
            value = 0.0
            for k in range(d):
                value += A[i, k] * B[k, j]
            C[i, j] = value


@numba.njit(cache=True, error_model="numpy")
def volume_ratio(d, F, p, work, inverse):
    """det F of point p; work and inverse are d x d and overwritten."""
    if d == 1:
        return F[p, 0, 0]
    if d == 2:
        return F[p, 0, 0] * F[p, 1, 1] - F[p, 0, 1] * F[p, 1, 0]
    for i in range(d):
        for j in range(d):
            work[i, j] = F[p, i, j]
    return invert(work, inverse)


@numba.njit(cache=True, error_model="numpy")
def ask_law(law, parameters, p, strain, internal_n, internal, keep, scratch, tau, D):
    """Stress and tangent of point p; strain becomes the elastic one.

    Parameters have one row for all points or one each. The new internal variables
    go to row p of internal if they are to be kept, else to scratch. Returns whether
    the law found a finite stress.
    """
    row = p if parameters.shape[0] > 1 else 0
    new = scratch.ctypes.data
    if keep:
        new = internal.ctypes.data + 8 * p * internal.shape[1]
    status = call_law(
        law, parameters.ctypes.data + 8 * row * parameters.shape[1], strain.ctypes.data,
        internal_n.ctypes.data + 8 * p * internal_n.shape[1], new,
        tau.ctypes.data, D.ctypes.data,
    )  # fmt: skip
    return status == 0 and math.isfinite(tau[0] + tau[1] + tau[2])
