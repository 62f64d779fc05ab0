"""The derivative of a UMAT's flux by the increment's gradient at one point, for compiled loops.

DDSDDE is D = ∂σ/∂Δε in the axes after the rotation, see `dolfinmpm.kinematics.umatloop`. The
derivative of σ by G has nine columns: D for the symmetric part, and the terms of the rotation for
the skew part. With δG = B δH B it becomes the derivative by H. Columns of D are vectors of four
components, so that one instruction treats four of them.
"""

from __future__ import annotations

import numba

from dolfinmpm._platform.simd import axpy, four, load, matrix, store, times, vectors
from dolfinmpm.kinematics.umatpoint import INLINE, column, row

__all__ = ["put_small_tangent", "put_tangent"]


@numba.njit(**INLINE)
def _component(i, j):
    """Number of a component of a UMAT."""
    return i if i == j else i + j + 2


@numba.njit(**INLINE)
def _turned(i, j, y, r, s):
    """Component rs of Ω y − y Ω, where Ω has −1 at ij and 1 at ji."""
    total = 0.0
    if r == i:
        total -= y[j, s]
    if r == j:
        total += y[i, s]
    if s == i:
        total -= y[j, r]
    if s == j:
        total += y[i, r]
    return total


@numba.njit(**INLINE)
def _by_turns(m, D, w, scale, e, sigma, part, T, out):
    """Write the derivatives of four components of the stress by w, the axial vector of skew G.

    Args:
        m: NTENS.
        D: Columns of DDSDDE, of these components.
        w, scale: See `spin`.
        e, sigma: Strain increment, and the new stress (Pa).
        part: Number of the first of the four components over 4.
        T: Space for three vectors.
        out: Written: three vectors; with NTENS = 4 only the last one.
    """
    first, q = 0 if m == 6 else 2, 4 * part
    for a in range(first, 3):
        i, j = (a + 1) % 3, (a + 2) % 3
        t = four(
            _turned(i, j, sigma, row(q), column(q)),
            _turned(i, j, sigma, row(q + 1), column(q + 1)),
            0.0 if part else _turned(i, j, sigma, 2, 2),
            0.0 if part else _turned(i, j, sigma, 0, 1),
        )
        for k in range(m):
            own = _turned(i, j, e, row(k), column(k))
            t = axpy(-own if k < 3 else -2.0 * own, D[k], t)
        T[a] = t
    # the rotation's axial vector changes by (δw + w × δw/2) scale
    for a in range(first, 3):
        b, c = (a + 1) % 3, (a + 2) % 3
        t = times(scale, T[a])
        if m == 6:
            t = axpy(0.5 * scale * w[c], T[b], axpy(-0.5 * scale * w[b], T[c], t))
        out[a] = t


@numba.njit(**INLINE)
def put_tangent(d, m, D_at, G, w, scale, e, sigma, B, Fi, J, S, A, p):
    """Write the derivative of S = J σ ΔF⁻ᵀ by H with Jaumann's rate.

    Args:
        d, m: Dimension, and NTENS.
        D_at: Address of DDSDDE (Pa), column by column; four numbers behind it may be read.
        G: DDSDDE of the fourth component (Pa).
        w, scale: See `spin`.
        e, sigma: Strain increment, and the new stress (Pa).
        B, Fi: (1 + H/2)⁻¹ and ΔF⁻¹.
        J: Volume ratio at the end of the step.
        S: Flux (Pa).
        A, p: Written in row p: the derivative (Pa), shape (points, d², d²).
    """
    # derivatives of σ by H: a row per component of H, the components of σ side by side
    slope = matrix(9, 8)
    slope_at = slope.ctypes.data
    D, C, half, T, turned = vectors(6), vectors(9), vectors(9), vectors(3), vectors(3)
    for part in range((m + 3) // 4):
        for k in range(m):
            D[k] = load(D_at + 8 * (k * m + 4 * part))
        for i in range(d):
            for j in range(d):
                k = _component(i, j)
                C[i * d + j] = D[k] if k < m else four(0.0, 0.0, 0.0, 0.0)
        if d > 1:
            _by_turns(m, D, w, scale, e, sigma, part, T, turned)
            for a in range(0 if m == 6 else 2, 3):
                i, j = (a + 1) % 3, (a + 2) % 3
                C[j * d + i] = axpy(0.5, turned[a], C[j * d + i])
                C[i * d + j] = axpy(-0.5, turned[a], C[i * d + j])
        for r in range(d):
            for j in range(d):
                total = times(B[0, r], C[j])
                for i in range(1, d):
                    total = axpy(B[i, r], C[i * d + j], total)
                half[r * d + j] = total
        stress = four(0.0, 0.0, 0.0, 0.0)
        if part == 0:
            stress = four(sigma[0, 0], sigma[1, 1], sigma[2, 2], sigma[0, 1])
        else:
            stress = four(sigma[0, 2], sigma[1, 2], 0.0, 0.0)
        for r in range(d):
            for s in range(d):
                # of the volume, and of B
                total = times(Fi[s, r], stress)
                for j in range(d):
                    total = axpy(B[s, j], half[r * d + j], total)
                store(slope_at + 8 * (8 * (r * d + s) + 4 * part), total)
    _to_flux(d, m, slope, G, Fi, J, S, A, p)


@numba.njit(**INLINE)
def _to_flux(d, m, slope, G, Fi, J, S, A, p):
    """Write J (δσ − σ ΔF⁻ᵀ δHᵀ) ΔF⁻ᵀ; see `put_tangent` for the arguments.

    NTENS = 4 in three dimensions is axisymmetry. No shear 13 and 23 occurs there, but penalties
    take moduli from all components: these two get the stiffness of 12.
    """
    dd = d * d
    C, g = vectors(6), matrix(3, 9)
    q = 1.0 / J
    for i in range(d):
        for k in range(d):
            n = _component(i, k)
            for c in range(dd):
                out_of_plane = n >= m and (c == i * d + k or c == k * d + i)
                g[k, c] = slope[c, n] if n < m else (G if out_of_plane else 0.0)
            # δΔF⁻ᵀ = −ΔF⁻ᵀ δHᵀ ΔF⁻ᵀ
            for s in range(d):
                g[k, k * d + s] -= q * S[i, s]
            for part in range(dd // 4):
                c = 4 * part
                C[2 * k + part] = four(g[k, c], g[k, c + 1], g[k, c + 2], g[k, c + 3])
        for j in range(d):
            to = A.ctypes.data + 8 * dd * (p * dd + i * d + j)
            for part in range(dd // 4):
                total = times(J * Fi[j, 0], C[part])
                for k in range(1, d):
                    total = axpy(J * Fi[j, k], C[2 * k + part], total)
                store(to + 32 * part, total)
            if dd % 4:
                total = Fi[j, 0] * g[0, dd - 1]
                for k in range(1, d):
                    total += Fi[j, k] * g[k, dd - 1]
                A[p, i * d + j, dd - 1] = J * total


@numba.njit(**INLINE)
def put_small_tangent(d, m, D, at, q, A, p):
    """Write DDSDDE, at a column of row q of D, as the derivative by H with small strain.

    For the shear 13 and 23 of NTENS = 4 see `_to_flux`.
    """
    for i in range(d):
        for j in range(d):
            for r in range(d):
                for s in range(d):
                    k, n = _component(i, j), _component(r, s)
                    G = D[q, at + 3 * m + 3] if k == n else 0.0
                    known = k < m and n < m
                    A[p, i * d + j, r * d + s] = D[q, at + n * m + k] if known else G
