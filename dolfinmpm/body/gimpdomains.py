"""How the domains of GIMP change with the body."""

from __future__ import annotations

import functools
import math

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.grid.tensors import eigen, eigen_2

__all__ = ["update_domains"]

Array = npt.NDArray[np.float64]


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
