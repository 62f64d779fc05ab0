"""The compiled kernel of `HardinDrnevich`: hyperbolic shear with Masing's rule, under a strength.

Tensors are rows of six numbers xx, yy, zz, xy, xz, yz, with tensor shear strains.
"""

from __future__ import annotations

import functools
import math

import numba
import numpy as np
from numba import types

from dolfinmpm.materials.umatshim import OFFSETS

__all__ = ["PROPERTIES", "cyclic_address"]

PROPERTIES = (
    "modulus", "bulk_share", "reference_strain", "fall", "exponent", "reference_pressure",
    "attraction", "strength", "slope",
)  # fmt: skip
_STRESS, _STRAIN, _TANGENT = OFFSETS["stress"], OFFSETS["dstran"], OFFSETS["ddsdde"]
_ROTATION, _STATE = OFFSETS["drot"], OFFSETS["statev"]
_ROWS, _COLUMNS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
_CLOSED = 1e-9  # a loop is closed by this share of its width before its end
_LEAST = 1e-2  # least pressure that the stiffness follows, by the reference pressure
_DOUBLES = types.CPointer(types.float64)
_SIGNATURE = types.int32(
    _DOUBLES, _DOUBLES, types.CPointer(types.int64), types.CPointer(types.uint8)
)


@numba.njit(cache=True, error_model="numpy")
def _dot(a, b):
    total = 0.0
    for i in range(6):
        total += (1.0 if i < 3 else 2.0) * a[i] * b[i]
    return total


@numba.njit(cache=True, error_model="numpy")
def _turn(R, a):
    """Rotate a tensor in place: R a Rᵀ."""
    full, half = np.empty((3, 3)), np.empty((3, 3))
    for k in range(6):
        full[_ROWS[k], _COLUMNS[k]] = full[_COLUMNS[k], _ROWS[k]] = a[k]
    for i in range(3):
        for j in range(3):
            half[i, j] = R[i, 0] * full[0, j] + R[i, 1] * full[1, j] + R[i, 2] * full[2, j]
    for k in range(6):
        i, j = _ROWS[k], _COLUMNS[k]
        a[k] = half[i, 0] * R[j, 0] + half[i, 1] * R[j, 1] + half[i, 2] * R[j, 2]


@numba.njit(cache=True, error_model="numpy")
def _add_branch(at, centre, G, bend, sign, s, by_end, C):
    """Add the stress 2 G d/(1 + bend |d|) of d = at − centre to s, and its derivative to C.

    Args:
        by_end: Derivative of `at` by the strain at the end of the step, shape (6, 6).
    """
    d = np.empty(6)
    for i in range(6):
        d[i] = at[i] - centre[i]
    size = math.sqrt(_dot(d, d))
    secant = 2.0 * G / (1.0 + bend * size)
    fall = 0.0
    if size > 0.0:
        fall = secant * bend / ((1.0 + bend * size) * size)
    for i in range(6):
        s[i] += sign * secant * d[i]
    for j in range(6):
        along = 0.0
        for i in range(6):
            along += (1.0 if i < 3 else 2.0) * d[i] * by_end[i, j]
        for i in range(6):
            C[i, j] += sign * (secant * by_end[i, j] - fall * d[i] * along)


@numba.njit(cache=True, error_model="numpy")
def _reach(first, move, centre, span):
    """Share of the way at which the distance from the centre is the span, at most 1."""
    d = np.empty(6)
    for i in range(6):
        d[i] = first[i] - centre[i]
    a, b = _dot(move, move), _dot(d, move)
    discriminant_root = math.sqrt(max(b * b - a * (_dot(d, d) - span * span), 0.0))
    return min((discriminant_root - b) / a, 1.0)


@numba.njit(cache=True, error_model="numpy")
def _follow(memory, level, move, G, bend, s, C):
    """Go along the strain increment, and return the level at its end.

    Args:
        memory: The strain at the start, then reversals, shape (1 + levels, 6). Reversal 0 is the
            strain 0, and is not among them. Strains get the value at the end.
        level: Number of reversals that are remembered.
        move: The increment, not zero.
        bend: Fall of the secant stiffness per |d| on the first loading; half of it on others.
        s: Stress deviator (Pa); the change is added.
        C: Written: derivative of s by the increment.
    """
    levels = memory.shape[0] - 1
    first, end, now, centre = memory[0].copy(), np.empty(6), np.empty(6), np.zeros(6)
    way, whole, by_end = np.empty(6), np.eye(6), np.empty((6, 6))
    nothing, unused = np.zeros((6, 6)), np.zeros((6, 6))
    towards = 0.0
    for i in range(6):
        end[i] = first[i] + move[i]
        now[i] = first[i]
        C[i, :] = 0.0
        if level > 0:
            centre[i] = memory[level, i]
        towards += (1.0 if i < 3 else 2.0) * move[i] * (first[i] - centre[i])
    # without room for a reversal the way goes back along the branch, and has no loop
    back = towards < 0.0 and level == levels
    if towards < 0.0 and not back:
        level += 1
        memory[level] = first
    share = 0.0
    for _ in range(levels + 2):
        span = math.inf
        for i in range(6):
            centre[i] = memory[level, i] if level > 0 else 0.0
            way[i] = centre[i] - (memory[level - 1, i] if level > 1 else 0.0)
        if level > 0:
            span = math.sqrt(_dot(way, way)) * (2.0 if level == 1 else 1.0)
        own = bend if level == 0 else 0.5 * bend
        for i in range(6):
            way[i] = end[i] - centre[i]
        far = math.sqrt(_dot(way, way))
        nearest = -towards / _dot(move, move) if back else 1.0
        if far < span * (1.0 - _CLOSED) and nearest >= 1.0:
            _add_branch(now, centre, G, own, -1.0, s, nothing, unused)
            _add_branch(end, centre, G, own, 1.0, s, whole, C)
            break
        # the loop closes within the step: the branch that it has interrupted goes on
        cut = nearest if back else max(_reach(first, move, centre, span), share)
        _add_branch(now, centre, G, own, -1.0, s, nothing, unused)
        for i in range(6):
            now[i] = first[i] + cut * move[i]
            way[i] = now[i] - centre[i]
        reach, square = _dot(way, move), _dot(move, move)
        for j in range(6):
            slope = 0.0  # derivative of `cut`
            if back:
                slope = -(way[j] + cut * move[j]) / square
            elif share < cut < 1.0:
                slope = -cut * way[j] / reach
            for i in range(6):
                by_end[i, j] = (1.0 if j < 3 else 2.0) * slope * move[i]
            by_end[j, j] += cut
        _add_branch(now, centre, G, own, 1.0, s, by_end, C)
        level -= 1 if level == 1 or back else 2
        back = False
        own = bend if level == 0 else 0.5 * bend
        for i in range(6):
            centre[i] = memory[level, i] if level > 0 else 0.0
        # the stress is not added twice: the loop subtracts it at `now`
        _add_branch(now, centre, G, own, -1.0, end.copy(), by_end, C)
        share = cut
    for i in range(6):
        memory[0, i] = end[i]
    return level


