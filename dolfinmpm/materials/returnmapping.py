"""Closest-point return in principal axes, for functions compiled by FFCx."""

from __future__ import annotations

import functools
import math
from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from dolfinmpm.forms.pointwise import call_tabulate
from dolfinmpm.materials.lawkernel import KERNEL_SIGNATURE
from dolfinmpm.materials.parametrised import Array

__all__ = ["return_kernel", "yield_values"]

_ROOT = math.sqrt(2.0 / 3.0)
_TIGHT, _LOOSE = 1e-14, 1e-10  # residual by the strain's size: aimed at, and still accepted
_ARGUMENTS = KERNEL_SIGNATURE.args
_MAPPING_SIGNATURE = types.int32(*[types.intp] * 4, *_ARGUMENTS)


@intrinsic
def _call_mapping(typingctx, function, energy, value, full, count, *arguments):
    """Call the kernel at an address with the functions' addresses in front."""
    signature = types.int32(*[types.intp] * 5, types.Tuple(_ARGUMENTS))

    def generate(context, builder, sig, args):
        from llvmlite import ir

        pointer = ir.DoubleType().as_pointer()
        whole = ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(32), [whole] * 4 + [pointer] * 6)
        address = builder.inttoptr(args[0], kind.as_pointer())
        pointers = [builder.extract_value(args[5], k) for k in range(6)]
        return builder.call(address, [*args[1:5], *pointers])

    return signature, generate


@numba.njit(error_model="numpy")
def _evaluate(function, z, out):
    for i in range(out.size):
        out[i] = 0.0
    call_tabulate(function, out.ctypes.data, z.ctypes.data)


@numba.njit(error_model="numpy")
def _copy(values, to):
    # an assignment of slices would compile messages about shapes, which takes seconds
    for i in range(values.shape[0]):
        to[i] = values[i]


