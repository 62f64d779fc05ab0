"""Isotropic functions of symmetric tensors in three dimensions, for compiled loops.

The eigenvalue farthest from the two others has a projector P that rounding cannot harm: the
adjugate of a − λ1 has rank one, and its size is the product of both distances. What is left across
that axis is half the gap between the others times a tensor D of eigenvalues 1, −1, 0. A function
of the tensor is a sum of 1, P and D, without axes. Where two eigenvalues meet D is what
rounding makes it, and its factor, half the gap between values of the function, is as small as
the gap. (Scherzinger & Dohrmann 2008, doi 10.1016/j.cma.2008.03.031, split so for eigenvectors.)
"""

from __future__ import annotations

import math

import numba

from dolfinmpm.dynamics.passes import FAST

__all__ = ["axes", "combine"]


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
def axes(a00, a11, a22, a01, a12, a02):
    """Eigenvalues of a symmetric tensor and what takes the place of its axes.

    Returns:
        The eigenvalue λ1 farthest from the others, λ2 ≥ λ3, the six components of P, that are
        xx, yy, zz, xy, yz, xz, and those of D: a = (λ2 + λ3)/2 (1 − P) + λ1 P + (λ2 − λ3)/2 D.
    """
    mean = (a00 + a11 + a22) / 3.0
    b00, b11, b22 = a00 - mean, a11 - mean, a22 - mean
    b01, b12, b02 = a01, a12, a02
    size = b00 * b00 + b11 * b11 + b22 * b22 + 2.0 * (a01 * a01 + a12 * a12 + a02 * a02)
    if not size > 1e-180:
        return mean, mean, mean, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # eigenvalues of the deviator over its size are roots of x³ − 3x − 2r, the first in [√3, 2]
    square = size / 6.0
    size = math.sqrt(square)
    k00, k11, k22 = b11 * b22 - b12 * b12, b00 * b22 - b02 * b02, b00 * b11 - b01 * b01
    k01, k12, k02 = b02 * b12 - b01 * b22, b01 * b02 - b12 * b00, b01 * b12 - b02 * b11
    q = 1.0 / size
    r = 0.5 * (b00 * k00 + b01 * k01 + b02 * k02) * (q * q * q)
    s = min(abs(r), 1.0)
    x = 1.73205196 + s * (
        0.333245128
        + s * (-0.0951072518 + s * (0.0439555711 + s * (-0.0181083439 + s * (0.0039638132))))
    )
    # one step of Halley's, which triples the digits
    f, slope = x * (x * x - 3.0) - 2.0 * s, 3.0 * (x * x - 1.0)
    x -= f * slope / (slope * slope - 3.0 * x * f)
    x = math.copysign(size * x, r)
    # the adjugate of b − x1, and its trace
    q = 1.0 / (3.0 * (x * x - square))
    p00, p11, p22 = q * (k00 + x * (b00 + x)), q * (k11 + x * (b11 + x)), q * (k22 + x * (b22 + x))
    p01, p12, p02 = q * (k01 + x * b01), q * (k12 + x * b12), q * (k02 + x * b02)
    half, y = 0.5 * x, -1.5 * x
    d00, d11, d22 = b00 + half + y * p00, b11 + half + y * p11, b22 + half + y * p22
    d01, d12, d02 = b01 + y * p01, b12 + y * p12, b02 + y * p02
    gap = d00 * d00 + d11 * d11 + d22 * d22 + 2.0 * (d01 * d01 + d12 * d12 + d02 * d02)
    gap = math.sqrt(0.5 * gap)
    q = 1.0 / gap if gap > 0.0 else 0.0
    middle = mean - half
    return (
        mean + x, middle + gap, middle - gap, p00, p11, p22, p01, p12, p02,
        q * d00, q * d11, q * d22, q * d01, q * d12, q * d02,
    )  # fmt: skip


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
def combine(first, second, third, P, D):
    """Components of P and D on the diagonal to that of the tensor with other eigenvalues."""
    middle, gap = 0.5 * (second + third), 0.5 * (second - third)
    return middle + (first - middle) * P + gap * D
