"""Strength by Lode's angle: the ratio of the critical stress ratio to that in compression."""

from __future__ import annotations

import math

import numba
import numpy as np

from dolfinmpm.materials.parametrised import Array

__all__ = ["lode_ratio", "lode_ratios", "lode_slopes"]


@numba.njit(cache=True, error_model="numpy")
def lode_ratio(n, extension):
    """M/M_compression, its derivative by z, and z: 1 in triaxial compression, −1 in extension.

    (2 ρ⁴/(1 + ρ⁴ − (1 − ρ⁴) z))^(1/4) of Sheng, Sloan & Yu (2000), Computational Mechanics 26,
    which is convex for ρ ≥ 0.6.

    Args:
        n: Unit deviator in principal axes, positive in tension, three values; or zero.
        extension: ρ, the ratio in triaxial extension.
    """
    z = max(-1.0, min(1.0, -3.0 * math.sqrt(6.0) * n[0] * n[1] * n[2]))
    fourth = extension**4
    below = 1.0 + fourth - (1.0 - fourth) * z
    ratio = (2.0 * fourth / below) ** 0.25
    return ratio, 0.25 * ratio * (1.0 - fourth) / below, z


@numba.njit(cache=True, error_model="numpy")
def lode_slopes(n, z, norm):
    """Derivatives of z by the principal values of a deviator of the length `norm`."""
    three = -3.0 * math.sqrt(6.0)
    a = (three * n[1] * n[2], three * n[0] * n[2], three * n[0] * n[1])
    mean = (a[0] + a[1] + a[2]) / 3.0
    return (
        (a[0] - mean - 3.0 * z * n[0]) / norm,
        (a[1] - mean - 3.0 * z * n[1]) / norm,
        (a[2] - mean - 3.0 * z * n[2]) / norm,
    )


def lode_ratios(s: Array, extension: Array) -> Array:
    """`lode_ratio` of deviators of any length, shape (n, 3)."""
    size = np.sqrt((s**2).sum(axis=1, keepdims=True))
    n = s / np.where(size > 0.0, size, 1.0)
    z = np.clip(-3.0 * math.sqrt(6.0) * n.prod(axis=1), -1.0, 1.0)
    fourth = extension**4
    return (2.0 * fourth / (1.0 + fourth - (1.0 - fourth) * z)) ** 0.25
