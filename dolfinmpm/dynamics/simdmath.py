"""Four doubles in one register, and functions of numbers near 1 and 0 without a call."""

from __future__ import annotations

import math

import numba

from dolfinmpm._platform.simd import add_at, axpy, four, lanes, load, number_at, store, times
from dolfinmpm.dynamics.passes import FAST

__all__ = [
    "add_at",
    "axpy",
    "exponential",
    "four",
    "lanes",
    "load",
    "logarithm",
    "logarithm_near_one",
    "number_at",
    "store",
    "times",
]


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
def logarithm_near_one(z):
    """ln x of z = (x − 1)/(x + 1), for |z| ≤ 0.1."""
    s = z * z
    tail = 1.0 / 9.0 + s * (1.0 / 11.0 + s * (1.0 / 13.0 + s * (1.0 / 15.0)))
    return 2.0 * z * (1.0 + s * (1.0 / 3.0 + s * (0.2 + s * (1.0 / 7.0 + s * tail))))


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
def logarithm(x):
    """ln x; near 1, where stretches of most steps are, without a call."""
    z = (x - 1.0) / (x + 1.0)
    if abs(z) > 0.1:
        return math.log(x)
    return logarithm_near_one(z)


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
def exponential(x):
    """eˣ; near 0, where changes of strain in a step are, without a call."""
    if abs(x) > 0.03:
        return math.exp(x)
    tail = 1.0 / 24.0 + x * (1.0 / 120.0 + x * (1.0 / 720.0 + x * (1.0 / 5040.0)))
    return 1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x * tail)))
