"""The loop over the points of a UMAT: Jaumann's rate or small strain around the call.

The increment's gradient H gives G = H (1 + H/2)⁻¹, the strain increment sym G and the rotation R of
Hughes and Winget, as in `Jaumann`. The UMAT gets the rotated stress R σ_n Rᵀ
and returns the new stress σ and D = DDSDDE, the derivative of σ by the strain increment.

An objective law is a function σ = R f(σ_n, Rᵀ Δε R) Rᵀ. With δΩ = δR Rᵀ therefore

    δσ = D : (δΔε − [δΩ, Δε]) + [δΩ, σ],    [Ω, a] = Ω a − a Ω,

whatever the law does with the stress that it is given. The derivative of R has the axial vector
(δw + w × δw/2)/(1 + |w|²/4), with the axial vector w of skew G. With B = (1 + H/2)⁻¹, δG = B δH B.
The flux is S = J σ ΔF⁻ᵀ.
"""

from __future__ import annotations

import functools
import math

import numba
import numpy as np

from dolfinmpm._platform.simd import matrix, numbers
from dolfinmpm.kinematics.umatpoint import (
    INLINE,
    column,
    inverse,
    product,
    put,
    respond,
    row,
    spin,
    start,
    take_six,
    turn,
)
from dolfinmpm.kinematics.umattangent import put_small_tangent, put_tangent
from dolfinmpm.materials.umatshim import OFFSETS

__all__ = ["kept_of_umat", "umat_kernel"]


def kept_of_umat(components: int, variables: int) -> int:
    """How many numbers of a point's response are kept: stress, D, three energies, the state."""
    return components * (1 + components) + 3 + variables


