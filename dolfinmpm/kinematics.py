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
import ufl
from numba import types
from numba.extending import intrinsic

from dolfinmpm.basis.cells import invert
from dolfinmpm.forms.operators import PointOperator
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.neohookean import NeoHookean
from dolfinmpm.points import MaterialPoints
from dolfinmpm.tensors import eigen

__all__ = ["LargeStrain", "momentum", "update_domains"]

Array = npt.NDArray[np.float64]


@intrinsic
def _call_law(typingctx, address, parameters, strain, old, new, stress, tangent):
    signature = types.int32(*[types.intp] * 7)

    def generate(context, builder, sig, args):
        from llvmlite import ir

        pointer = ir.DoubleType().as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [pointer] * 6)
        function = builder.inttoptr(args[0], kind.as_pointer())
        return builder.call(function, [builder.inttoptr(a, pointer) for a in args[1:]])

    return signature, generate


@functools.cache
def _stress_kernel(d: int):
    """The loop over the points in d dimensions, which Numba unrolls for that d."""

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
        g = np.zeros((d, d))
        c = np.empty((d, d, d, d))
        half = np.empty((d, d, d, d))
        scratch = np.empty(max(internal_n.shape[1], 1))
        failed = -1
        for p in range(H.shape[0]):
            for i in range(d):
                for j in range(d):
                    dF[i, j] = H[p, i * d + j] + (1.0 if i == j else 0.0)
                    small[i, j] = dF[i, j]
            det = invert(small, small_inv)
            bn[0, 0], bn[1, 1], bn[2, 2] = be_n[p, 0], be_n[p, 1], be_n[p, 2]
            bn[0, 1] = bn[1, 0] = be_n[p, 3]
            bn[1, 2] = bn[2, 1] = be_n[p, 4]
            bn[0, 2] = bn[2, 0] = be_n[p, 5]
            for i in range(d):
                for j in range(d):
                    work[i, j] = 0.0
                    for k in range(d):
                        work[i, j] += dF[i, k] * bn[k, j]
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
            at = p if parameters.shape[0] > 1 else 0
            status = _call_law(
                law, parameters.ctypes.data + 8 * at * parameters.shape[1], strain.ctypes.data,
                internal_n.ctypes.data + 8 * p * internal_n.shape[1],
                (internal.ctypes.data + 8 * p * internal.shape[1]) if commit
                else scratch.ctypes.data,
                tau.ctypes.data, D.ctypes.data,
            )  # fmt: skip
            if status != 0 or not math.isfinite(tau[0] + tau[1] + tau[2]):
                failed = p
                break
            # B = ΔF⁻¹ Q: from here all is done in the principal axes
            for J in range(d):
                for a in range(d):
                    B[J, a] = 0.0
                    for m in range(d):
                        B[J, a] += small_inv[J, m] * Q[m, a]
            if commit:
                total = det
                if d == 1:
                    total *= F_n[p, 0, 0]
                elif d == 2:
                    total *= F_n[p, 0, 0] * F_n[p, 1, 1] - F_n[p, 0, 1] * F_n[p, 1, 0]
                else:
                    for i in range(3):
                        for j in range(3):
                            small[i, j] = F_n[p, i, j]
                    total *= invert(small, small_inv)
                for i in range(3):
                    be[p, i] = math.exp(2.0 * strain[i]) if i >= d else 0.0
                    be[p, 3 + i] = 0.0
                    for j in range(3):
                        sigma[p, i, j] = tau[i] / total if i == j and i >= d else 0.0
                for a in range(d):
                    squared = math.exp(2.0 * strain[a])
                    for i in range(d):
                        be[p, i] += squared * Q[i, a] * Q[i, a]
                        for j in range(d):
                            sigma[p, i, j] += tau[a] / total * Q[i, a] * Q[j, a]
                    if d > 1:
                        be[p, 3] += squared * Q[0, a] * Q[1, a]
                    if d > 2:
                        be[p, 4] += squared * Q[1, a] * Q[2, a]
                        be[p, 5] += squared * Q[0, a] * Q[2, a]
                continue
            for i in range(d):
                for J in range(d):
                    S[p, i * d + J] = 0.0
                    for a in range(d):
                        S[p, i * d + J] += tau[a] * Q[i, a] * B[J, a]
            if not want_tangent:
                continue
            # (τ_a − τ_b)/(λ_a − λ_b), free of cancellation where stretches meet
            for a in range(d):
                for e in range(d):
                    if a == e:
                        continue
                    gap = trial[a] - trial[e]
                    if abs(gap) > 1e-6:
                        secant = (tau[a] - tau[e]) / gap
                    else:
                        secant = 0.5 * (D[a, a] - D[a, e] - D[e, a] + D[e, e])
                    t = (stretch[a] - stretch[e]) / stretch[e]
                    ratio = 0.5 / stretch[e]
                    if abs(t) > 1e-12:
                        ratio *= math.log1p(t) / t
                    g[a, e] = secant * ratio
            for a in range(d):
                for e in range(d):
                    for k in range(d):
                        for m in range(d):
                            c[a, e, k, m] = 0.0
            for a in range(d):
                for e in range(d):
                    c[a, a, e, e] += D[a, e]
                    c[a, e, e, a] -= tau[a]
                    if a != e:
                        c[a, e, a, e] += g[a, e] * stretch[e]
                        c[a, e, e, a] += g[a, e] * stretch[a]
            # A_iJkL = Q_ia B_Jb Q_kc B_Ld c_abcd, two indices at a time
            for i in range(d):
                for J in range(d):
                    for k in range(d):
                        for m in range(d):
                            half[i, J, k, m] = 0.0
                    for a in range(d):
                        for e in range(d):
                            weight = Q[i, a] * B[J, e]
                            for k in range(d):
                                for m in range(d):
                                    half[i, J, k, m] += weight * c[a, e, k, m]
            for i in range(d):
                for J in range(d):
                    for k in range(d):
                        for L in range(d):
                            value = 0.0
                            for a in range(d):
                                for e in range(d):
                                    value += half[i, J, a, e] * Q[k, a] * B[L, e]
                            A[p, i * d + J, k * d + L] = value
        return failed

    return kernel


