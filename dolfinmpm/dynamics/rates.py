"""Rates of deformation in three dimensions by positions other than those at the start of a step."""

from __future__ import annotations

import numba

from dolfinmpm.dynamics.passes import FAST

__all__ = ["carried", "turned"]


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
def carried(t, h00, h01, h02, h10, h11, h12, h20, h21, h22):
    """H (1 + t H)⁻¹: a gradient H of velocities (1/s) by where these carry what they move.

    By the invariants of H and its adjugate it is (H + t (II − adj H) + t² III) / det(1 + t H).

    Args:
        t: Time for which they do (s).
        h00, h01, h02, h10, h11, h12, h20, h21, h22: H, by rows.

    Returns:
        det(1 + t H), and the new gradient by rows.
    """
    c00, c11, c22 = h11 * h22 - h12 * h21, h00 * h22 - h02 * h20, h00 * h11 - h01 * h10
    c01, c02 = h02 * h21 - h01 * h22, h01 * h12 - h02 * h11
    c10, c12 = h12 * h20 - h10 * h22, h02 * h10 - h00 * h12
    c20, c21 = h10 * h21 - h11 * h20, h01 * h20 - h00 * h21
    second, third = c00 + c11 + c22, h00 * c00 + h01 * c10 + h02 * c20
    scale = 1.0 + t * (h00 + h11 + h22 + t * (second + t * third))
    z, q = t * (second + t * third), 1.0 / scale
    return (
        scale,
        q * (h00 + z - t * c00), q * (h01 - t * c01), q * (h02 - t * c02),
        q * (h10 - t * c10), q * (h11 + z - t * c11), q * (h12 - t * c12),
        q * (h20 - t * c20), q * (h21 - t * c21), q * (h22 + z - t * c22),
    )  # fmt: skip


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
def turned(w0, w1, w2, y00, y11, y22, y01, y12, y02):
    """R y Rᵀ with R = (1 − W/2)⁻¹ (1 + W/2), W the increment of spin.

    (Hughes & Winget 1980, doi 10.1002/nme.1620151210.) With w the axis of W, that is W a = w × a,
    R = 1 + (W + ½ W²)/(1 + ¼ w·w).

    Args:
        w0, w1, w2: w.
        y00, y11, y22, y01, y12, y02: A symmetric tensor.

    Returns:
        The six components of the turned tensor in the same order.
    """
    size = w0 * w0 + w1 * w1 + w2 * w2
    q = 1.0 / (1.0 + 0.25 * size)
    w0, w1, w2, k, z = q * w0, q * w1, q * w2, 0.5 / q, 1.0 - 0.5 * q * size
    r00, r11, r22 = z + k * w0 * w0, z + k * w1 * w1, z + k * w2 * w2
    r01, r02, r12 = k * w0 * w1 - w2, k * w0 * w2 + w1, k * w1 * w2 - w0
    r10, r20, r21 = k * w0 * w1 + w2, k * w0 * w2 - w1, k * w1 * w2 + w0
    a00, a01 = r00 * y00 + r01 * y01 + r02 * y02, r00 * y01 + r01 * y11 + r02 * y12
    a02 = r00 * y02 + r01 * y12 + r02 * y22
    a10, a11 = r10 * y00 + r11 * y01 + r12 * y02, r10 * y01 + r11 * y11 + r12 * y12
    a12 = r10 * y02 + r11 * y12 + r12 * y22
    a20, a21 = r20 * y00 + r21 * y01 + r22 * y02, r20 * y01 + r21 * y11 + r22 * y12
    a22 = r20 * y02 + r21 * y12 + r22 * y22
    return (
        a00 * r00 + a01 * r01 + a02 * r02, a10 * r10 + a11 * r11 + a12 * r12,
        a20 * r20 + a21 * r21 + a22 * r22, a00 * r10 + a01 * r11 + a02 * r12,
        a10 * r20 + a11 * r21 + a12 * r22, a00 * r20 + a01 * r21 + a02 * r22,
    )  # fmt: skip
