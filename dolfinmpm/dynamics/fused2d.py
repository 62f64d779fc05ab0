"""The fused loop of explicit steps in two dimensions: grid → points → grid in one pass.

A pass takes what the nodes have to the points, updates them and scatters what they carry to the
nodes again, each point once, so that its data are in the cache. Which parts of this a pass has
is fixed when it is compiled, see `Pass`; the sums are written out by components, which keeps them
in registers.
"""

from __future__ import annotations

import functools
import math

import numba
import numpy as np

from dolfinmpm.basis.bspline import uniform_weights
from dolfinmpm.basis.gimp import uniform_domain_weights
from dolfinmpm.basis.lattice import SNAP, line_weights, overlapped
from dolfinmpm.dynamics.passes import FAST, LAW, NEO, SMALL, Pass
from dolfinmpm.materials.base import call_law

__all__ = ["kernel"]


@functools.cache
def weights(degree: int, averaged: bool):
    """`line_weights` in the middle of a uniform lattice, as numbers.

    `near(x, half, start, per_length, last) -> (known, first cell, four values, four slopes)`.
    Where it does not know, loops ask `line_weights` itself.
    """
    if not averaged:

        @numba.njit(cache=True, error_model="numpy", inline="always")
        def near(x, half, start, per_length, last):
            at = (x - start) * per_length
            i = int(at)
            known = i >= degree - 1 and i <= last - degree + 1 and at >= 0.0
            a, b, c, e, da, db, dc, de = uniform_weights(degree, at - i, per_length)
            return known, i, a, b, c, e, da, db, dc, de

    elif degree == 1:

        @numba.njit(cache=True, error_model="numpy", inline="always")
        def near(x, half, start, per_length, last):
            at, reach = (x - start) * per_length, half * per_length
            left, right = at - reach, at + reach
            i = int(left)
            known = half > 0.0 and left > 0.0 and right < last and right < i + 2
            # an overlap that rounding makes does not count
            if i + 1 - left < SNAP:
                i += 1
                left = float(i)
            if right > i + 1 and right - i - 1 < SNAP:
                right = float(i + 1)
            a, b, c, da, db, dc = uniform_domain_weights(left - i, right - i, per_length)
            return known, i, a, b, c, 0.0, da, db, dc, 0.0

    else:

        @numba.njit(cache=True, error_model="numpy", inline="always")
        def near(x, half, start, per_length, last):
            return False, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0

    return near


