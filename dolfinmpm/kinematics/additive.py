"""The loop over the points where increments of strain are added.

Its two branches, with and without a rotation of the old elastic strain, are
compiled apart.
"""

from __future__ import annotations

import functools

import numba
import numpy as np

from dolfinmpm.basis.cells import invert
from dolfinmpm.grid.tensors import eigen
from dolfinmpm.kinematics.pieces import (
    ask_law,
    from_axes,
    multiply,
    read_symmetric,
    volume_ratio,
    write_stress,
    write_symmetric,
)

__all__ = ["additive_kernel"]


@functools.cache
def additive_kernel(d: int, corotated: bool):
    """The loop in d dimensions; see `Framework`.

    Args:
        d: Dimension of space.
        corotated: Whether the old elastic strain turns with the increment's spin, and
            equilibrium is that of the end of the step.
    """
    dd, pairs = d * d, d * (d + 1) // 2

    @numba.njit(cache=True, error_model="numpy")
    def kernel(
        law, parameters, H, F_n, state_n, internal_n, S, A, want_tangent, commit,
        state, internal, sigma,
    ):  # fmt: skip
        e, Q = np.zeros((3, 3)), np.eye(3)
        old, work = np.empty((3, 3)), np.empty((d, d))
        spin, turn = np.empty((d, d)), np.empty((d, d))
        strain, trial, tau, D = np.empty(3), np.empty(3), np.empty(3), np.empty((3, 3))
        N, T = np.empty((pairs, dd)), np.empty((dd, dd))
        secant = np.empty((d, d))
        C, G = np.empty((dd, dd)), np.empty((dd, dd))
        dF, B = np.empty((d, d)), np.empty((d, d))
        g, M, cauchy = np.empty((d, d)), np.empty((d, d)), np.empty((d, d))
        scratch = np.empty(max(internal_n.shape[1], 1))
        volume = 1.0
        for p in range(H.shape[0]):
            read_symmetric(state_n, p, old)
            for i in range(d):
                for j in range(d):
                    g[i, j] = H[p, i * d + j]
            if corotated:
                for i in range(d):
                    for j in range(d):
                        one = 1.0 if i == j else 0.0
                        dF[i, j] = one + g[i, j]
                        work[i, j] = one + 0.5 * g[i, j]
                volume = invert(dF, B)
                if not (volume > 0.0 and invert(work, M) > 0.0):
                    return p
                # the increment's gradient by the middle of the step
                for i in range(d):
                    for j in range(d):
                        g[i, j] = 0.0
                        for k in range(d):
                            g[i, j] += H[p, i * d + k] * M[k, j]
                for i in range(d):
                    for j in range(d):
                        work[i, j] = (1.0 if i == j else 0.0) - 0.25 * (g[i, j] - g[j, i])
                # R = (1 − W/2)⁻¹ (1 + W/2), where the second factor is the first's transpose
                invert(work, spin)
                for i in range(d):
                    for j in range(d):
                        turn[i, j] = 0.0
                        for k in range(d):
                            turn[i, j] += spin[i, k] * work[j, k]
                multiply(d, turn, old, work)
                for i in range(d):
                    for j in range(d):
                        old[i, j] = 0.0
                        for k in range(d):
                            old[i, j] += work[i, k] * turn[j, k]
            for i in range(d):
                for j in range(d):
                    e[i, j] = old[i, j] + 0.5 * (g[i, j] + g[j, i])
            for i in range(d, 3):
                trial[i] = state_n[p, i]
            eigen(d, e, trial, Q)
            for i in range(3):
                strain[i] = trial[i]
            if not ask_law(
                law, parameters, p, strain, internal_n, internal, commit, scratch, tau, D
            ):  # fmt: skip
                return p
            if commit:
                write_symmetric(d, state, p, strain, Q)
                write_stress(d, sigma, p, tau, Q, 1.0)
                continue
            from_axes(d, tau, Q, cauchy)
            if corotated:
                volume *= volume_ratio(d, F_n, p, dF, work)
                for i in range(d):
                    for j in range(d):
                        S[p, i * d + j] = 0.0
                        for k in range(d):
                            S[p, i * d + j] += volume * cauchy[i, k] * B[j, k]
            else:
                for i in range(d):
                    for j in range(d):
                        S[p, i * d + j] = cauchy[i, j]
            if not want_tangent:
                continue

            # between the axes n_a and n_b the derivative of σ is the secant of its values
            isotropic = D[0, 0] == D[1, 1] and D[1, 1] == D[2, 2]
            for a in range(d):
                for b in range(d):
                    if a == b:
                        continue
                    gap = trial[a] - trial[b]
                    size = abs(D[a, a]) + abs(D[b, b])
                    # a difference of stresses tells nothing where rounding has made it
                    if abs(gap) * size > 1e-8 * (abs(tau[a]) + abs(tau[b])):
                        secant[a, b] = (tau[a] - tau[b]) / gap
                    else:
                        secant[a, b] = 0.5 * (D[a, a] - D[a, b] - D[b, a] + D[b, b])
                    shear = D[a, a] - D[a, b]
                    isotropic = isotropic and D[a, b] == D[0, 1] and D[b, a] == D[0, 1]
                    isotropic = isotropic and abs(secant[a, b] - shear) <= 1e-7 * abs(shear)
            if isotropic:
                # linear elasticity, the same in all axes
                for i in range(dd):
                    for k in range(dd):
                        C[i, k] = 0.0
                shear = 0.5 * (D[0, 0] - D[0, 1])
                for i in range(d):
                    for j in range(d):
                        C[i * d + i, j * d + j] += D[0, 1]
                        C[i * d + j, i * d + j] += shear
                        C[i * d + j, j * d + i] += shear
            else:
                # C = dσ/dε in the symmetric basis n_a ⊗ n_b + n_b ⊗ n_a
                for a in range(d):
                    for i in range(d):
                        for j in range(d):
                            N[a, i * d + j] = Q[i, a] * Q[j, a]
                for a in range(d):
                    for k in range(dd):
                        value = 0.0
                        for b in range(d):
                            value += D[a, b] * N[b, k]
                        T[a, k] = value
                m = d
                for a in range(d):
                    for b in range(a + 1, d):
                        for i in range(d):
                            for j in range(d):
                                value = 0.5 * (Q[i, a] * Q[j, b] + Q[j, a] * Q[i, b])
                                N[m, i * d + j] = value
                                T[m, i * d + j] = 2.0 * secant[a, b] * value
                        m += 1
                for i in range(dd):
                    for k in range(dd):
                        value = 0.0
                        for m in range(pairs):
                            value += N[m, i] * T[m, k]
                        C[i, k] = value
            if not corotated:
                for i in range(dd):
                    for k in range(dd):
                        A[p, i, k] = C[i, k]
                continue

            # the old elastic strain e turns by dR Rᵀ = P dW Pᵀ, with P = (1 − W/2)⁻¹
            for m in range(d):
                for n in range(m + 1, d):
                    for i in range(d):
                        for j in range(d):
                            dF[i, j] = 0.5 * (spin[i, m] * spin[j, n] - spin[i, n] * spin[j, m])
                    for i in range(d):
                        for j in range(d):
                            value = 0.0
                            for k in range(d):
                                value += dF[i, k] * old[k, j] - old[i, k] * dF[k, j]
                            G[i * d + j, m * d + n] = value
            for i in range(dd):
                for k in range(dd):
                    T[i, k] = C[i, k]
            for m in range(d):
                for n in range(m + 1, d):
                    for i in range(dd):
                        value = 0.0
                        for k in range(dd):
                            value += C[i, k] * G[k, m * d + n]
                        T[i, m * d + n] += value
                        T[i, n * d + m] -= value
            # by the gradient at the start, dG = M dH M with M = (1 + H/2)⁻¹
            for i in range(dd):
                for m in range(d):
                    for n in range(d):
                        work[m, n] = 0.0
                        for k in range(d):
                            work[m, n] += T[i, k * d + n] * M[k, m]
                for m in range(d):
                    for n in range(d):
                        T[i, m * d + n] = 0.0
                        for k in range(d):
                            T[i, m * d + n] += work[m, k] * M[n, k]
            # S = J σ ΔF⁻ᵀ: all three factors change
            for i in range(d):
                for j in range(d):
                    for k in range(d):
                        for m in range(d):
                            value = 0.0
                            for n in range(d):
                                value += T[i * d + n, k * d + m] * B[j, n]
                            A[p, i * d + j, k * d + m] = (
                                volume * value
                                + S[p, i * d + j] * B[m, k]
                                - S[p, i * d + m] * B[j, k]
                            )
        return -1

    return kernel