@functools.cache
def umat_kernel(d: int, components: int, jaumann: bool):
    """The loop in d dimensions with NTENS components, for Jaumann's rate or small strain.

    `kernel(address, properties, sizes, name, time, H, rows, of_all, state_n, kept, known, S, A,
    new, status) -> first point that fails, or -1`:

    - address, properties, sizes, name: see `call_at_points`.
    - time: time at the start of the step, length of the step, size of a cell; shape (3,).
    - H: gradients of the increment, shape (n, d²).
    - rows: numbers of the points among all points, shape (n,).
    - of_all: fields of all points: F (all, d, d), stress (all, 3, 3), total strain (all, 6),
      three energies (all,) in a tuple, positions (all, gdim), ids (all,).
    - state_n: state variables at the start of the step, shape (n, variables).
    - kept: response, shape (n, `kept_of_umat`); written, or read if `known`. One row is reused.
    - S: written unless `new` is written: flux (Pa), shape (n, d²).
    - A: written unless empty: derivative of the flux by H, shape (n, d², d²).
    - new: written unless empty: stress, total strain (xx, yy, zz, xy, yz, zx), energies, state
      variables; shapes (n, 3, 3), (n, 6), (3, n), (variables, n).
    - status: written: why the point fails, see `FAILURES`; 0 if it is turned inside out.
    """
    m, turns, turned = components, jaumann, d if jaumann else 0
    at_stress, at_strain, at_D = (OFFSETS[k] for k in ("stress", "stran", "ddsdde"))
    at_energy, at_state = OFFSETS["energies"], OFFSETS["statev"]
    kept_D, kept_energy, kept_state = m, m + m * m, m + m * m + 3

    @numba.njit(cache=True, error_model="numpy", fastmath=INLINE["fastmath"])
    def kernel(
        address, properties, sizes, name, time, H, rows, of_all, state_n, kept, known, S, A, new,
        status,
    ):  # fmt: skip
        F_n, stress_n, strain_n, energies, X, ids = of_all
        new_stress, new_strain, new_energies, new_state = new
        variables = state_n.shape[1]
        work, count = np.zeros(at_state + max(variables, 1)), sizes.copy()
        props_at, count_at, name_at = properties.ctypes.data, count.ctypes.data, name.ctypes.data
        h, F, dF, Fi = matrix(3, 3), matrix(3, 3), matrix(3, 3), matrix(3, 3)
        half, B, G, R = matrix(3, 3), matrix(3, 3), matrix(3, 3), matrix(3, 3)
        e, sigma, strain, flux = matrix(3, 3), matrix(3, 3), matrix(3, 3), matrix(3, 3)
        w = numbers(3)
        sloping, ending = A.shape[0] > 0, new_stress.shape[0] > 0
        start(work, time[0], time[1], time[2])
        for p in range(H.shape[0]):
            q = p if kept.shape[0] > 1 else 0
            number = rows[p]
            status[0] = 0
            for i in range(3):
                for j in range(3):
                    e[i, j] = 0.0
            for i in range(d):
                for j in range(d):
                    h[i, j], F[i, j] = H[p, i * d + j], F_n[number, i, j]
                    dF[i, j] = (1.0 if i == j else 0.0) + h[i, j]
                    half[i, j] = (1.0 if i == j else 0.0) + 0.5 * h[i, j]
            J, scale = 1.0, 1.0
            if jaumann:
                J = inverse(d, dF, Fi)
                middle = inverse(d, half, B)
                if not (J > 0.0 and middle > 0.0):
                    return p
                product(d, h, B, G)
                scale = spin(d, G, w)
                turn(d, w, scale, R)
            for i in range(d):
                for j in range(d):
                    e[i, j] = 0.5 * (G[i, j] + G[j, i]) if jaumann else 0.5 * (h[i, j] + h[j, i])
            if ending or not known:
                take_six(m, strain_n, number, strain)
                put(turned, m, strain, R, 2.0, work, at_strain)
            if not known:
                for i in range(3):
                    for j in range(3):
                        sigma[i, j] = stress_n[number, i, j]
                for k in range(3):
                    work[at_energy + k] = energies[k][number]
                for k in range(variables):
                    work[at_state + k] = state_n[p, k]
                count[5] = ids[number]
                status[0] = respond(
                    d, m, turns, address, props_at, count_at, name_at, work, sigma, R, e, F, dF, X,
                    number,
                )  # fmt: skip
                total = 0.0
                for k in range(m):
                    kept[q, k] = work[at_stress + k]
                    total += work[at_stress + k]
                for k in range(m * m):
                    kept[q, kept_D + k] = work[at_D + k]
                for k in range(3):
                    kept[q, kept_energy + k] = work[at_energy + k]
                for k in range(variables):
                    kept[q, kept_state + k] = work[at_state + k]
                    total += work[at_state + k]
                if status[0] != 0:
                    return p
                if not math.isfinite(total):
                    status[0] = 3
                    return p
            for k in range(m):
                sigma[row(k), column(k)] = sigma[column(k), row(k)] = kept[q, k]
            if ending:
                for k in range(6):
                    new_strain[p, k] = 0.0
                for k in range(m):
                    i, j = row(k), column(k)
                    share = 1.0 if k < 3 else 0.5
                    new_strain[p, k if k < 4 else 9 - k] = share * work[at_strain + k] + e[i, j]
                for i in range(3):
                    for j in range(3):
                        new_stress[p, i, j] = sigma[i, j] if m == 6 or i == j or i + j == 1 else 0.0
                for k in range(3):
                    new_energies[k, p] = kept[q, kept_energy + k]
                for k in range(variables):
                    new_state[k, p] = kept[q, kept_state + k]
                continue
            for i in range(d):
                for j in range(d):
                    flux[i, j] = sigma[i, j]
            if jaumann:
                J *= inverse(d, F, G)
                for i in range(d):
                    for j in range(d):
                        total = sigma[i, 0] * Fi[j, 0]
                        for k in range(1, d):
                            total += sigma[i, k] * Fi[j, k]
                        flux[i, j] = J * total
            for i in range(d):
                for j in range(d):
                    S[p, i * d + j] = flux[i, j]
            if not sloping:
                continue
            if jaumann:
                D_at = kept.ctypes.data + 8 * (q * kept.shape[1] + kept_D)
                shear = kept[q, kept_D + 3 * m + 3]
                put_tangent(d, m, D_at, shear, w, scale, e, sigma, B, Fi, J, flux, A, p)
            else:
                put_small_tangent(d, m, kept, kept_D, q, A, p)
        return -1

    return kernel