@functools.cache
def kernel(degree: int, averaged: bool, kind: int, affine: int, parts: Pass, general: bool):
    """The loop for a basis, a measure of strain, an affine part and the parts of a pass.

    `kernel(grid, nodes, out, points, law, dt, share, rows, skipped, done) -> (first bad point or -1,
    points skipped, points not scattered)`; see `Fused` in `dolfinmpm.dynamics.fused` for what
    the tuples hold. A general one takes the points of `rows`, wherever they are; the others take
    all points, and skip those that `weights` does not know.
    """
    velocity, strain, move, same, new, record = parts
    APIC, TPIC = affine == 1, affine == 2
    # a pass that also gives the velocities strains by these
    column = 0 if velocity and strain else 4

    near, usual = weights(degree, averaged), degree + 1 + int(averaged)

    @numba.njit(cache=True, error_model="numpy", fastmath=FAST)
    def run(grid, nodes, out, points, law, dt, share, rows, skipped, done):
        line0, line1, node0, node1, uniform, origin, shape = grid
        x, half, half0, v, C, F, V, V0, m, state, internal, stress, body, acceleration = points
        addresses, numbers, stride, which = law
        S0, S1 = np.empty(64), np.empty(64)
        d0, d1 = np.empty(64), np.empty(64)
        part, slope = np.empty(4), np.empty(4)
        e, tau, tangent = np.empty(3), np.empty(3), np.empty(9)
        scratch = np.empty(max(internal.shape[1], 1))
        work = 0.0
        row = shape[1]
        last0, last1 = line0.size - 2, line1.size - 2
        s0 = (last0 + 1) / (line0[last0 + 1] - line0[0])
        s1 = (last1 + 1) / (line1[last1 + 1] - line1[0])
        start0, start1 = line0[0], line1[0]
        end0, end1 = line0[last0 + 1], line1[last1 + 1]
        e_at, tau_at, tangent_at = e.ctypes.data, tau.ctypes.data, tangent.ctypes.data
        scratch_at, inner_at = scratch.ctypes.data, internal.ctypes.data
        numbers_at = numbers.ctypes.data
        single, one_body = which.shape[0] == 1, body.shape[0] == 1
        t00 = t01 = t11 = 0.0
        left = behind = 0
        number_of_points = rows.size if general else x.shape[0]
        for index in range(number_of_points):
            p = rows[index] if general else index
            x0, x1 = x[p, 0], x[p, 1]
            l0 = l1 = 0.0
            if averaged:
                l0, l1 = half[p, 0], half[p, 1]
            mp, vp = m[p], V0[p]
            if velocity or strain or move or same:
                n0 = n1 = usual
                if general:
                    i0, n0 = overlapped(line0, uniform, x0, l0)
                    i1, n1 = overlapped(line1, uniform, x1, l1)
                    line_weights(line0, uniform, degree, i0, n0, x0, l0, S0, d0, part, slope)
                    line_weights(line1, uniform, degree, i1, n1, x1, l1, S1, d1, part, slope)
                    n0, n1 = n0 + degree, n1 + degree
                else:
                    known0, i0, S0[0], S0[1], S0[2], S0[3], d0[0], d0[1], d0[2], d0[3] = near(
                        x0, l0, start0, s0, last0
                    )
                    known1, i1, S1[0], S1[1], S1[2], S1[3], d1[0], d1[1], d1[2], d1[3] = near(
                        x1, l1, start1, s1, last1
                    )
                    if not (known0 and known1):
                        # one of the few at an edge or with a large domain: see `general`
                        skipped[0, left] = p
                        left += 1
                        continue
                base = (i0 - origin[0]) * row + i1 - origin[1]
                v0 = v1 = w0 = w1 = b00 = b01 = b10 = b11 = D0 = D1 = 0.0
                h00 = h01 = h10 = h11 = 0.0
                for a in range(n0):
                    at = base + a * row
                    Sa, da = S0[a], d0[a]
                    for b in range(n1):
                        k = at + b
                        N = Sa * S1[b]
                        if move or velocity:
                            y0, y1 = nodes[k, 0], nodes[k, 1]
                            v0 += N * y0
                            v1 += N * y1
                            if APIC and velocity:
                                r0, r1 = node0[i0 + a] - x0, node1[i1 + b] - x1
                                b00 += N * y0 * r0
                                b01 += N * y0 * r1
                                b10 += N * y1 * r0
                                b11 += N * y1 * r1
                                D0 += N * r0 * r0
                                D1 += N * r1 * r1
                            if TPIC and velocity:
                                b00 += da * S1[b] * y0
                                b01 += Sa * d1[b] * y0
                                b10 += da * S1[b] * y1
                                b11 += Sa * d1[b] * y1
                        if velocity:
                            w0 += N * nodes[k, 2]
                            w1 += N * nodes[k, 3]
                        if strain:
                            y0, y1 = nodes[k, column], nodes[k, column + 1]
                            g0, g1 = da * S1[b], Sa * d1[b]
                            h00 += g0 * y0
                            h01 += g1 * y0
                            h10 += g0 * y1
                            h11 += g1 * y1
                if velocity:
                    if affine:
                        v[p, 0], v[p, 1] = v0, v1
                        if APIC:
                            q0 = 1.0 / D0 if D0 > 1e-18 else 0.0
                            q1 = 1.0 / D1 if D1 > 1e-18 else 0.0
                            b00, b10, b01, b11 = b00 * q0, b10 * q0, b01 * q1, b11 * q1
                        C[p, 0, 0], C[p, 0, 1], C[p, 1, 0], C[p, 1, 1] = b00, b01, b10, b11
                    else:
                        v[p, 0] = share * (v[p, 0] + w0) + (1.0 - share) * v0
                        v[p, 1] = share * (v[p, 1] + w1) + (1.0 - share) * v1
                    if record:
                        acceleration[p, 0], acceleration[p, 1] = w0 / dt, w1 / dt
                if strain:
                    a00, a01, a10, a11 = 1.0 + dt * h00, dt * h01, dt * h10, 1.0 + dt * h11
                    det = a00 * a11 - a01 * a10
                    if not det > 0.0:
                        return p, left, behind
                    f00, f01, f10, f11 = F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1]
                    J_old = f00 * f11 - f01 * f10
                    F[p, 0, 0], F[p, 0, 1] = a00 * f00 + a01 * f10, a00 * f01 + a01 * f11
                    F[p, 1, 0], F[p, 1, 1] = a10 * f00 + a11 * f10, a10 * f01 + a11 * f11
                    f00, f01, f10, f11 = F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1]
                    J = f00 * f11 - f01 * f10
                    if not J > 0.0:
                        return p, left, behind
                    V[p] = J * vp
                    L = 0 if single else which[p]
                    if kind == NEO:
                        lmbda, mu = numbers[L, 0], numbers[L, 1]
                        if stride:
                            lmbda, mu = numbers[p, 0], numbers[p, 1]
                        spread = lmbda * math.log(J)
                        b00, b11 = f00 * f00 + f01 * f01, f10 * f10 + f11 * f11
                        t00, t11 = spread + mu * (b00 - 1.0), spread + mu * (b11 - 1.0)
                        t01 = mu * (f00 * f10 + f01 * f11)
                        t22 = spread
                    else:
                        if kind == LAW:
                            y00, y11, y01 = state[p, 0], state[p, 1], state[p, 3]
                            w00, w01 = a00 * y00 + a01 * y01, a00 * y01 + a01 * y11
                            w10, w11 = a10 * y00 + a11 * y01, a10 * y01 + a11 * y11
                            y00, y11 = w00 * a00 + w01 * a01, w10 * a10 + w11 * a11
                            y01 = w00 * a10 + w01 * a11
                        else:
                            y00 = state[p, 0] + dt * h00
                            y11 = state[p, 1] + dt * h11
                            y01 = state[p, 3] + 0.5 * dt * (h01 + h10)
                        # eigenvalues from what does not cancel, axes by the half angle
                        gap, mid = 0.5 * (y00 - y11), 0.5 * (y00 + y11)
                        r = math.sqrt(gap * gap + y01 * y01)
                        cosine, sine = 1.0, 0.0
                        if r > 0.0:
                            cosine, sine = gap / r, y01 / r
                        high = mid + r
                        low = mid - r
                        if kind == LAW:
                            low = (y00 * y11 - y01 * y01) / high
                            if not low > 0.0:
                                return p, left, behind
                            e[0], e[1] = 0.5 * math.log(high), 0.5 * math.log(low)
                            e[2] = 0.5 * math.log(state[p, 2])
                        else:
                            e[0], e[1], e[2] = high, low, state[p, 2]
                        e0, e1, e2 = e[0], e[1], e[2]
                        offset = (p if stride else L) * numbers.shape[1] * 8
                        inner = inner_at + 8 * p * internal.shape[1]
                        status = call_law(
                            addresses[L], numbers_at + offset, e_at, inner, scratch_at, tau_at,
                            tangent_at,
                        )  # fmt: skip
                        if status != 0:
                            return p, left, behind
                        for k in range(internal.shape[1]):
                            internal[p, k] = scratch[k]
                        if e[0] != e0 or e[1] != e1 or e[2] != e2:
                            high, low, state[p, 2] = e[0], e[1], e[2]
                            if kind == LAW:
                                high, low = math.exp(2.0 * e[0]), math.exp(2.0 * e[1])
                                state[p, 2] = math.exp(2.0 * e[2])
                            mid, gap = 0.5 * (high + low), 0.5 * (high - low)
                            y00, y11, y01 = mid + gap * cosine, mid - gap * cosine, gap * sine
                        state[p, 0], state[p, 1], state[p, 3] = y00, y11, y01
                        mid, gap = 0.5 * (tau[0] + tau[1]), 0.5 * (tau[0] - tau[1])
                        t00, t11, t01 = mid + gap * cosine, mid - gap * cosine, gap * sine
                        t22 = tau[2]
                        if kind == SMALL:
                            J = 1.0
                    q = J_old if kind != SMALL else 1.0
                    g00, g11, g01 = stress[p, 0, 0], stress[p, 1, 1], stress[p, 0, 1]
                    if kind != SMALL:
                        # H − H²/2: the rate at the middle of the step, to second order
                        z00, z11 = h00 * h00 + h01 * h10, h11 * h11 + h01 * h10
                        z01, z10 = h01 * (h00 + h11), h10 * (h00 + h11)
                        h00, h11 = h00 - 0.5 * dt * z00, h11 - 0.5 * dt * z11
                        h01, h10 = h01 - 0.5 * dt * z01, h10 - 0.5 * dt * z10
                    work += 0.5 * dt * vp * (
                        (q * g00 + t00) * h00 + (q * g11 + t11) * h11
                        + (q * g01 + t01) * (h01 + h10)
                    )  # fmt: skip
                    q = 1.0 / J
                    stress[p, 0, 0], stress[p, 1, 1], stress[p, 2, 2] = q * t00, q * t11, q * t22
                    stress[p, 0, 1] = stress[p, 1, 0] = q * t01
                if same:
                    p0, p1 = mp * v[p, 0], mp * v[p, 1]
                    z00, z01, z11 = vp * t00, vp * t01, vp * t11
                    at_body = 0 if one_body else p
                    g0, g1 = body[at_body, 0], body[at_body, 1]
                    if one_body:
                        g0, g1 = mp * g0, mp * g1
                    for a in range(n0):
                        at = base + a * row
                        Sa, da = S0[a], d0[a]
                        for b in range(n1):
                            k = at + b
                            N = Sa * S1[b]
                            if same == 1:
                                y0, y1 = p0, p1
                                if affine:
                                    r0, r1 = node0[i0 + a] - x0, node1[i1 + b] - x1
                                    y0 += mp * (C[p, 0, 0] * r0 + C[p, 0, 1] * r1)
                                    y1 += mp * (C[p, 1, 0] * r0 + C[p, 1, 1] * r1)
                                out[k, 5] += N * y0
                                out[k, 6] += N * y1
                            else:
                                k0, k1 = da * S1[b], Sa * d1[b]
                                out[k, 3] += N * g0 - k0 * z00 - k1 * z01
                                out[k, 4] += N * g1 - k0 * z01 - k1 * z11
                if move:
                    x0, x1 = x0 + dt * v0, x1 + dt * v1
                    x[p, 0], x[p, 1] = x0, x1
                    if not (start0 <= x0 <= end0 and start1 <= x1 <= end1):
                        return p, left, behind
                if averaged and move:
                    # l = l0 diag(U), U = (FᵀF + J I)/√(tr FᵀF + 2 J)
                    f00, f01, f10, f11 = F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1]
                    J = f00 * f11 - f01 * f10
                    k00, k11 = f00 * f00 + f10 * f10, f01 * f01 + f11 * f11
                    q = 1.0 / math.sqrt(k00 + k11 + 2.0 * J)
                    half[p, 0], half[p, 1] = (
                        half0[p, 0] * (k00 + J) * q,
                        half0[p, 1] * (k11 + J) * q,
                    )
                    l0, l1 = half[p, 0], half[p, 1]
            if new:
                n0 = n1 = usual
                if general:
                    i0, n0 = overlapped(line0, uniform, x0, l0)
                    i1, n1 = overlapped(line1, uniform, x1, l1)
                    line_weights(line0, uniform, degree, i0, n0, x0, l0, S0, d0, part, slope)
                    line_weights(line1, uniform, degree, i1, n1, x1, l1, S1, d1, part, slope)
                    n0, n1 = n0 + degree, n1 + degree
                else:
                    known0, i0, S0[0], S0[1], S0[2], S0[3], d0[0], d0[1], d0[2], d0[3] = near(
                        x0, l0, start0, s0, last0
                    )
                    known1, i1, S1[0], S1[1], S1[2], S1[3], d1[0], d1[1], d1[2], d1[3] = near(
                        x1, l1, start1, s1, last1
                    )
                    if not (known0 and known1):
                        skipped[1, behind] = p
                        behind += 1
                        continue
                i0w, i1w = i0 - origin[0], i1 - origin[1]
                if i0w < 0 or i1w < 0 or i0w + n0 > shape[0] or i1w + n1 > shape[1]:
                    return p, left, behind
                base = i0w * row + i1w
                p0, p1 = mp * v[p, 0], mp * v[p, 1]
                if new == 2:
                    if not strain:
                        q = vp if kind == SMALL else V[p]
                        t00, t01, t11 = (
                            q * stress[p, 0, 0],
                            q * stress[p, 0, 1],
                            q * stress[p, 1, 1],
                        )
                    else:
                        t00, t01, t11 = vp * t00, vp * t01, vp * t11
                    at_body = 0 if one_body else p
                    g0, g1 = body[at_body, 0], body[at_body, 1]
                    if one_body:
                        g0, g1 = mp * g0, mp * g1
                for a in range(n0):
                    at = base + a * row
                    Sa, da = S0[a], d0[a]
                    for b in range(n1):
                        k = at + b
                        N = Sa * S1[b]
                        y0, y1 = p0, p1
                        if affine:
                            r0, r1 = node0[i0 + a] - x0, node1[i1 + b] - x1
                            y0 += mp * (C[p, 0, 0] * r0 + C[p, 0, 1] * r1)
                            y1 += mp * (C[p, 1, 0] * r0 + C[p, 1, 1] * r1)
                        out[k, 0] += N * mp
                        out[k, 1] += N * y0
                        out[k, 2] += N * y1
                        if new == 2:
                            k0, k1 = da * S1[b], Sa * d1[b]
                            out[k, 3] += N * g0 - k0 * t00 - k1 * t01
                            out[k, 4] += N * g1 - k0 * t01 - k1 * t11
        done[0] += work
        return -1, left, behind

    return run
