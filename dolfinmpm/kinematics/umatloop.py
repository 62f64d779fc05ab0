"""The loop over the points of a UMAT: Jaumann's rate or small strain around the call.

The increment's gradient H gives G = H (1 + H/2)⁻¹, the strain increment sym G and the rotation R of
Hughes and Winget, as in `dolfinmpm.kinematics.jaumann`. The UMAT gets the rotated stress R σ_n Rᵀ
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

from dolfinmpm.basis.cells import invert
from dolfinmpm.materials.umatcall import call_umat
from dolfinmpm.materials.umatshim import OFFSETS

__all__ = ["kept_of_umat", "umat_kernel"]

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
# where the components of a UMAT are in fields of six numbers, which end in xy, yz, zx
_SIX = (0, 1, 2, 3, 5, 4)


def kept_of_umat(components: int, variables: int) -> int:
    """How many numbers of a point's response are kept: stress, D, three energies, the state."""
    return components * (1 + components) + 3 + variables


@functools.cache
def umat_kernel(d: int, components: int):
    """The loop in d dimensions with NTENS components.

    `kernel(address, properties, numbers, name, jaumann, time, H, rows, of_all, state_n, kept,
    known, S, A, new, status) -> first point that fails, or -1`:

    - address, properties, numbers, name: see `call_at_points`.
    - jaumann: True for Jaumann's rate, False for small strain.
    - time: time at the start of the step, length of the step, size of a cell; shape (3,).
    - H: gradients of the increment, shape (n, d²).
    - rows: numbers of the points among all points, shape (n,).
    - of_all: fields of all points: F (all, d, d), stress (all, 3, 3), total strain (all, 6),
      energies (all, 3), positions (all, gdim), ids (all,).
    - state_n: state variables at the start of the step, shape (n, variables).
    - kept: response, shape (n, `kept_of_umat`); written, or read if `known`. One row is reused.
    - S: written unless `new` is written: flux (Pa), shape (n, d²).
    - A: written unless empty: derivative of the flux by H, shape (n, d², d²).
    - new: written unless empty: stress, total strain (xx, yy, zz, xy, yz, zx), energies; shapes
      (n, 6), (n, 6), (n, 3).
    - status: written: why the point fails, see `FAILURES`; 0 if it is turned inside out.
    """
    m, dd = components, d * d
    turns = 3 if m == 6 else 1
    # the axis of a rotation, and the plane in which it turns
    one, two = ((1, 2, 0), (2, 0, 1)) if turns == 3 else ((0, 0, 0), (1, 1, 1))
    row = tuple(i for i, _ in _PAIRS[:m])
    column = tuple(j for _, j in _PAIRS[:m])
    six = _SIX[:m]
    at_stress, at_de, at_strain, at_D = (
        OFFSETS[k] for k in ("stress", "dstran", "stran", "ddsdde")
    )
    at_R, at_F0, at_F1 = OFFSETS["drot"], OFFSETS["dfgrd0"], OFFSETS["dfgrd1"]
    at_time, at_dt, at_x, at_size = (OFFSETS[k] for k in ("time", "dtime", "coords", "celent"))
    at_energy, at_new, at_state = (OFFSETS[k] for k in ("energies", "pnewdt", "statev"))

    @numba.njit(cache=True, error_model="numpy")
    def kernel(
        address, properties, numbers, name, jaumann, time, H, rows, of_all, state_n, kept, known,
        S, A, new, status,
    ):  # fmt: skip
        F_n, stress_n, strain_n, energy_n, x, ids = of_all
        new_stress, new_strain, new_energy = new
        variables = state_n.shape[1]
        work = np.zeros(at_state + max(variables, 1))
        count = numbers.copy()
        dF, Fi = np.empty((d, d)), np.empty((d, d))
        half, spare = np.empty((d, d)), np.empty((d, d))
        B, R = np.empty((d, d)), np.eye(3)
        old, sigma, e = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
        turned, w, of_w = np.zeros((3, 3)), np.zeros(3), np.empty((turns, dd))
        M, T, D = np.zeros((m, dd)), np.empty((m, turns)), np.empty((m, m))
        slope, dw = np.empty((m, dd)), np.empty((turns, dd))
        side, full = np.empty(m), np.empty((3, 3, dd))
        sloping, ending = A.shape[0] > 0, new_stress.shape[0] > 0
        at_kept_D, at_kept_energy, at_kept_state = m, m + m * m, m + m * m + 3
        for p in range(H.shape[0]):
            q = p if kept.shape[0] > 1 else 0
            number = rows[p]
            status[0] = 0
            for i in range(d):
                for j in range(d):
                    unit = 1.0 if i == j else 0.0
                    dF[i, j] = unit + H[p, i * d + j]
                    half[i, j] = unit + 0.5 * H[p, i * d + j]
            J = 1.0
            if jaumann:
                J = invert(dF, Fi)
                middle = invert(half, B)
                if not (J > 0.0 and middle > 0.0):
                    return p
            # G in the first d rows and columns of e: symmetric part, and w of the skew part
            for i in range(d):
                for j in range(d):
                    total = H[p, i * d + j]
                    if jaumann:
                        total = 0.0
                        for k in range(d):
                            total += H[p, i * d + k] * B[k, j]
                    turned[i, j] = total
            for i in range(d):
                for j in range(d):
                    e[i, j] = 0.5 * (turned[i, j] + turned[j, i])
            square = 0.0
            for a in range(turns):
                # W v = w × v
                w[a] = 0.5 * (turned[two[a], one[a]] - turned[one[a], two[a]]) if jaumann else 0.0
                square += w[a] * w[a]
            scale = 1.0 / (1.0 + 0.25 * square)
            if jaumann:
                if turns == 1:
                    R[0, 0] = R[1, 1] = 1.0 - 0.5 * square * scale
                    R[1, 0] = w[0] * scale
                    R[0, 1] = -R[1, 0]
                else:
                    for i in range(3):
                        for j in range(3):
                            R[i, j] = 0.5 * scale * w[i] * w[j]
                        R[i, i] += 1.0 - 0.5 * scale * square
                    for a in range(3):
                        R[two[a], one[a]] += w[a] * scale
                        R[one[a], two[a]] -= w[a] * scale
            if not known:
                for i in range(3):
                    for j in range(3):
                        old[i, j] = stress_n[number, i, j]
                        work[at_R + i + 3 * j] = R[i, j]
                        work[at_F0 + i + 3 * j] = 1.0 if i == j else 0.0
                        work[at_F1 + i + 3 * j] = 1.0 if i == j else 0.0
                for i in range(d):
                    for j in range(d):
                        work[at_F0 + i + 3 * j] = F_n[number, i, j]
                        total = 0.0
                        for k in range(d):
                            total += dF[i, k] * F_n[number, k, j]
                        work[at_F1 + i + 3 * j] = total
                for i in range(3):
                    for j in range(3):
                        total = 0.0
                        for k in range(3):
                            total += R[i, k] * old[k, j]
                        turned[i, j] = total
                for k in range(m):
                    i, j = row[k], column[k]
                    work[at_stress + k] = (
                        turned[i, 0] * R[j, 0] + turned[i, 1] * R[j, 1] + turned[i, 2] * R[j, 2]
                    )
                    work[at_de + k] = e[i, j] if k < 3 else 2.0 * e[i, j]
                    old[i, j] = old[j, i] = strain_n[number, six[k]]
                for i in range(3):
                    for j in range(3):
                        total = 0.0
                        for k in range(3):
                            total += R[i, k] * old[k, j]
                        turned[i, j] = total
                for k in range(m):
                    i, j = row[k], column[k]
                    total = turned[i, 0] * R[j, 0] + turned[i, 1] * R[j, 1] + turned[i, 2] * R[j, 2]
                    work[at_strain + k] = total if k < 3 else 2.0 * total
                for k in range(m * m):
                    work[at_D + k] = 0.0
                work[at_time], work[at_time + 1] = time[0], time[0]
                work[at_dt], work[at_size], work[at_new] = time[1], time[2], 1.0
                for k in range(3):
                    work[at_energy + k] = energy_n[number, k]
                for k in range(x.shape[1]):
                    work[at_x + k] = x[number, k]
                for k in range(variables):
                    work[at_state + k] = state_n[p, k]
                count[5] = ids[number]
                status[0] = call_umat(
                    address, work.ctypes.data, properties.ctypes.data, count.ctypes.data,
                    name.ctypes.data,
                )  # fmt: skip
                total = 0.0
                for k in range(m):
                    kept[q, k] = work[at_stress + k]
                    total += kept[q, k]
                for k in range(m * m):
                    kept[q, at_kept_D + k] = work[at_D + k]
                for k in range(3):
                    kept[q, at_kept_energy + k] = work[at_energy + k]
                for k in range(variables):
                    kept[q, at_kept_state + k] = work[at_state + k]
                    total += work[at_state + k]
                if status[0] != 0:
                    return p
                if not math.isfinite(total):
                    status[0] = 3
                    return p
            if ending:
                for k in range(6):
                    new_stress[p, k] = 0.0
                    new_strain[p, k] = 0.0
                for k in range(m):
                    new_stress[p, six[k]] = kept[q, k]
                for i in range(3):
                    for j in range(3):
                        old[i, j] = 0.0
                for k in range(m):
                    old[row[k], column[k]] = old[column[k], row[k]] = strain_n[number, six[k]]
                for i in range(3):
                    for j in range(3):
                        total = 0.0
                        for k in range(3):
                            total += R[i, k] * old[k, j]
                        turned[i, j] = total
                for k in range(m):
                    i, j = row[k], column[k]
                    total = turned[i, 0] * R[j, 0] + turned[i, 1] * R[j, 1] + turned[i, 2] * R[j, 2]
                    new_strain[p, six[k]] = total + e[i, j]
                for k in range(3):
                    new_energy[p, k] = kept[q, at_kept_energy + k]
                continue
            for k in range(m):
                sigma[row[k], column[k]] = sigma[column[k], row[k]] = kept[q, k]
            if jaumann:
                for i in range(d):
                    for j in range(d):
                        half[i, j] = F_n[number, i, j]
                J *= invert(half, spare)
            for i in range(d):
                for j in range(d):
                    total = sigma[i, j]
                    if jaumann:
                        total = 0.0
                        for k in range(d):
                            total += sigma[i, k] * Fi[j, k]
                        total *= J
                    S[p, i * d + j] = total
            if not sloping:
                continue
            for j in range(m):
                for k in range(m):
                    D[k, j] = kept[q, at_kept_D + j * m + k]
            # M: derivative of the strain increment, with engineering shear strains, by H
            for k in range(m):
                i, j = row[k], column[k]
                if i >= d or j >= d:
                    continue
                for r in range(d):
                    for s in range(d):
                        if jaumann:
                            total = B[i, r] * B[s, j]
                            if i != j:
                                total += B[j, r] * B[s, i]
                        else:
                            total = 1.0 if (r == i and s == j) or (r == j and s == i) else 0.0
                        M[k, r * d + s] = total
            for k in range(m):
                for c in range(dd):
                    slope[k, c] = 0.0
                for j in range(m):
                    for c in range(dd):
                        slope[k, c] += D[k, j] * M[j, c]
            if jaumann and d > 1:
                for a in range(turns):
                    i, j = two[a], one[a]
                    for r in range(d):
                        for s in range(d):
                            dw[a, r * d + s] = 0.5 * (B[i, r] * B[s, j] - B[j, r] * B[s, i])
                if turns == 1:
                    for c in range(dd):
                        of_w[0, c] = scale * dw[0, c]
                else:
                    for a in range(3):
                        for c in range(dd):
                            of_w[a, c] = scale * (
                                dw[a, c]
                                + 0.5 * (w[one[a]] * dw[two[a], c] - w[two[a]] * dw[one[a], c])
                            )
                for a in range(turns):
                    i, j = one[a], two[a]
                    # the unit rotation has −1 at (i, j) and 1 at (j, i); [Ω, a] = Ω a + (Ω a)ᵀ
                    for k in range(m):
                        r, s = row[k], column[k]
                        strain = stress = 0.0
                        if r == i:
                            strain -= e[j, s]
                            stress -= sigma[j, s]
                        if r == j:
                            strain += e[i, s]
                            stress += sigma[i, s]
                        if s == i:
                            strain -= e[j, r]
                            stress -= sigma[j, r]
                        if s == j:
                            strain += e[i, r]
                            stress += sigma[i, r]
                        side[k] = strain if k < 3 else 2.0 * strain
                        T[k, a] = stress
                    for k in range(m):
                        for j in range(m):
                            T[k, a] -= D[k, j] * side[j]
                for k in range(m):
                    for a in range(turns):
                        for c in range(dd):
                            slope[k, c] += T[k, a] * of_w[a, c]
            if not jaumann:
                for k in range(m):
                    i, j = row[k], column[k]
                    if i < d and j < d:
                        for c in range(dd):
                            A[p, i * d + j, c] = slope[k, c]
                            A[p, j * d + i, c] = slope[k, c]
                if d == 3 and m == 4:
                    for c in range(dd):
                        A[p, 2, c] = A[p, 5, c] = A[p, 6, c] = A[p, 7, c] = 0.0
                continue
            if d == 3 and m == 4:
                full[:] = 0.0
            for k in range(m):
                for c in range(dd):
                    full[row[k], column[k], c] = full[column[k], row[k], c] = slope[k, c]
            for i in range(d):
                for j in range(d):
                    to = i * d + j
                    for c in range(dd):
                        A[p, to, c] = 0.0
                    for k in range(d):
                        factor = J * Fi[j, k]
                        for c in range(dd):
                            A[p, to, c] += factor * full[i, k, c]
                    for r in range(d):
                        for s in range(d):
                            # derivatives of det ΔF and of ΔF⁻ᵀ
                            A[p, to, r * d + s] += S[p, to] * Fi[s, r] - Fi[j, r] * S[p, i * d + s]
        return -1

    return kernel