@numba.njit(error_model="numpy")
def _solve(A, b):
    """Solve A X = B in place by elimination with pivots; returns whether A is regular."""
    n, m = b.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if not abs(A[pivot, k]) > 0.0:
            return False
        if pivot != k:
            for j in range(n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            for j in range(m):
                b[k, j], b[pivot, j] = b[pivot, j], b[k, j]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            for j in range(k, n):
                A[i, j] -= factor * A[k, j]
            for j in range(m):
                b[i, j] -= factor * b[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(m):
            for i in range(k + 1, n):
                b[k, j] -= A[k, i] * b[i, j]
            b[k, j] /= A[k, k]
    return True


@numba.njit(error_model="numpy")
def _state(energy, full, x, z, y, elastic, plastic):
    """Stress and its Hessian at the strains of x, then yield function and flow at the stress."""
    z[0], z[1], z[2] = x[0], x[1], x[2]
    _evaluate(energy, z, elastic)
    y[0], y[1], y[2], y[3] = elastic[0], elastic[1], elastic[2], x[4]
    _evaluate(full, y, plastic)


@numba.njit(error_model="numpy")
def _residual(x, trial, alpha, offset, a, b, plastic, r):
    """Write the residual of the return, all parts measured as strains.

    r_i = ε_i − ε_i^tr + Δγ n_i, (f − offset)/a, α − α_n − √(2/3) Δγ ‖n‖, Δγ = x₃/b.
    """
    gamma = x[3] / b
    square = 0.0
    for i in range(3):
        n = plastic[5 + i]
        r[i] = x[i] - trial[i] + gamma * n
        square += n * n
    r[3] = (plastic[0] - offset) / a
    r[4] = x[4] - alpha - _ROOT * gamma * math.sqrt(square)


@numba.njit(error_model="numpy")
def _jacobian(x, a, b, elastic, plastic, J):
    """Derivatives of the residual by strains, length of the flow, and α."""
    gamma = x[3] / b
    size = math.sqrt(plastic[5] ** 2 + plastic[6] ** 2 + plastic[7] ** 2)
    for i in range(5):
        J[3, i] = J[4, i] = 0.0
    for j in range(3):
        for i in range(3):
            turn = 0.0
            for k in range(3):
                turn += plastic[8 + 4 * i + k] * elastic[3 + 3 * k + j]
            J[i, j] = gamma * turn + (1.0 if i == j else 0.0)
            J[3, j] += plastic[1 + i] * elastic[3 + 3 * i + j] / a
            J[4, j] -= _ROOT * gamma * plastic[5 + i] / size * turn
    bend = 0.0
    for i in range(3):
        J[i, 3] = plastic[5 + i] / b
        J[i, 4] = gamma * plastic[11 + 4 * i]
        bend += plastic[5 + i] * plastic[11 + 4 * i] / size
    J[3, 4] = plastic[4] / a
    J[4, 3] = -_ROOT * size / b
    J[4, 4] = 1.0 - _ROOT * gamma * bend


@numba.njit(error_model="numpy")
def _equalise(trial, strain, stress):
    """Make stresses equal to the last bit where trial strains are equal."""
    for i in range(3):
        for j in range(i):
            if trial[i] == trial[j]:
                strain[i] = strain[j]
                stress[i] = stress[j]


@numba.njit(error_model="numpy")
def _correction(J, r, work, step):
    """Write J⁻¹ r; returns its largest component, which does not depend on the scaling of r."""
    for i in range(5):
        step[i, 0] = r[i]
        for j in range(5):
            work[i, j] = J[i, j]
    if not _solve(work, step):
        return math.inf
    worst = 0.0
    for i in range(5):
        if not math.isfinite(step[i, 0]):
            return math.inf
        worst = max(worst, abs(step[i, 0]))
    return worst


@numba.njit(error_model="numpy")
def _newton(
    energy, full, x, trial, alpha, offset, a, b, size, z, y, elastic, plastic, r, J, work, step,
    next_step, new,
):  # fmt: skip
    """Newton's method from x; changes x and returns whether it converged.

    A step is shortened until the next step, with the same Jacobian, is shorter. This is the
    natural monotonicity test (Deuflhard, Newton Methods for Nonlinear Problems, 2011,
    section 3.3). Sizes of residuals would mislead where stiffness grows with strain.
    """
    _state(energy, full, x, z, y, elastic, plastic)
    _residual(x, trial, alpha, offset, a, b, plastic, r)
    # an exponentially growing stress decreases by a factor e per iteration
    for _ in range(200):
        _jacobian(x, a, b, elastic, plastic, J)
        length = _correction(J, r, work, step)
        if length <= _TIGHT * size:
            return True
        if length == math.inf:
            return False
        share = 1.0
        while share > 1e-12:
            for i in range(5):
                new[i] = x[i] - share * step[i, 0]
            _state(energy, full, new, z, y, elastic, plastic)
            _residual(new, trial, alpha, offset, a, b, plastic, r)
            if _correction(J, r, work, next_step) <= (1.0 - 0.25 * share) * length:
                break
            if length <= _LOOSE * size:
                # rounding: further iterations gain nothing
                _state(energy, full, x, z, y, elastic, plastic)
                return True
            share *= 0.5
        else:
            return False
        _copy(new, x)
    return False


@numba.njit(error_model="numpy")
def _elastic_trial(energy, value, strain, old, new, stress, tangent, z, y, elastic):
    """Stress and tangent without plastic flow.

    Returns 0, 1 if a number is not finite, or -1 if the stress is outside the yield surface.
    """
    for i in range(3):
        z[i] = strain[i]
    z[3] = 0.0
    _evaluate(energy, z, elastic)
    total = 0.0
    for i in range(12):
        total += elastic[i]
    if not math.isfinite(total):
        return 1
    if value != 0:
        f = np.empty(1)
        y[0], y[1], y[2], y[3] = elastic[0], elastic[1], elastic[2], old[0]
        new[0] = old[0]
        _evaluate(value, y, f)
        if not math.isfinite(f[0]):
            return 1
        if f[0] > 0.0:
            return -1
    for i in range(3):
        stress[i] = elastic[i]
    for i in range(9):
        tangent[i] = elastic[3 + i]
    _equalise(strain, strain, stress)
    return 0


@numba.njit(error_model="numpy")
def _scales(elastic, plastic):
    """Scales of the residual: the slope of f by strain, and the length of the flow's direction."""
    a = b = 0.0
    for j in range(3):
        slope = 0.0
        for i in range(3):
            slope += plastic[1 + i] * elastic[3 + 3 * i + j]
        a += slope * slope
        b += plastic[5 + j] ** 2
    return math.sqrt(a), math.sqrt(b)


@numba.njit(error_model="numpy")
def _plastic_tangent(elastic, J, tangent):
    """Write the tangent from the Jacobian; returns whether the Jacobian is regular."""
    inverse = np.zeros((5, 3))
    for i in range(3):
        inverse[i, i] = 1.0
    if not _solve(J, inverse):
        return False
    for i in range(3):
        for j in range(3):
            tangent[3 * i + j] = 0.0
            for k in range(3):
                tangent[3 * i + j] += elastic[3 + 3 * i + k] * inverse[k, j]
    return True


def _map_return(energy, value, full, count, parameters, strain, old, new, stress, tangent):
    """The kernel of a law, with the addresses of its functions in front; see `return_kernel`."""
    elastic = np.empty(12)
    z, y = np.empty(4 + count), np.empty(4 + count)
    for k in range(count):
        z[4 + k] = y[4 + k] = parameters[k]
    status = _elastic_trial(energy, value, strain, old, new, stress, tangent, z, y, elastic)
    if status >= 0:
        return status

    plastic, r, x = np.empty(20), np.empty(5), np.empty(5)
    J, work = np.empty((5, 5)), np.empty((5, 5))
    step, next_step = np.empty((5, 1)), np.empty((5, 1))
    trial, move = np.empty(3), np.empty(5)
    size = 0.0
    for i in range(3):
        trial[i] = x[i] = strain[i]
        size = max(size, abs(trial[i]))
    x[3], x[4] = 0.0, old[0]
    _state(energy, full, x, z, y, elastic, plastic)
    a, b = _scales(elastic, plastic)
    if not (0.0 < a < math.inf and 0.0 < b < math.inf):
        return 2
    # Newton's method may fail far from the solution: f is then brought to zero in stages
    first, done, part = plastic[0], 0.0, 1.0
    kept = x.copy()
    while done < 1.0:
        offset = first * (1.0 - min(done + part, 1.0))
        if _newton(
            energy, full, x, trial, old[0], offset, a, b, size, z, y, elastic, plastic, r, J,
            work, step, next_step, move,
        ):  # fmt: skip
            done = min(done + part, 1.0)
            _copy(x, kept)
            part *= 2.0
        else:
            _copy(kept, x)
            part *= 0.25
            if part < 1e-6:
                return 2
    # a negative multiplier is no return, except by rounding for a state on the surface
    if not x[3] >= -_LOOSE * size:
        return 2
    new[0] = max(x[4], old[0])
    _jacobian(x, a, b, elastic, plastic, J)
    for i in range(3):
        strain[i] = x[i]
        stress[i] = elastic[i]
    _equalise(trial, strain, stress)
    return 0 if _plastic_tangent(elastic, J, tangent) else 2


@functools.cache
def _mapping_kernel() -> Any:
    """The compiled mapping; compiled on demand, because most problems do not use it."""
    return numba.cfunc(_MAPPING_SIGNATURE, cache=True, error_model="numpy")(_map_return)


def return_kernel(energy: int, value: int, full: int, count: int) -> Any:
    """A law's kernel for functions at given addresses.

    All functions take the same numbers: three principal values, α, and the parameters.

    Args:
        energy: Function of elastic strains: writes the stresses (3) and their derivatives (9).
        value: Function of stresses: writes f. The address 0 means a law that never yields.
        full: Function of stresses: writes f, its derivatives by stresses and α (4), the flow's
            direction n (3), and the derivatives of n by stresses and α, row by row (12).
        count: Number of parameters.
    """
    mapping = _mapping_kernel().address

    # addresses are valid in this process only, and so is code compiled with them
    @numba.cfunc(KERNEL_SIGNATURE)
    def kernel(parameters, strain, old, new, stress, tangent):
        return _call_mapping(
            mapping, energy, value, full, count, parameters, strain, old, new, stress, tangent
        )

    return kernel


@numba.njit(cache=True, error_model="numpy")
def _values(function, z, out):
    for p in range(z.shape[0]):
        out[p] = 0.0
        call_tabulate(function, out.ctypes.data + 8 * p, z.ctypes.data + 8 * p * z.shape[1])


def yield_values(function: int, z: Array) -> Array:
    """The yield function at an address, for rows of its inputs, shape (n, inputs)."""
    out = np.empty(len(z))
    _values(function, np.ascontiguousarray(z), out)
    return out
