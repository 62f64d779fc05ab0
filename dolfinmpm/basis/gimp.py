"""Generalised interpolation: linear functions averaged over the points' domains, and the domains.

The method is by Bardenhagen & Kober (2004, doi 10.3970/cmes.2004.005.477). The average over a
domain is a sum over the overlapped cells. Each summand is the linear function at the middle of the
overlap, times the overlap's share of the domain. A point without a domain gives the standard
material point method.
"""

from __future__ import annotations

import functools
import math

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.grid.tensors import eigen, eigen_2

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def domain_weights(line, first, count, x, half, S, dS):
    """Averages of the linear functions and of their slopes over a domain, in one direction.

    Args:
        line: Coordinates of the grid lines (m).
        first, count: First cell that the domain overlaps, and number of overlapped cells.
        x, half: Position and half-length of the domain (m); 0 for a point without a domain.
        S, dS: Written: averages (-) and slopes (1/m), count + 1 numbers each.
    """
    for i in range(count + 1):
        S[i] = 0.0
        dS[i] = 0.0
    left = max(x - half, line[first])
    right = min(x + half, line[first + count])
    # divisions take most of the time here: divide once
    whole = 1.0 / (right - left) if half > 0.0 else 1.0
    for c in range(count):
        lower, upper = line[first + c], line[first + c + 1]
        share, middle = 1.0, x
        if half > 0.0:
            a, b = max(left, lower), min(right, upper)
            share, middle = (b - a) * whole, 0.5 * (a + b)
        slope = share / (upper - lower)
        S[c] += slope * (upper - middle)
        S[c + 1] += slope * (middle - lower)
        dS[c] -= slope
        dS[c + 1] += slope


@numba.njit(cache=True, error_model="numpy")
def uniform_domain_weights(left, right, per_length):
    """`domain_weights` of three functions, for a domain in at most two cells of a uniform line.

    Args:
        left, right: Ends of the domain, measured in cells from the lower end of the first cell.
        per_length: One over the cells' size (1/m).

    Returns:
        Three values and three slopes. Where the domain ends in the first cell, the third value
        and the third slope are 0.
    """
    k = per_length
    a, b = min(right, 1.0) - left, max(right - 1.0, 0.0)
    whole = 1.0 / (a + b)
    a_share, b_share = a * whole, b * whole
    first, last = a_share * (1.0 - left - 0.5 * a), 0.5 * b * b_share
    return first, 1.0 - first - last, last, -a_share * k, (a_share - b_share) * k, b_share * k


@functools.cache
def _stretches(d: int):
    @numba.njit(cache=True, error_model="numpy")
    def kernel(F, l0, lengths):
        C, Q, values = np.empty((d, d)), np.empty((d, d)), np.empty(d)
        for p in range(F.shape[0]):
            for i in range(d):
                for j in range(d):
                    C[i, j] = 0.0
                    for k in range(d):
                        C[i, j] += F[p, k, i] * F[p, k, j]
            if d == 2:
                values[0], values[1], c, s = eigen_2(C[0, 0], C[1, 1], C[1, 0])
                Q[0, 0], Q[0, 1], Q[1, 0], Q[1, 1] = c, s, -s, c
            else:
                eigen(d, C, values, Q)
            for i in range(d):
                stretch = 0.0
                for a in range(d):
                    stretch += math.sqrt(values[a]) * Q[i, a] * Q[i, a]
                lengths[p, i] = l0[p, i] * stretch

    return kernel


def update_domains(F: Array, l0: Array, growth: str = "stretch") -> Array:
    """Half-lengths of the GIMP domains (m): l = l0 · diag(U) with U = √(FᵀF), or another rule.

    See Coombs, Augarde & others (2020, doi 10.1016/j.cma.2019.112622) on what rule suits which
    motion.

    Args:
        F: Deformation gradients, shape (points, d, d).
        l0: First half-lengths (m), shape (points, d).
        growth: "stretch" for diag(U), "volume" for J^(1/d), "fixed" for l = l0.
    """
    if growth == "fixed":
        return l0.copy()
    if growth == "volume":
        return l0 * (np.linalg.det(F) ** (1.0 / F.shape[1]))[:, None]
    lengths = np.empty_like(l0)
    _stretches(F.shape[1])(F, l0, lengths)
    return lengths
