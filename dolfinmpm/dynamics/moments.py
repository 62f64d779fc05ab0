"""Moments of the functions that a point sees, which affine velocities are divided by."""

from __future__ import annotations

import numba

from dolfinmpm.dynamics.passes import FAST
from dolfinmpm.dynamics.simdmath import axpy, times

__all__ = ["drift", "inverse_moments", "slopes"]


@numba.njit(error_model="numpy", fastmath=FAST)
def spread(S, node, first, count, x):
    """Second moment Σ S (x_a − x)² of the functions that a point sees in one direction (m²)."""
    total = 0.0
    for a in range(count):
        total += S[a] * (node[first + a] - x) ** 2
    return total


@numba.njit(error_model="numpy", fastmath=FAST)
def drift(S, node, first, count, x):
    """First moment Σ S (x_a − x) (m): 0 but for domains that the grid's edge cuts."""
    total = 0.0
    for a in range(count):
        total += S[a] * (node[first + a] - x)
    return total


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
def inverse_moments(cut, mass, S0, node0, i0, n0, x0, S1, node1, i1, n1, x1):
    """A mass times the inverse of the second moments in 2D: its two diagonal entries and the other.

    `cut` tells whether the grid's edge may cut domains: directions are coupled then.
    """
    D0, D1 = spread(S0, node0, i0, n0, x0), spread(S1, node1, i1, n1, x1)
    if not cut:
        return mass / D0, mass / D1, 0.0
    D01 = drift(S0, node0, i0, n0, x0) * drift(S1, node1, i1, n1, x1)
    q = mass / (D0 * D1 - D01 * D01)
    return q * D1, q * D0, -q * D01


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
def slopes(cut, B0, B1, B2, S0, node0, i0, n0, x0, S1, node1, i1, n1, x1, S2, node2, i2, n2, x2):
    """Columns of B D⁻¹ in 3D, with D the second moments of the functions that a point sees.

    These are A + m mᵀ, with m the first moments and A diagonal, whose inverse is that of Sherman
    and Morrison.
    """
    A0, A1 = spread(S0, node0, i0, n0, x0), spread(S1, node1, i1, n1, x1)
    A2 = spread(S2, node2, i2, n2, x2)
    if cut:
        m0, m1 = drift(S0, node0, i0, n0, x0), drift(S1, node1, i1, n1, x1)
        m2 = drift(S2, node2, i2, n2, x2)
        A0, A1, A2 = A0 - m0 * m0, A1 - m1 * m1, A2 - m2 * m2
        k0, k1, k2 = m0 / A0, m1 / A1, m2 / A2
        along = axpy(k2, B2, axpy(k1, B1, times(k0, B0)))
        along = times(-1.0 / (1.0 + k0 * m0 + k1 * m1 + k2 * m2), along)
        B0, B1, B2 = axpy(m0, along, B0), axpy(m1, along, B1), axpy(m2, along, B2)
    return times(1.0 / A0, B0), times(1.0 / A1, B1), times(1.0 / A2, B2)
