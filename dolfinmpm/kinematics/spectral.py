"""The loop over the points: isotropic laws in the principal axes of their trial tensors.

A law is a function of three principal strains. An isotropic function of a symmetric tensor has the
axes of the tensor. Its derivative follows from the derivative of the principal values: along the
axes n_a ⊗ n_a it is the law's tangent, between two axes it is the secant of the values (Ogden 1984,
Non-Linear Elastic Deformations, §6.1.4; de Souza Neto, Perić & Owen 2008, Computational Methods
for Plasticity, appendix A). The steps before and after the law are functions that FFCx has
compiled: from the increment to the trial tensor, and from the law's stress to the flux; see
`dolfinmpm.kinematics.strainfunctions`. The loop calls these functions by their addresses, so
that the data of a point stay in the cache.

Symmetric tensors are stored as rows of numbers: xx, yy, zz, xy, yz, xz in fields of points. Trial
tensors and stresses have only the components within the dimensions of the points. Directions out of
these dimensions are principal axes.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numba
import numpy as np

from dolfinmpm.forms.pointwise import call_tabulate
from dolfinmpm.grid.tensors import eigen, eigen_2
from dolfinmpm.materials.lawkernel import call_law

__all__ = ["Layout", "components", "kept_numbers", "layout", "stress_kernel"]


def components(d: int) -> list[tuple[int, int]]:
    """Indices of the independent components of a symmetric tensor in d dimensions, in order."""
    return [*((i, i) for i in range(d)), *[(0, 1), (1, 2), (0, 2)][: d * (d - 1) // 2]]


@dataclass(frozen=True)
class Layout:
    """Positions of a point's data in the array of constants of all compiled functions.

    m is the number of independent components of a symmetric tensor in d dimensions.

    Attributes:
        H: Gradient of the increment, d² numbers.
        F: Deformation gradient at the start of the step, d² numbers.
        state: Elastic state at the start of the step, 6 numbers.
        G: First stage of the trial tensor, d² numbers.
        stress: The law's stress, m numbers.
        law: Derivative of the stress by the trial tensor, m² numbers.
        slope: Derivative of the trial tensor by H, m d² numbers, for two stages.
        size: Number of all numbers.
    """

    H: int
    F: int
    state: int
    G: int
    stress: int
    law: int
    slope: int
    size: int


def layout(d: int) -> Layout:
    """The layout in d dimensions."""
    m = len(components(d))
    sizes = [d * d, d * d, 6, d * d, m, m * m, m * d * d]
    return Layout(*(sum(sizes[:k]) for k in range(len(sizes) + 1)))


def kept_numbers(d: int, variables: int) -> int:
    """How many numbers of a point's response `stress_kernel` keeps.

    They are the principal axes (d²), the principal values of the trial tensor (3), the principal
    strains before and after the law (3 each), the principal stresses (3), the law's tangent (9),
    and the internal variables.

    Args:
        d: Dimension of space.
        variables: Number of internal variables.
    """
    return d * d + 4 * 3 + 9 + variables


@functools.cache
def stress_kernel(d: int):
    """The loop in d dimensions; Numba unrolls its inner loops for this d.

    `kernel(law, parameters, programs, checks, logarithmic, H, numbers, F_n, state_n, internal_n,
    kept, known, S, A, state, internal, stress) -> first point without a stress, or -1`. m is the
    number of independent components of a symmetric tensor in d dimensions. The arguments are:

    - law, parameters: address of the law's kernel; its parameters, shape (1, parameters) or
      (n, parameters).
    - programs: addresses of the compiled functions, see `StrainFunctions.programs`.
    - checks: how many numbers of the first program must be positive.
    - logarithmic: True if ε = ½ ln b for the trial tensor b. False if the trial tensor is ε.
    - H: the increment's gradient at n points, shape (n, d²).
    - numbers: numbers of these points among all points, shape (n,).
    - F_n, state_n: deformation gradient and elastic state of all points at the start of the step,
      shapes (all, d, d) and (all, 6). The kernel picks the n rows itself, which saves a copy.
    - internal_n: internal variables at the start of the step, shape (n, variables).
    - kept: response of the law, shape (n, `kept_numbers`). It is written, or read if `known`,
      without another call of the law. With one row, the row is reused and nothing is kept.
    - S: written unless `state` is written: the flux (Pa), shape (n, d²).
    - A: written unless empty: derivative of the flux by H, shape (n, d², d²).
    - state, internal, stress: written unless empty: elastic state, internal variables and Cauchy
      stress (Pa) at the end of the step, shapes (n, 6), (n, variables) and (n, 6).
    """
    index = components(d)
    m, dd, at = len(index), d * d, layout(d)
    rows, columns = tuple(i for i, _ in index), tuple(j for _, j in index)
    first = tuple(a for a, b in index[d:])
    second = tuple(b for a, b in index[d:])
    if d == 1:
        first = second = (0,)  # Numba does not support empty tuples of integers
    at_H, at_F, at_state, at_G = at.H, at.F, at.state, at.G
    at_stress, at_law, at_slope, size = at.stress, at.law, at.slope, at.size
    # columns of `kept`, see `kept_numbers`: one array compiles faster than six arrays
    at_value, at_given, at_strain, at_tau, at_C, at_new = (dd + k for k in (0, 3, 6, 9, 12, 21))

    @numba.njit(cache=True, error_model="numpy")
    def kernel(
        law, parameters, programs, checks, logarithmic, H, numbers, F_n, state_n, internal_n, kept,
        known, S, A, state, internal, stress,
    ):  # fmt: skip
        z, out = np.zeros(size), np.empty(checks + max(m, dd))
        tensor, Q, value = np.empty((d, d)), np.empty((d, d)), np.empty(3)
        N, W = np.empty((m, m)), np.empty((m, m))
        by_H, by_G = np.empty((dd, dd)), np.empty((m, dd))
        ratio_of, row_of = np.empty(1), np.empty(m)
        variables = internal_n.shape[1]
        ending, sloping = state.shape[0] > 0, A.shape[0] > 0
        trial_of, second_of, flux_of, volume_of, tangent_of, slope_of, second_slope_of = programs
        staged = second_of != 0
        data = z.ctypes.data
        for p in range(H.shape[0]):
            q = p if kept.shape[0] > 1 else 0
            number = numbers[p]
            for k in range(dd):
                z[at_H + k] = H[p, k]
            for i in range(d):
                for j in range(d):
                    z[at_F + i * d + j] = F_n[number, i, j]
            for k in range(6):
                z[at_state + k] = state_n[number, k]
            start = checks
            if staged or not known:
                out[:] = 0.0
                call_tabulate(trial_of, out.ctypes.data, data)
                for k in range(checks):
                    if not out[k] > 0.0:
                        return p
            if staged:
                for k in range(dd):
                    z[at_G + k] = out[checks + k]
            if not known:
                if staged:
                    out[:] = 0.0
                    start = 0
                    call_tabulate(second_of, out.ctypes.data, data)
                if d == 2:
                    xx, yy, xy = out[start], out[start + 1], out[start + 2]
                    kept[q, at_value], kept[q, at_value + 1], c, s = eigen_2(xx, yy, xy)
                    kept[q, 0], kept[q, 1], kept[q, 2], kept[q, 3] = c, s, -s, c
                else:
                    for k in range(m):
                        i, j = rows[k], columns[k]
                        tensor[i, j] = tensor[j, i] = out[start + k]
                    eigen(d, tensor, value, Q)
                    for i in range(d):
                        kept[q, at_value + i] = value[i]
                        for a in range(d):
                            kept[q, i * d + a] = Q[i, a]
                for i in range(d, 3):
                    kept[q, at_value + i] = state_n[number, i]
                for i in range(3):
                    strain = kept[q, at_value + i]
                    if logarithmic:
                        if not strain > 0.0:
                            return p
                        # out of the plane the strain is mostly zero
                        strain = 0.5 * math.log(strain) if strain != 1.0 else 0.0
                    kept[q, at_given + i] = kept[q, at_strain + i] = strain
                row = p if parameters.shape[0] > 1 else 0
                response = kept.ctypes.data + 8 * q * kept.shape[1]
                status = call_law(
                    law, parameters.ctypes.data + 8 * row * parameters.shape[1],
                    response + 8 * at_strain, internal_n.ctypes.data + 8 * p * variables,
                    response + 8 * at_new, response + 8 * at_tau, response + 8 * at_C,
                )  # fmt: skip
                total = kept[q, at_tau] + kept[q, at_tau + 1] + kept[q, at_tau + 2]
                if status != 0 or not math.isfinite(total):
                    return p
            for a in range(d):
                for k in range(m):
                    N[a, k] = kept[q, rows[k] * d + a] * kept[q, columns[k] * d + a]
            if ending:
                for i in range(variables):
                    internal[p, i] = kept[q, at_new + i]
                ratio_of[0] = 0.0
                call_tabulate(volume_of, ratio_of.ctypes.data, data)
                for i in range(3):
                    strain = kept[q, at_strain + i]
                    value[i] = math.exp(2.0 * strain) if logarithmic else strain
                for i in range(6):
                    state[p, i] = stress[p, i] = 0.0
                for i in range(d, 3):
                    state[p, i], stress[p, i] = value[i], kept[q, at_tau + i] / ratio_of[0]
                for k in range(m):
                    to = k if k < d else 3 + k - d
                    for a in range(d):
                        state[p, to] += value[a] * N[a, k]
                        stress[p, to] += kept[q, at_tau + a] / ratio_of[0] * N[a, k]
                continue
            for k in range(m):
                z[at_stress + k] = 0.0
                for a in range(d):
                    z[at_stress + k] += kept[q, at_tau + a] * N[a, k]
            for k in range(dd):
                S[p, k] = 0.0
            call_tabulate(flux_of, S.ctypes.data + 8 * p * dd, data)
            if not sloping:
                continue
            # symmetric basis: n_a ⊗ n_a along the axes, n_a ⊗ n_b + n_b ⊗ n_a between two axes
            for a in range(d):
                for k in range(m):
                    W[a, k] = 0.0
            for b in range(d):
                slope = 0.5 / kept[q, at_value + b] if logarithmic else 1.0
                for a in range(d):
                    C = kept[q, at_C + 3 * a + b] * slope
                    for k in range(m):
                        W[a, k] += C * N[b, k]
            for r in range(d, m):
                a, b = first[r - d], second[r - d]
                gap = kept[q, at_given + a] - kept[q, at_given + b]
                tau_a, tau_b = kept[q, at_tau + a], kept[q, at_tau + b]
                aa, bb = kept[q, at_C + 4 * a], kept[q, at_C + 4 * b]
                if logarithmic:
                    apart = abs(gap) > 1e-8
                else:
                    # a difference of stresses is useless if it is only a rounding error
                    apart = abs(gap) * (abs(aa) + abs(bb)) > 1e-8 * (abs(tau_a) + abs(tau_b))
                if apart:
                    secant = (tau_a - tau_b) / gap
                else:
                    ab, ba = kept[q, at_C + 3 * a + b], kept[q, at_C + 3 * b + a]
                    secant = 0.5 * (aa - ab - ba + bb)
                if logarithmic:
                    # (ε_a − ε_b)/(λ_a − λ_b), without cancellation for nearly equal stretches
                    value_b = kept[q, at_value + b]
                    t = (kept[q, at_value + a] - value_b) / value_b
                    ratio = 0.5 / value_b
                    if abs(t) > 1e-12:
                        ratio *= math.log1p(t) / t
                    secant *= ratio
                for k in range(m):
                    i, j = rows[k] * d, columns[k] * d
                    N[r, k] = 0.5 * (
                        kept[q, i + a] * kept[q, j + b] + kept[q, j + a] * kept[q, i + b]
                    )
                    W[r, k] = 2.0 * secant * N[r, k]
            # an off-diagonal component is at two places of the tensor
            for r in range(m):
                for j in range(d, m):
                    W[r, j] *= 2.0
            for k in range(m):
                for j in range(m):
                    row_of[j] = 0.0
                for r in range(m):
                    for j in range(m):
                        row_of[j] += N[r, k] * W[r, j]
                for j in range(m):
                    z[at_law + k * m + j] = row_of[j]
            if staged:
                by_H[:] = 0.0
                by_G[:] = 0.0
                call_tabulate(slope_of, by_H.ctypes.data, data)
                call_tabulate(second_slope_of, by_G.ctypes.data, data)
                for k in range(m):
                    for j in range(dd):
                        total = 0.0
                        for i in range(dd):
                            total += by_G[k, i] * by_H[i, j]
                        z[at_slope + k * dd + j] = total
            for i in range(dd):
                for j in range(dd):
                    A[p, i, j] = 0.0
            call_tabulate(tangent_of, A.ctypes.data + 8 * p * dd * dd, data)
        return -1

    return kernel
