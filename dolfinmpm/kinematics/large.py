"""Large strain: from the increment's gradient to the flux of the momentum balance, and back.

The grid starts every step undeformed, so that gradients are taken on the
configuration at the start of the step (Charlton, Coombs & Augarde 2017, doi
10.1016/j.compstruc.2017.05.004): ΔF = I + ∇ũ, trial b = ΔF b_n ΔFᵀ, principal
logarithmic strains ½ ln λ_i, Kirchhoff stress τ from the law, and the flux
S = τ ΔF⁻ᵀ that goes with ∇̃v per initial volume.
"""

from __future__ import annotations

import functools
import math

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.basis.cells import invert
from dolfinmpm.grid.tensors import eigen
from dolfinmpm.kinematics.frameworks import Array, Framework, symmetric, widened
from dolfinmpm.kinematics.pieces import (
    ask_law,
    multiply,
    read_symmetric,
    volume_ratio,
    write_stress,
    write_symmetric,
)

__all__ = ["LargeStrain"]


@functools.cache
def _stress_kernel(d: int):
    """The loop over the points in d dimensions, which Numba unrolls for that d."""
    dd = d * d

    @numba.njit(cache=True, error_model="numpy")
    def kernel(
        law, parameters, H, F_n, be_n, internal_n, S, A, want_tangent, commit, be, internal, sigma
    ):
        dF = np.zeros((3, 3))
        small, small_inv = np.empty((d, d)), np.empty((d, d))
        bn, b, Q, B = np.zeros((3, 3)), np.zeros((3, 3)), np.eye(3), np.empty((d, d))
        work = np.empty((d, 3))
        stretch, strain, trial, tau, D = (
            np.ones(3), np.empty(3), np.empty(3), np.empty(3), np.empty((3, 3))
        )  # fmt: skip
        N, T = np.empty((dd, dd)), np.empty((dd, dd))
        scratch = np.empty(max(internal_n.shape[1], 1))
        failed = -1
        for p in range(H.shape[0]):
            for i in range(d):
                for j in range(d):
                    dF[i, j] = H[p, i * d + j] + (1.0 if i == j else 0.0)
                    small[i, j] = dF[i, j]
            det = invert(small, small_inv)
            read_symmetric(be_n, p, bn)
            multiply(d, dF, bn, work)
            for i in range(d):
                for j in range(d):
                    b[i, j] = 0.0
                    for k in range(d):
                        b[i, j] += work[i, k] * dF[j, k]
            for i in range(d, 3):
                stretch[i] = bn[i, i]
            eigen(d, b, stretch, Q)
            positive = det > 0.0
            for i in range(3):
                positive = positive and stretch[i] > 0.0
            if not positive:
                failed = p
                break
            for i in range(3):
                strain[i] = 0.5 * math.log(stretch[i])
                trial[i] = strain[i]
            if not ask_law(
                law, parameters, p, strain, internal_n, internal, commit, scratch, tau, D
            ):  # fmt: skip
                failed = p
                break
            # B = ΔF⁻¹ Q: from here all is done in the principal axes
            multiply(d, small_inv, Q, B)
            if commit:
                total = det * volume_ratio(d, F_n, p, small, small_inv)
                write_stress(d, sigma, p, tau, Q, 1.0 / total)
                for i in range(3):
                    stretch[i] = math.exp(2.0 * strain[i])
                write_symmetric(d, be, p, stretch, Q)
                continue
            for i in range(d):
                for J in range(d):
                    S[p, i * d + J] = 0.0
                    for a in range(d):
                        S[p, i * d + J] += tau[a] * Q[i, a] * B[J, a]
            if not want_tangent:
                continue
            # A_iJkL = N_ab,iJ N_ce,kL c_abce with N_ab,iJ = Q_ia B_Jb, where few c are not zero
            for a in range(d):
                for e in range(d):
                    for i in range(d):
                        for J in range(d):
                            N[a * d + e, i * d + J] = Q[i, a] * B[J, e]
            for a in range(d):
                for k in range(dd):
                    value = -tau[a] * N[a * d + a, k]
                    for e in range(d):
                        value += D[a, e] * N[e * d + e, k]
                    T[a * d + a, k] = value
                for e in range(d):
                    if a == e:
                        continue
                    # (τ_a − τ_e)/(λ_a − λ_e), free of cancellation where stretches meet
                    gap = trial[a] - trial[e]
                    if abs(gap) > 1e-8:
                        secant = (tau[a] - tau[e]) / gap
                    else:
                        secant = 0.5 * (D[a, a] - D[a, e] - D[e, a] + D[e, e])
                    t = (stretch[a] - stretch[e]) / stretch[e]
                    ratio = 0.5 / stretch[e]
                    if abs(t) > 1e-12:
                        ratio *= math.log1p(t) / t
                    direct = secant * ratio * stretch[e]
                    crossed = secant * ratio * stretch[a] - tau[a]
                    for k in range(dd):
                        T[a * d + e, k] = direct * N[a * d + e, k] + crossed * N[e * d + a, k]
            for i in range(dd):
                for k in range(dd):
                    value = 0.0
                    for m in range(dd):
                        value += N[m, i] * T[m, k]
                    A[p, i, k] = value
        return failed

    return kernel


class LargeStrain(Framework):
    """A law under large strain: b = ΔF b_n ΔFᵀ, ε = ½ ln b, flux S = τ ΔF⁻ᵀ.

    The state is the field `be`, the elastic left Cauchy–Green tensor; see `Framework`.
    """

    measure = "large"
    multiplicative = True
    state = "be"
    rest = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)

    @staticmethod
    def kernel(d: int):
        """The loop over the points in d dimensions."""
        return _stress_kernel(d)

    def trial_strain(self, operand: Array, rows: npt.NDArray[np.int32]) -> Array:
        """½ ln(ΔF b_n ΔFᵀ); see `Framework.trial_strain`."""
        dF = np.eye(3) + widened(operand)
        b = dF @ symmetric(self.points[self.state][rows]) @ np.swapaxes(dF, -1, -2)
        bad = ~(np.isfinite(b).all(axis=(1, 2)) & (np.linalg.det(dF) > 0))
        b[bad] = np.eye(3)
        values, Q = np.linalg.eigh(b)
        with np.errstate(divide="ignore", invalid="ignore"):
            strain = (Q * (0.5 * np.log(values))[:, None, :]) @ np.swapaxes(Q, -1, -2)
        strain[bad] = np.nan
        return strain
