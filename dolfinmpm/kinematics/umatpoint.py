"""A UMAT at one point, for compiled loops: what goes into the call, and what its result means.

Implicit and explicit loops share these functions. Tensors are 3 x 3 numbers on the stack, see
`dolfinmpm._platform.simd`. Rows and columns beyond the dimension d are those of no deformation.
"""

from __future__ import annotations

import numba

from dolfinmpm._platform.simd import matrix
from dolfinmpm.materials.umatcall import call_umat
from dolfinmpm.materials.umatshim import OFFSETS

__all__ = [
    "INLINE",
    "column",
    "inverse",
    "product",
    "put",
    "respond",
    "row",
    "spin",
    "start",
    "take_six",
    "turn",
]

# Sums may reorder and contract floating-point operations; numbers that are not finite stay such.
INLINE = {
    "cache": True, "forceinline": True, "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}  # fmt: skip

_STRESS, _DE, _STRAIN, _D = (OFFSETS[k] for k in ("stress", "dstran", "stran", "ddsdde"))
_R, _F0, _F1 = OFFSETS["drot"], OFFSETS["dfgrd0"], OFFSETS["dfgrd1"]
_TIME, _DT, _X, _SIZE = (OFFSETS[k] for k in ("time", "dtime", "coords", "celent"))
_NEW = OFFSETS["pnewdt"]


@numba.njit(**INLINE)
def row(k):
    """Row of the k-th component of a UMAT: 11, 22, 33, 12, 13, 23."""
    return k if k < 3 else (1 if k == 5 else 0)


@numba.njit(**INLINE)
def column(k):
    """Column of the k-th component of a UMAT."""
    return k if k < 3 else (1 if k == 3 else 2)


@numba.njit(**INLINE)
def inverse(d, A, out):
    """Write the inverse of A; returns det A."""
    if d == 1:
        out[0, 0] = 1.0 / A[0, 0]
        return A[0, 0]
    if d == 2:
        det = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
        q = 1.0 / det
        out[0, 0], out[1, 1] = q * A[1, 1], q * A[0, 0]
        out[0, 1], out[1, 0] = -q * A[0, 1], -q * A[1, 0]
        return det
    for i in range(3):
        for j in range(3):
            a, b, c, e = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            out[i, j] = A[a, c] * A[b, e] - A[a, e] * A[b, c]
    det = A[0, 0] * out[0, 0] + A[0, 1] * out[1, 0] + A[0, 2] * out[2, 0]
    q = 1.0 / det
    for i in range(3):
        for j in range(3):
            out[i, j] *= q
    return det


@numba.njit(**INLINE)
def product(d, A, B, out):
    """Write A B."""
    for i in range(d):
        for j in range(d):
            total = A[i, 0] * B[0, j]
            for k in range(1, d):
                total += A[i, k] * B[k, j]
            out[i, j] = total


@numba.njit(**INLINE)
def spin(d, G, w):
    """Write the axial vector of skew G, W v = w × v; returns 1/(1 + |w|²/4)."""
    w[0] = w[1] = w[2] = 0.0
    if d > 1:
        w[2] = 0.5 * (G[1, 0] - G[0, 1])
    if d == 3:
        w[0], w[1] = 0.5 * (G[2, 1] - G[1, 2]), 0.5 * (G[0, 2] - G[2, 0])
    return 1.0 / (1.0 + 0.25 * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]))


@numba.njit(**INLINE)
def turn(d, w, scale, R):
    """Write R = 1 + (W + W²/2)/(1 + |w|²/4) (Hughes & Winget 1980, doi 10.1002/nme.1620151210)."""
    along = 1.0 - 0.5 * scale * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    for i in range(d):
        for j in range(d):
            R[i, j] = (0.5 * scale * w[i] * w[j] if d == 3 else 0.0) + (along if i == j else 0.0)
    for a in range(3):
        i, j = (a + 1) % 3, (a + 2) % 3
        if i < d and j < d:
            R[j, i] += scale * w[a]
            R[i, j] -= scale * w[a]


@numba.njit(**INLINE)
def take_six(m, values, p, out):
    """Write the symmetric tensor of row p, kept as xx, yy, zz, xy, yz, zx."""
    for i in range(3):
        for j in range(3):
            out[i, j] = 0.0
    for k in range(m):
        out[row(k), column(k)] = out[column(k), row(k)] = values[p, k if k < 4 else 9 - k]


@numba.njit(**INLINE)
def put(d, m, y, R, shear, work, at):
    """Write the components of R y Rᵀ to `work`, with a factor of the shear components.

    R turns the first d axes; 0 means that it turns none.
    """
    half = matrix(3, 3)
    if d > 1:
        product(d, R, y, half)
    for k in range(m):
        i, j = row(k), column(k)
        total = y[i, j]
        if i < d and j < d and d > 1:
            total = half[i, 0] * R[j, 0] + half[i, 1] * R[j, 1]
            if d == 3:
                total += half[i, 2] * R[j, 2]
        work[at + k] = total if k < 3 else shear * total


@numba.njit(**INLINE)
def start(work, time, length, size):
    """Write what is the same at all points of a step: TIME, DTIME, CELENT, and unit tensors."""
    work[_TIME], work[_TIME + 1] = time, time
    work[_DT], work[_SIZE] = length, size
    for i in range(3):
        for j in range(3):
            unit = 1.0 if i == j else 0.0
            work[_R + i + 3 * j] = work[_F0 + i + 3 * j] = work[_F1 + i + 3 * j] = unit


@numba.njit(**INLINE)
def respond(d, m, turns, address, props, count, name, work, sigma, R, e, F, dF, X, p):
    """Call a UMAT at a point; returns its number, see `FAILURES`.

    STRAN, the energies and STATEV are in `work` already, and `start` has been called.

    Args:
        d, m: Dimension, and NTENS.
        turns: Whether R is not 1.
        address, props, count, name: Addresses, see `call_umat`.
        work: See `OFFSETS`; the response is written to it.
        sigma: Cauchy stress before the increment (Pa).
        R, e: Rotation and strain increment.
        F, dF: Deformation gradient before the increment, and that of the increment.
        X, p: Positions of all points (m), and the number of the point.
    """
    F_new = matrix(3, 3)
    product(d, dF, F, F_new)
    for i in range(d):
        for j in range(d):
            work[_F0 + i + 3 * j], work[_F1 + i + 3 * j] = F[i, j], F_new[i, j]
            if turns:
                work[_R + i + 3 * j] = R[i, j]
    put(d if turns else 0, m, sigma, R, 1.0, work, _STRESS)
    put(0, m, e, R, 2.0, work, _DE)
    for k in range(m * m):
        work[_D + k] = 0.0
    for k in range(X.shape[1]):
        work[_X + k] = X[p, k]
    work[_NEW] = 1.0
    return call_umat(address, work.ctypes.data, props, count, name)