class LargeStrain:
    """A law under large strain, as an operator of the increment's gradient.

    Adds the field `be` to the points: the elastic left Cauchy–Green tensor as
    (xx, yy, zz, xy, yz, zx), shape (6,), and one field for each of the law's
    internal variables together, `<law>_internal`.

    Args:
        law: Constitutive law.
        points: Material points.
    """

    def __init__(self, law: Law, points: MaterialPoints):
        self.law = law
        self.points = points
        points.add_field("be", (6,), "", (1.0, 1.0, 1.0, 0.0, 0.0, 0.0))
        self._internal = None
        if law.internal:
            self._internal = f"{type(law).__name__.lower()}_internal"
            first = [value for _, value in law.internal.values()]
            points.add_field(self._internal, (len(first),), "", first)
        self._kernel = _stress_kernel(points.gdim)
        self._parameters = law.parameter_array

    def _run(self, operand, S, A, want_tangent, here, be, internal, sigma) -> int:
        points = self.points
        old = points[self._internal] if self._internal else np.empty((len(points), 0))
        parameters = self._parameters if len(self._parameters) == 1 else self._parameters[here]
        be_n = points["be"]
        if not isinstance(here, slice):
            be_n = be_n.take(here, axis=0)
        return self._kernel(
            self.law.address, parameters, operand, points["F"], be_n, old[here],
            S, A, want_tangent, len(sigma) > 0, be, internal, sigma,
        )  # fmt: skip

    def evaluate(self, operand: Array, value: Array, tangent: Array | None, rows) -> int:
        """S and its derivative by ∇ũ; see `PointwiseLaw`."""
        nothing = np.empty((0, 6)), np.empty((0, 0)), np.empty((0, 3, 3))
        A = np.empty((0, 1, 1)) if tangent is None else tangent
        return self._run(operand, value, A, tangent is not None, rows, *nothing)

    def commit(self, operand: Array) -> dict[str, Array]:
        """Elastic strain, internal variables and Cauchy stress at the end of the step."""
        points = self.points
        n = len(points)
        new = {"be": np.empty((n, 6)), "stress": np.empty((n, 3, 3))}
        internal = np.empty((n, len(self.law.internal)))
        if self._internal:
            new[self._internal] = internal
        if n:
            none = np.empty((0, 1)), np.empty((0, 1, 1))
            self._run(operand, *none, False, slice(None), new["be"], internal, new["stress"])
        return new


def momentum(law: Law | NeoHookean, points: MaterialPoints, u, v) -> ufl.Form:
    """Internal forces of a body under large strain, per step: Σ V0 τ : (∇̃v ΔF⁻¹).

    Args:
        law: Constitutive law: one with a kernel, or one that is an energy in UFL.
        points: Material points; the law adds its state to their fields.
        u: Increment of the step, `Space.increment`.
        v: Test function, `Space.test`.

    Returns:
        A form over the points, to which loads and further terms are added.
    """
    if isinstance(law, Law):
        operand = ufl.grad(u)
        stress = PointOperator(
            points, LargeStrain(law, points), operand, operand.ufl_shape, repr(law)
        )
        return ufl.inner(stress, ufl.grad(v)) * points.dX
    F = (ufl.Identity(points.gdim) + ufl.grad(u)) * points.F
    points.updates["stress"] = law.cauchy_stress(F)
    return ufl.derivative(law.energy(F) * points.dX, u, v)


@numba.njit(cache=True)
def _stretches(F, l0, lengths):
    d = F.shape[1]
    C, Q, values = np.empty((d, d)), np.empty((d, d)), np.empty(d)
    for p in range(F.shape[0]):
        for i in range(d):
            for j in range(d):
                C[i, j] = 0.0
                for k in range(d):
                    C[i, j] += F[p, k, i] * F[p, k, j]
        eigen(d, C, values, Q)
        for i in range(d):
            stretch = 0.0
            for a in range(d):
                stretch += math.sqrt(values[a]) * Q[i, a] * Q[i, a]
            lengths[p, i] = l0[p, i] * stretch


def update_domains(F: Array, l0: Array) -> Array:
    """Half-lengths l = l0 · diag(U), U = √(FᵀF), of the GIMP domains (m).

    Args:
        F: Deformation gradients, shape (points, d, d).
        l0: First half-lengths (m), shape (points, d).
    """
    lengths = np.empty_like(l0)
    _stretches(F, l0, lengths)
    return lengths
