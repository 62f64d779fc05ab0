"""Weights in one direction as the fused loops take them."""

from __future__ import annotations

import functools

import numba

from dolfinmpm.basis.bspline import uniform_weights
from dolfinmpm.basis.gimp import uniform_domain_weights
from dolfinmpm.basis.lattice import SNAP

__all__ = ["spread", "weights"]


@functools.cache
def weights(degree: int, averaged: bool):
    """`line_weights` in the middle of a uniform lattice, as numbers.

    `near(x, half, start, per_length, last) -> (known, first cell, four values, four slopes)`.
    Where it does not know, loops ask `line_weights` itself.
    """
    if not averaged:

        @numba.njit(cache=True, error_model="numpy", inline="always")
        def near(x, half, start, per_length, last):
            at = (x - start) * per_length
            i = int(at)
            known = i >= degree - 1 and i <= last - degree + 1 and (degree > 1 or at >= 0.0)
            a, b, c, e, da, db, dc, de = uniform_weights(degree, at - i, per_length)
            return known, i, a, b, c, e, da, db, dc, de

    elif degree == 1:

        @numba.njit(cache=True, error_model="numpy", inline="always")
        def near(x, half, start, per_length, last):
            at, reach = (x - start) * per_length, half * per_length
            left, right = at - reach, at + reach
            i = int(left)
            known = half > 0.0 and left > 0.0 and right < last and right < i + 2
            # an overlap that rounding makes does not count
            if i + 1 - left < SNAP:
                i += 1
                left = float(i)
            if right > i + 1 and right - i - 1 < SNAP:
                right = float(i + 1)
            a, b, c, da, db, dc = uniform_domain_weights(left - i, right - i, per_length)
            return known, i, a, b, c, 0.0, da, db, dc, 0.0

    else:

        @numba.njit(cache=True, error_model="numpy", inline="always")
        def near(x, half, start, per_length, last):
            return False, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0

    return near


@numba.njit(cache=True, error_model="numpy")
def spread(S, node, first, count, x):
    """Second moment Σ S (x_a − x)² of the functions that a point sees in one direction (m²)."""
    total = 0.0
    for a in range(count):
        total += S[a] * (node[first + a] - x) ** 2
    return total
