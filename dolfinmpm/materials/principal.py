"""Common functions of elasto-plastic kernels, for compiled code only."""

from __future__ import annotations

import numba

__all__ = ["descending", "elastic", "moduli"]


@numba.njit(error_model="numpy")
def moduli(E, nu):
    """Lamé's λ and μ (Pa)."""
    return E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), 0.5 * E / (1.0 + nu)


@numba.njit(error_model="numpy")
def descending(values):
    """Indices of the largest, the middle and the smallest of three values."""
    i, j, k = 0, 1, 2
    if values[i] < values[j]:
        i, j = j, i
    if values[j] < values[k]:
        j, k = k, j
        if values[i] < values[j]:
            i, j = j, i
    return i, j, k


@numba.njit(error_model="numpy")
def elastic(lmbda, mu, trace, strain, stress, tangent):
    """Write the stress and the tangent of Hencky's law (Pa).

    The caller gives the trace, summed in the order of size. Then a permutation of the strains
    permutes the stresses to the last bit.
    """
    for i in range(3):
        stress[i] = lmbda * trace + 2.0 * mu * strain[i]
        for j in range(3):
            tangent[3 * i + j] = lmbda
        tangent[4 * i] += 2.0 * mu
