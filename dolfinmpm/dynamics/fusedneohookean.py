"""Stored energy and stress of the neo-Hookean law at all points, for the fused loops.

The law stores all work of its stress. So the loops need not sum up the work of every step. The work
is exactly the change of the stored energy.
"""

from __future__ import annotations

import numba
import numpy as np

from dolfinmpm.dynamics.passes import FAST
from dolfinmpm.dynamics.smalltensors import (
    contracted,
    determinant,
    logarithm,
    logarithm_near_one,
)
from dolfinmpm.grid.tensors import determinants

__all__ = ["kirchhoff", "stored_energy"]


@numba.njit(error_model="numpy", fastmath=FAST)
def _in_plane(F, V0, lmbda, mu):
    """Stored energy of one law in two dimensions, and the number of points with a wrong energy.

    The energy is wrong for points with J far from 1. Without a branch for these points, the loop
    handles several points at once.
    """
    total, far = 0.0, 0
    for p in range(F.shape[0]):
        a, b, c, e = F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1]
        J = a * e - b * c
        z = (J - 1.0) / (J + 1.0)
        far += not abs(z) <= 0.1
        q = logarithm_near_one(z)
        trace = a * a + b * b + c * c + e * e - 2.0
        total += V0[p] * (0.5 * mu * trace - mu * q + 0.5 * lmbda * q * q)
    return total, far


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def stored_energy(F, V0, numbers, which):
    """Σ V₀ ψ, ψ = ½μ (tr FᵀF − d) − μ ln J + ½λ (ln J)².

    Args:
        F: Deformation gradients, shape (n, d, d). Points with det F ≤ 0 are left out.
        V0: Initial volumes (m^d), shape (n,).
        numbers: λ and μ per law (Pa), shape (laws, 2).
        which: Number of the law per point, shape (n,), or (1,) for a single law.

    Returns:
        The energy (J; per metre of thickness in 2D).
    """
    d = F.shape[1]
    if d == 2 and which.shape[0] == 1:
        total, far = _in_plane(F, V0, numbers[which[0], 0], numbers[which[0], 1])
        if far == 0:
            return total
    total = 0.0
    for p in range(F.shape[0]):
        L = which[p] if which.shape[0] > 1 else which[0]
        lmbda, mu = numbers[L, 0], numbers[L, 1]
        J = determinant(d, F[p])
        if J > 0.0:
            q = logarithm(J)
            stretch = contracted(d, F[p], F[p]) - d
            total += V0[p] * (0.5 * mu * stretch - mu * q + 0.5 * lmbda * q * q)
    return total


def kirchhoff(F, numbers, which, pairs):
    """Kirchhoff's stress τ = λ ln J 1 + μ (FFᵀ − 1) (Pa), by the columns of `pairs`.

    Args:
        F, numbers, which: As for `stored_energy`.
        pairs: Rows and columns of the components.

    Returns:
        The components, shape (n, components).
    """
    lmbda, mu = numbers[which if len(which) > 1 else np.zeros(len(F), int)].T
    volumetric = lmbda * np.log(determinants(F))
    tau = np.empty((len(F), len(pairs[0])))
    for k, (i, j) in enumerate(zip(*pairs)):
        tau[:, k] = mu * np.sum(F[:, i] * F[:, j], axis=1)
        if i == j:
            tau[:, k] += volumetric - mu
    return tau