@numba.njit(cache=True, error_model="numpy")
def _cap(memory, level, G, bend, s, radius, C):
    """Return to the strength: shorten s to the radius, and take the strain of the rest away."""
    size = math.sqrt(_dot(s, s))
    part = radius / size
    n, wanted, centre = np.empty(6), np.empty(6), np.zeros(6)
    nothing = np.zeros((6, 6))
    for i in range(6):
        n[i] = s[i] / size
        wanted[i] = (part - 1.0) * s[i]
        if level > 0:
            centre[i] = memory[level, i]
        s[i] *= part
    for j in range(6):
        along = 0.0
        for i in range(6):
            along += (1.0 if i < 3 else 2.0) * n[i] * C[i, j]
        for i in range(6):
            C[i, j] = part * (C[i, j] - n[i] * along)
    own = bend if level == 0 else 0.5 * bend
    _add_branch(memory[0], centre, G, own, 1.0, wanted, nothing, nothing)
    size = math.sqrt(_dot(wanted, wanted))
    left = 2.0 * G - own * size
    if left > 0.0:
        for i in range(6):
            memory[0, i] = centre[i] + wanted[i] / left
    return n


def _cyclic(work, properties, numbers, name):
    """The kernel; its arguments are those of a UMAT, see `dolfinmpm.materials.umatcall`."""
    m, levels = numbers[2], (numbers[3] - 7) // 6
    reference, bend, exponent = properties[0], properties[3] / properties[2], properties[4]
    bend *= math.sqrt(2.0)
    R, s, move = np.empty((3, 3)), np.zeros(6), np.zeros(6)
    memory, C = np.zeros((1 + levels, 6)), np.zeros((6, 6))
    mean = (work[_STRESS] + work[_STRESS + 1] + work[_STRESS + 2]) / 3.0
    volume = work[_STRAIN] + work[_STRAIN + 1] + work[_STRAIN + 2]
    for k in range(m):
        s[k] = work[_STRESS + k] - (mean if k < 3 else 0.0)
        move[k] = work[_STRAIN + k] - volume / 3.0 if k < 3 else 0.5 * work[_STRAIN + k]
    level = int(work[_STATE + 6])
    turned = False
    for i in range(3):
        for j in range(3):
            R[i, j] = work[_ROTATION + i + 3 * j]
            turned = turned or R[i, j] != (1.0 if i == j else 0.0)
    for k in range(1 + level):
        start = _STATE + (0 if k == 0 else 1 + 6 * k)
        for i in range(6):
            memory[k, i] = work[start + i]
        if turned:
            _turn(R, memory[k])

    G = reference
    if exponent > 0.0:
        p = max(properties[6] - mean, _LEAST * properties[5])
        G *= (p / (properties[5] + properties[6])) ** exponent
    K = properties[1] * G
    if _dot(move, move) > 0.0:
        level = _follow(memory, level, move, G, bend, s, C)
    else:
        # no direction: the stiffness of a reversal
        for i in range(6):
            C[i, i] = 2.0 * G
    mean += K * volume
    strength, slope = properties[7], properties[8]
    room = strength - slope * mean
    pull = 0.0
    if room < 0.0:
        mean, K, room = strength / slope, 0.0, 0.0
    radius = math.sqrt(2.0) * room
    n = s
    if _dot(s, s) > radius * radius:
        n = _cap(memory, level, G, bend, s, radius, C)
        pull = -math.sqrt(2.0) * slope * K
    for k in range(m):
        work[_STRESS + k] = s[k] + (mean if k < 3 else 0.0)
        trace = (C[k, 0] + C[k, 1] + C[k, 2]) / 3.0
        for j in range(m):
            value = 0.5 * C[k, j]
            if j < 3:
                value = C[k, j] - trace + pull * n[k] + (K if k < 3 else 0.0)
            work[_TANGENT + k + m * j] = value
    work[_STATE + 6] = float(level)
    for k in range(1 + levels):
        start = _STATE + (0 if k == 0 else 1 + 6 * k)
        for i in range(6):
            work[start + i] = memory[k, i] if k <= level else 0.0
    return 0


@functools.cache
def _compiled():
    return numba.cfunc(_SIGNATURE, cache=True, error_model="numpy")(_cyclic)


def cyclic_address() -> int:
    """Address of the compiled kernel."""
    return _compiled().address
