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

from dolfinmpm.basis.lineweights import line_shares, line_weights, overlapped
from dolfinmpm.basis.uniform import middle_count, middle_weights
from dolfinmpm.dynamics.moments import drift, inverse_moments
from dolfinmpm.dynamics.passes import (
    COLUMNS,
    FAST,
    GROWTH,
    JAUMANN,
    LAW,
    MEANS,
    NEO,
    SMALL,
    Pass,
)
from dolfinmpm.dynamics.simdmath import (
    add_at,
    axpy,
    exponential,
    four,
    lanes,
    load,
    logarithm,
    number_at,
    store,
    times,
)
from dolfinmpm.materials.lawkernel import call_law

__all__ = ["kernel"]


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def cell_of(line, first, count, x):
    """Which of the cells that a point's domain overlaps, in one direction, its centre is in."""
    k = 0
    while k < count - 1 and x >= line[first + k + 1]:
        k += 1
    return k


@functools.cache
def kernel(
    degree: int, growth: int, kind: int, affine: int, parts: Pass, general: bool, means: int = 0
):
    """The loop for a basis, a measure of strain, an affine part and the parts of a pass.

    `kernel(grid, nodes, out, points, law, dt, share, record, advance, scatter, rows, skipped,
    done)` returns the first bad point or -1, and the numbers of points skipped and not scattered;
    see `Window`, `PointArrays` and `Laws` for what the tuples hold. A general one takes the points
    of `rows`, wherever they are; the others take all points, and skip what `middle_weights` does
    not know. `record` tells whether what only others read is written: accelerations, volumes,
    stresses. Without `advance` points only scatter where they are, as `new` tells, and without
    `scatter` they do not: the first pass of all and the last one need no loops of their own.
    Growth of domains (0: points have none) and `means` of F-bar are told in
    `dolfinmpm.dynamics.passes`.
    """
    averaged, by_volume, by_stretch = growth > 0, GROWTH["volume"], GROWTH["stretch"]
    velocity, strain, move, same, new = parts
    centres, taken = means in MEANS["centres"], means in (MEANS[True][0], MEANS["centres"][0])
    used = means > 0 and not taken
    APIC, TPIC = affine == 1, affine == 2
    gradient = strain or (TPIC and velocity)
    # changes and velocities are gathered together, or velocities and those of the strain
    column = 0 if velocity else 8 * COLUMNS[2].velocity
    STRIDE, MASS = 8 * COLUMNS[2].width, 8 * COLUMNS[2].mass
    second = 8 * COLUMNS[2].second

    # compiled functions among the closed-over values would keep the loop out of Numba's cache
    usual = middle_count(degree, averaged)

    @numba.njit(cache=True, error_model="numpy", fastmath=FAST)
    def run(
        grid, nodes, out, points, law, dt, share, record, advance, scatter, rows, skipped, done
    ):  # fmt: skip
        line0, line1, node0, node1, uniform, origin, shape, first, last, fine = grid
        x, half, half0, v, C, F, V, V0, m, state, internal, stress, acceleration = points[:13]
        tau_old, e_out, body = points[13:16]
        if means > 0:
            sums, J_bar = points[16:]
            L0, L1 = np.empty(64), np.empty(64)
            sums_at = sums.ctypes.data - 16 * (origin[0] * shape[1] + origin[1])
        addresses, numbers, stride, which = law
        S0, S1 = np.empty(64), np.empty(64)
        d0, d1 = np.empty(64), np.empty(64)
        part, slope, S2 = np.empty(4), np.empty(4), np.empty(64)
        e, tau, tangent = np.empty(3), np.empty(3), np.empty(9)
        scratch = np.empty(max(internal.shape[1], 1))
        work = outer = fastest = latest = projected = 0.0
        row = STRIDE * shape[1]
        last0, last1 = line0.size - 2, line1.size - 2
        s0 = (last0 + 1) / (line0[last0 + 1] - line0[0])
        s1 = (last1 + 1) / (line1[last1 + 1] - line1[0])
        step0, step1 = 1.0 / s0, 1.0 / s1
        start0, start1 = line0[0], line1[0]
        end0, end1 = line0[last0 + 1], line1[last1 + 1]
        low0, low1 = origin[0] + first[0], origin[1] + first[1]
        top0, top1 = origin[0] + last[0], origin[1] + last[1]
        fine0, fine1 = fine[0], fine[1]
        e_at, tau_at, tangent_at = e.ctypes.data, tau.ctypes.data, tangent.ctypes.data
        scratch_at, inner_at = scratch.ctypes.data, internal.ctypes.data
        numbers_at, nodes_at, out_at = numbers.ctypes.data, nodes.ctypes.data, out.ctypes.data
        nodes_at -= origin[0] * row + origin[1] * STRIDE - column
        out_at -= origin[0] * row + origin[1] * STRIDE
        single, alike = which.shape[0] == 1, body.shape[0] == 0
        nothing = four(0.0, 0.0, 0.0, 0.0)
        t00 = t01 = t11 = t22 = g0 = g1 = 0.0
        left = behind = 0
        number_of_points = rows.size if general else x.shape[0]
        for index in range(number_of_points):
            # an index without a sign needs no look at whether it counts from the end
            p = np.uintp(rows[index] if general else index)
            x0, x1 = x[p, 0], x[p, 1]
            l0 = l1 = 0.0
            if averaged:
                l0, l1 = half[p, 0], half[p, 1]
            mp, vp = m[p], V0[p]
            if not alike:
                g0, g1 = body[p, 0], body[p, 1]
            if advance and (velocity or strain or move or same):
                n0 = n1 = usual
                if general:
                    i0, n0 = overlapped(line0, uniform, x0, l0)
                    i1, n1 = overlapped(line1, uniform, x1, l1)
                    line_weights(line0, uniform, degree, i0, n0, x0, l0, S0, d0, part, slope)
                    line_weights(line1, uniform, degree, i1, n1, x1, l1, S1, d1, part, slope)
                    n0, n1 = n0 + degree, n1 + degree
                else:
                    known0, i0 = middle_weights(degree, averaged, x0, l0, start0, s0, last0, S0, d0)
                    known1, i1 = middle_weights(degree, averaged, x1, l1, start1, s1, last1, S1, d1)
                    if not (known0 and known1):
                        # one of the few at an edge or with a large domain: see `general`
                        skipped[0, left] = rows[index]
                        left += 1
                        continue
                base = i0 * row + i1 * STRIDE
                Y = H0 = H1 = B0 = B1 = nothing
                for a in range(n0):
                    at = nodes_at + base + a * row
                    R = Q = K = nothing
                    for b in range(n1):
                        Z = load(at + b * STRIDE)
                        R = axpy(S1[b], Z, R)
                        if gradient:
                            Q = axpy(d1[b], Z, Q)
                        if APIC and velocity:
                            K = axpy(S1[b] * (node1[i1 + b] - x1), Z, K)
                    Y = axpy(S0[a], R, Y)
                    if gradient:
                        H0, H1 = axpy(d0[a], R, H0), axpy(S0[a], Q, H1)
                    if APIC and velocity:
                        B0 = axpy(S0[a] * (node0[i0 + a] - x0), R, B0)
                        B1 = axpy(S0[a], K, B1)
                v0, v1, w0, w1 = lanes(Y)
                if velocity:
                    w0, w1, v0, v1 = v0, v1, w0, w1
                elif strain:
                    # points move by the velocities that strain
                    v0, v1 = w0, w1
                _, _, h00, h10 = lanes(H0)
                _, _, h01, h11 = lanes(H1)
                if centres:
                    k0, k1 = cell_of(line0, i0, n0 - 1, x0), cell_of(line1, i1, n1 - 1, x1)
                    cell = sums_at + 16 * ((i0 + k0) * shape[1] + i1 + k1)
                elif means > 0:
                    if general:
                        line_shares(
                            line0, uniform, degree, i0, n0 - degree, x0, l0, d0, L0, S2, part, slope
                        )
                        line_shares(
                            line1, uniform, degree, i1, n1 - degree, x1, l1, d1, L1, S2, part, slope
                        )
                    else:
                        # slopes of splines are differences of those one degree lower
                        r0 = r1 = 0.0
                        for a in range(usual - 1):
                            r0, r1 = r0 - d0[a] * step0, r1 - d1[a] * step1
                            L0[a], L1[a] = r0, r1
                    cell = sums_at + 16 * (i0 * shape[1] + i1)
                if taken:
                    volume = vp * (F[p, 0, 0] * F[p, 1, 1] - F[p, 0, 1] * F[p, 1, 0])
                    change = dt * (h00 + h11)
                    if kind == LAW:
                        change = (1.0 + dt * h00) * (1.0 + dt * h11) - dt * h01 * dt * h10
                    if centres:
                        add_at(cell, volume)
                        add_at(cell + 8, volume * change)
                        continue
                    for a in range(n0 - 1):
                        for b in range(n1 - 1):
                            at, q = cell + 16 * (a * shape[1] + b), L0[a] * L1[b] * volume
                            add_at(at, q)
                            add_at(at + 8, q * change)
                    continue
                mean = 0.0
                if used and centres:
                    mean = number_at(cell + 8)
                elif used:
                    for a in range(n0 - 1):
                        here = 0.0
                        for b in range(n1 - 1):
                            here += L1[b] * number_at(cell + 16 * (a * shape[1] + b) + 8)
                        mean += L0[a] * here
                if velocity:
                    if affine or share < 1.0:
                        # what forces make of the point's velocity, less what it gets
                        q0, q1 = v[p, 0] + w0, v[p, 1] + w1
                        r0, r1 = share * q0 + (1.0 - share) * v0, share * q1 + (1.0 - share) * v1
                        z0, z1 = q0 + r0, q1 + r1
                        if not strain:
                            # strains follow the new velocities, see `halfstep.taken`
                            z0, z1 = z0 - w0, z1 - w1
                        projected += mp * ((q0 - r0) * z0 + (q1 - r1) * z1)
                    if affine:
                        v[p, 0], v[p, 1] = v0, v1
                        b00, b01, b10, b11 = h00, h01, h10, h11
                        if APIC:
                            # moments; where the point scatters its functions divide them
                            _, _, b00, b10 = lanes(B0)
                            _, _, b01, b11 = lanes(B1)
                            if general and averaged:
                                q0, q1 = drift(S0, node0, i0, n0, x0), drift(S1, node1, i1, n1, x1)
                                b00, b10 = b00 - q0 * v0, b10 - q0 * v1
                                b01, b11 = b01 - q1 * v0, b11 - q1 * v1
                        C[p, 0, 0], C[p, 0, 1], C[p, 1, 0], C[p, 1, 1] = b00, b01, b10, b11
                    else:
                        v[p, 0] = share * (v[p, 0] + w0) + (1.0 - share) * v0
                        v[p, 1] = share * (v[p, 1] + w1) + (1.0 - share) * v1
                    if record:
                        acceleration[p, 0], acceleration[p, 1] = w0 / dt, w1 / dt
                if strain:
                    a00, a01, a10, a11 = 1.0 + dt * h00, dt * h01, dt * h10, 1.0 + dt * h11
                    f00, f01, f10, f11 = F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1]
                    f00, f01, f10, f11 = (
                        a00 * f00 + a01 * f10, a00 * f01 + a01 * f11,
                        a10 * f00 + a11 * f10, a10 * f01 + a11 * f11,
                    )  # fmt: skip
                    F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1] = f00, f01, f10, f11
                    J = f00 * f11 - f01 * f10
                    if not (J > 0.0 and a00 * a11 - a01 * a10 > 0.0):
                        return np.intp(p), left, behind
                    ratio = 1.0
                    u00, u11 = h00, h11
                    if used:
                        if kind == LAW:
                            # F-bar: the law sees the mean's change of volume
                            q = mean / (a00 * a11 - a01 * a10)
                            if not q > 0.0:
                                return np.intp(p), left, behind
                            q = math.sqrt(q)
                            a00, a01, a10, a11 = q * a00, q * a01, q * a10, q * a11
                            J_bar[p] *= mean
                            ratio = J / J_bar[p]
                        else:
                            q = 0.5 * (mean / dt - h00 - h11)
                            u00, u11 = h00 + q, h11 + q
                    L = np.intp(0) if single else np.intp(which[p])
                    if kind == NEO:
                        lmbda, mu = numbers[L, 0], numbers[L, 1]
                        t22 = lmbda * logarithm(J)
                        b00, b11 = f00 * f00 + f01 * f01, f10 * f10 + f11 * f11
                        t00, t11 = t22 + mu * (b00 - 1.0), t22 + mu * (b11 - 1.0)
                        t01 = mu * (f00 * f10 + f01 * f11)
                    else:
                        if kind == LAW:
                            y00, y11, y01 = state[p, 0], state[p, 1], state[p, 3]
                            w00, w01 = a00 * y00 + a01 * y01, a00 * y01 + a01 * y11
                            w10, w11 = a10 * y00 + a11 * y01, a10 * y01 + a11 * y11
                            y00, y11 = w00 * a00 + w01 * a01, w10 * a10 + w11 * a11
                            y01 = w00 * a10 + w01 * a11
                        elif kind == JAUMANN:
                            # the increment by the middle of the step, and the turn of its spin
                            z = 0.5 * dt * (u00 * u11 - h01 * h10)
                            q = 1.0 + 0.5 * dt * (u00 + u11 + z)
                            if not q > 0.0:
                                return np.intp(p), left, behind
                            q = dt / q
                            w = 0.5 * q * (h01 - h10)
                            turn = 1.0 / (1.0 + 0.25 * w * w)
                            c, s = 1.0 - 0.5 * w * w * turn, w * turn
                            y00, y11, y01 = state[p, 0], state[p, 1], state[p, 3]
                            w00, w01 = c * y00 + s * y01, c * y01 + s * y11
                            w10, w11 = c * y01 - s * y00, c * y11 - s * y01
                            y00 = w00 * c + w01 * s + q * (u00 + z)
                            y11 = w11 * c - w10 * s + q * (u11 + z)
                            y01 = w01 * c - w00 * s + 0.5 * q * (h01 + h10)
                        else:
                            y00 = state[p, 0] + dt * u00
                            y11 = state[p, 1] + dt * u11
                            y01 = state[p, 3] + 0.5 * dt * (h01 + h10)
                        # eigenvalues from what does not cancel, axes by the half angle
                        gap, mid = 0.5 * (y00 - y11), 0.5 * (y00 + y11)
                        r = math.sqrt(gap * gap + y01 * y01)
                        cosine, sine = 1.0, 0.0
                        if r > 0.0:
                            q = 1.0 / r
                            cosine, sine = gap * q, y01 * q
                        high = mid + r
                        low = mid - r
                        e2 = e_out[p]
                        if kind == LAW:
                            low = (y00 * y11 - y01 * y01) / high
                            if not low > 0.0:
                                return np.intp(p), left, behind
                            e0, e1 = 0.5 * logarithm(high), 0.5 * logarithm(low)
                        else:
                            e0, e1 = high, low
                        e[0], e[1], e[2] = e0, e1, e2
                        offset = (np.intp(p) if stride else L) * numbers.shape[1] * 8
                        inner = inner_at + 8 * np.intp(p) * internal.shape[1]
                        status = call_law(
                            addresses[L], numbers_at + offset, e_at, inner, scratch_at, tau_at,
                            tangent_at,
                        )  # fmt: skip
                        if status != 0:
                            return np.intp(p), left, behind
                        for k in range(internal.shape[1]):
                            internal[p, k] = scratch[k]
                        if e[0] != e0 or e[1] != e1 or e[2] != e2:
                            e_out[p] = e[2]
                            if kind == LAW:
                                high *= exponential(2.0 * (e[0] - e0))
                                low *= exponential(2.0 * (e[1] - e1))
                            else:
                                high, low = e[0], e[1]
                            mid, gap = 0.5 * (high + low), 0.5 * (high - low)
                            y00, y11, y01 = mid + gap * cosine, mid - gap * cosine, gap * sine
                        state[p, 0], state[p, 1], state[p, 3] = y00, y11, y01
                        if record:
                            state[p, 2] = math.exp(2.0 * e[2]) if kind == LAW else e[2]
                        mid, gap = 0.5 * (tau[0] + tau[1]), 0.5 * (tau[0] - tau[1])
                        t00, t11, t01 = mid + gap * cosine, mid - gap * cosine, gap * sine
                        t22 = tau[2]
                        if kind == JAUMANN:
                            # Cauchy's
                            ratio = J
                        if kind == JAUMANN or used:
                            t00, t11, t01, t22 = ratio * t00, ratio * t11, ratio * t01, ratio * t22
                    if kind != SMALL and (kind != NEO or record):
                        # H (1 + H/2)⁻¹ = (H + ½ det H)/det(1 + H/2), the rate by the middle
                        z = 0.5 * dt * (h00 * h11 - h01 * h10)
                        q = 1.0 / (1.0 + 0.5 * dt * (h00 + h11 + z))
                        h00, h11, h01, h10 = q * (h00 + z), q * (h11 + z), q * h01, q * h10
                    if kind != NEO:
                        work += vp * (
                            (tau_old[p, 0] + t00) * h00 + (tau_old[p, 1] + t11) * h11
                            + (tau_old[p, 2] + t01) * (h01 + h10)
                        )  # fmt: skip
                    if record:
                        latest += vp * (t00 * h00 + t11 * h11 + t01 * (h01 + h10))
                    if kind != NEO or record:
                        tau_old[p, 0], tau_old[p, 1], tau_old[p, 2] = t00, t11, t01
                    if record:
                        V[p] = J * vp
                        q = 1.0 if kind == SMALL else 1.0 / J
                        stress[p, 0, 0], stress[p, 1, 1] = q * t00, q * t11
                        stress[p, 0, 1] = stress[p, 1, 0] = q * t01
                        stress[p, 2, 2] = q * t22
                if same == 2:
                    P = four(0.0, 0.0, g0, g1)
                    T0 = four(0.0, 0.0, -vp * t00, -vp * t01)
                    T1 = four(0.0, 0.0, -vp * t01, -vp * t11)
                    for a in range(n0):
                        at = out_at + base + a * row
                        R, Q = axpy(d0[a], T0, times(S0[a], P)), times(S0[a], T1)
                        for b in range(n1):
                            Z = axpy(S1[b], R, load(at + b * STRIDE))
                            store(at + b * STRIDE, axpy(d1[b], Q, Z))
                if same == 1:
                    P, K0, K1 = four(0.0, mp * v[p, 0], mp * v[p, 1], 0.0), nothing, nothing
                    if affine:
                        q0 = q1 = mp
                        q = 0.0
                        if APIC:
                            q0, q1, q = inverse_moments(
                                general and averaged,
                                mp,
                                S0,
                                node0,
                                i0,
                                n0,
                                x0,
                                S1,
                                node1,
                                i1,
                                n1,
                                x1,
                            )
                        b00, b01, b10, b11 = C[p, 0, 0], C[p, 0, 1], C[p, 1, 0], C[p, 1, 1]
                        K0 = four(0.0, q0 * b00 + q * b01, q0 * b10 + q * b11, 0.0)
                        K1 = four(0.0, q1 * b01 + q * b00, q1 * b11 + q * b10, 0.0)
                    for a in range(n0):
                        at = out_at + base + a * row + second - 8
                        R = times(S0[a], P)
                        if affine:
                            R = axpy(S0[a] * (node0[i0 + a] - x0), K0, R)
                        for b in range(n1):
                            Z = axpy(S1[b], R, load(at + b * STRIDE))
                            if affine:
                                Z = axpy(S0[a] * S1[b] * (node1[i1 + b] - x1), K1, Z)
                            store(at + b * STRIDE, Z)
                if move and TPIC:
                    # C (1 + Δt C)⁻¹ = (C + Δt det C)/det(1 + Δt C), by where the points go
                    b00, b01, b10, b11 = C[p, 0, 0], C[p, 0, 1], C[p, 1, 0], C[p, 1, 1]
                    z = dt * (b00 * b11 - b01 * b10)
                    q = 1.0 / (1.0 + dt * (b00 + b11 + z))
                    C[p, 0, 0], C[p, 1, 1] = q * (b00 + z), q * (b11 + z)
                    C[p, 0, 1], C[p, 1, 0] = q * b01, q * b10
                if move:
                    x0, x1 = x0 + dt * v0, x1 + dt * v1
                    x[p, 0], x[p, 1] = x0, x1
                    # the others ask where they scatter
                    asks = general or not (new and scatter)
                    if asks and not (start0 <= x0 <= end0 and start1 <= x1 <= end1):
                        return np.intp(p), left, behind
                    way = max(abs(v0) * fine0, abs(v1) * fine1) * dt
                    if not alike:
                        outer += g0 * v0 + g1 * v1
                    if averaged:
                        f00, f01, f10, f11 = F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1]
                        J = f00 * f11 - f01 * f10
                        k00, k11 = half0[p, 0], half0[p, 1]
                        if growth == by_stretch:
                            # l = l0 diag(U), U = (FᵀF + J I)/√(tr FᵀF + 2 J)
                            q = 1.0 / math.sqrt(f00**2 + f01**2 + f10**2 + f11**2 + 2.0 * J)
                            k00 *= (f00 * f00 + f10 * f10 + J) * q
                            k11 *= (f01 * f01 + f11 * f11 + J) * q
                        elif growth == by_volume:
                            q = math.sqrt(J)
                            k00, k11 = q * k00, q * k11
                        way += max((k00 - l0) * fine0, (k11 - l1) * fine1)
                        l0, l1 = k00, k11
                        half[p, 0], half[p, 1] = l0, l1
                    fastest = max(fastest, way)
            if new and scatter:
                n0 = n1 = usual
                if general:
                    i0, n0 = overlapped(line0, uniform, x0, l0)
                    i1, n1 = overlapped(line1, uniform, x1, l1)
                    line_weights(line0, uniform, degree, i0, n0, x0, l0, S0, d0, part, slope)
                    line_weights(line1, uniform, degree, i1, n1, x1, l1, S1, d1, part, slope)
                    n0, n1 = n0 + degree, n1 + degree
                else:
                    known0, i0 = middle_weights(degree, averaged, x0, l0, start0, s0, last0, S0, d0)
                    known1, i1 = middle_weights(degree, averaged, x1, l1, start1, s1, last1, S1, d1)
                    if not (known0 and known1):
                        if not (start0 <= x0 <= end0 and start1 <= x1 <= end1):
                            return np.intp(p), left, behind
                        if kind == NEO and strain and advance:
                            tau_old[p, 0], tau_old[p, 1], tau_old[p, 2] = t00, t11, t01
                        skipped[1, behind] = rows[index]
                        behind += 1
                        continue
                if i0 < low0 or i1 < low1 or i0 + n0 > top0 or i1 + n1 > top1:
                    return np.intp(p), left, behind
                base = i0 * row + i1 * STRIDE
                if new == 2 and not (strain and advance):
                    t00, t11, t01 = tau_old[p, 0], tau_old[p, 1], tau_old[p, 2]
                if new == 1:
                    P = four(mp * v[p, 0], mp * v[p, 1], 0.0, 0.0)
                else:
                    P = four(mp * v[p, 0], mp * v[p, 1], g0, g1)
                T0 = four(0.0, 0.0, -vp * t00, -vp * t01)
                T1 = four(0.0, 0.0, -vp * t01, -vp * t11)
                K0 = K1 = nothing
                if affine:
                    q0 = q1 = mp
                    q = 0.0
                    if APIC:
                        q0, q1, q = inverse_moments(
                            general and averaged, mp, S0, node0, i0, n0, x0, S1, node1, i1, n1, x1
                        )
                    b00, b01, b10, b11 = C[p, 0, 0], C[p, 0, 1], C[p, 1, 0], C[p, 1, 1]
                    K0 = four(q0 * b00 + q * b01, q0 * b10 + q * b11, 0.0, 0.0)
                    K1 = four(q1 * b01 + q * b00, q1 * b11 + q * b10, 0.0, 0.0)
                for a in range(n0):
                    at = out_at + base + a * row
                    R, Q, K, mass = times(S0[a], P), nothing, nothing, S0[a] * mp
                    if new == 2:
                        R, Q = axpy(d0[a], T0, R), times(S0[a], T1)
                    if affine:
                        R = axpy(S0[a] * (node0[i0 + a] - x0), K0, R)
                        K = times(S0[a], K1)
                    for b in range(n1):
                        Z = axpy(S1[b], R, load(at + b * STRIDE))
                        if new == 2:
                            Z = axpy(d1[b], Q, Z)
                        if affine:
                            Z = axpy(S1[b] * (node1[i1 + b] - x1), K, Z)
                        store(at + b * STRIDE, Z)
                        add_at(at + b * STRIDE + MASS, S1[b] * mass)
        done[0] += 0.5 * dt * work
        done[1] += dt * outer
        done[2] = max(done[2], fastest)
        done[6] += dt * latest
        done[7] += 0.5 * projected
        # an address keeps nothing alive: without this Numba frees it before the loop
        tangent[0] = 0.0
        return -1, left, behind

    return run
