"""The fused loop of explicit steps in three dimensions: grid → points → grid in one pass.

It is that of `dolfinmpm.dynamics.fused2d` with one direction more. A node has a vector of three
components and its mass, or 0, in the fourth lane; the principal axes of a strain are taken
through the projectors of `dolfinmpm.dynamics.axes`. It knows no F-bar.
"""

from __future__ import annotations

import functools
import math

import numba
import numpy as np

from dolfinmpm.basis.lineweights import line_weights, overlapped
from dolfinmpm.basis.uniform import middle_count, middle_weights
from dolfinmpm.dynamics.axes import axes, combine
from dolfinmpm.dynamics.moments import drift, slopes
from dolfinmpm.dynamics.passes import COLUMNS, FAST, GROWTH, JAUMANN, LAW, NEO, SMALL, Pass
from dolfinmpm.dynamics.rates import carried, turned
from dolfinmpm.dynamics.simdmath import (
    axpy,
    exponential,
    four,
    lanes,
    load,
    logarithm,
    store,
    times,
)
from dolfinmpm.materials.lawkernel import call_law

__all__ = ["kernel"]


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
def column(C, p, k):
    """Column of a point's affine part."""
    return four(C[p, 0, k], C[p, 1, k], C[p, 2, k], 0.0)


@functools.cache
def kernel(degree: int, growth: int, kind: int, affine: int, parts: Pass, general: bool):
    """The loop for a basis, a measure of strain, an affine part and the parts of a pass.

    See `dolfinmpm.dynamics.fused2d.kernel`, whose arguments and results these are.
    """
    averaged, by_volume, by_stretch = growth > 0, GROWTH["volume"], GROWTH["stretch"]
    velocity, strain, move, same, new = parts
    APIC, TPIC = affine == 1, affine == 2
    gradient = strain or (TPIC and velocity)
    STRIDE, SECOND, FORCE = (8 * k for k in (COLUMNS[3].width, COLUMNS[3].second, COLUMNS[3].force))
    VELOCITY = 8 * COLUMNS[3].velocity
    STRAIN = 8 * COLUMNS[3].strain
    # points that take velocities are strained by the same, others by those that nodes have for it,
    # and move by what strains them
    apart = gradient and not velocity
    values = velocity or (move and not apart)

    # compiled functions among the closed-over values would keep the loop out of Numba's cache
    usual = middle_count(degree, averaged)
    # whether the grid's edge may cut domains, which couples the directions' moments
    cut = general and averaged

    @numba.njit(cache=True, error_model="numpy", fastmath=FAST)
    def run(
        grid, nodes, out, points, law, dt, share, record, advance, scatter, rows, skipped, done
    ):  # fmt: skip
        line0, line1, line2, node0, node1, node2, uniform, origin, shape, first, last, fine = grid
        x, half, half0, v, C, F, V, V0, m, state, internal, stress, acceleration = points[:13]
        tau_old, _, body = points[13:]
        addresses, numbers, stride, which = law
        S0, S1, S2 = np.empty(64), np.empty(64), np.empty(64)
        d0, d1, d2 = np.empty(64), np.empty(64), np.empty(64)
        part, slope = np.empty(4), np.empty(4)
        e, tau, tangent = np.empty(3), np.empty(3), np.empty(9)
        scratch = np.empty(max(internal.shape[1], 1))
        work = outer = fastest = latest = projected = 0.0
        row = STRIDE * shape[2]
        layer = row * shape[1]
        last0, last1, last2 = line0.size - 2, line1.size - 2, line2.size - 2
        start0, start1, start2 = line0[0], line1[0], line2[0]
        end0, end1, end2 = line0[last0 + 1], line1[last1 + 1], line2[last2 + 1]
        s0, s1 = (last0 + 1) / (end0 - start0), (last1 + 1) / (end1 - start1)
        s2 = (last2 + 1) / (end2 - start2)
        low0, low1, low2 = origin[0] + first[0], origin[1] + first[1], origin[2] + first[2]
        top0, top1, top2 = origin[0] + last[0], origin[1] + last[1], origin[2] + last[2]
        fine0, fine1, fine2 = fine[0], fine[1], fine[2]
        e_at, tau_at, tangent_at = e.ctypes.data, tau.ctypes.data, tangent.ctypes.data
        scratch_at, inner_at = scratch.ctypes.data, internal.ctypes.data
        before = origin[0] * layer + origin[1] * row + origin[2] * STRIDE
        numbers_at = numbers.ctypes.data
        nodes_at, out_at = nodes.ctypes.data - before, out.ctypes.data - before
        single, alike = which.shape[0] == 1, body.shape[0] == 0
        nothing = four(0.0, 0.0, 0.0, 0.0)
        t00 = t11 = t22 = t01 = t12 = t02 = g0 = g1 = g2 = 0.0
        left = behind = 0
        number_of_points = rows.size if general else x.shape[0]
        for index in range(number_of_points):
            # an index without a sign needs no look at whether it counts from the end
            p = np.uintp(rows[index] if general else index)
            x0, x1, x2 = x[p, 0], x[p, 1], x[p, 2]
            l0 = l1 = l2 = 0.0
            if averaged:
                l0, l1, l2 = half[p, 0], half[p, 1], half[p, 2]
            mp, vp = m[p], V0[p]
            if not alike:
                g0, g1, g2 = body[p, 0], body[p, 1], body[p, 2]
            if advance and (velocity or strain or move or same):
                n0 = n1 = n2 = usual
                if general:
                    i0, n0 = overlapped(line0, uniform, x0, l0)
                    i1, n1 = overlapped(line1, uniform, x1, l1)
                    i2, n2 = overlapped(line2, uniform, x2, l2)
                    line_weights(line0, uniform, degree, i0, n0, x0, l0, S0, d0, part, slope)
                    line_weights(line1, uniform, degree, i1, n1, x1, l1, S1, d1, part, slope)
                    line_weights(line2, uniform, degree, i2, n2, x2, l2, S2, d2, part, slope)
                    n0, n1, n2 = n0 + degree, n1 + degree, n2 + degree
                else:
                    known0, i0 = middle_weights(degree, averaged, x0, l0, start0, s0, last0, S0, d0)
                    known1, i1 = middle_weights(degree, averaged, x1, l1, start1, s1, last1, S1, d1)
                    known2, i2 = middle_weights(degree, averaged, x2, l2, start2, s2, last2, S2, d2)
                    if not (known0 and known1 and known2):
                        # one of the few at an edge or with a large domain: see `general`
                        skipped[0, left] = rows[index]
                        left += 1
                        continue
                base = i0 * layer + i1 * row + i2 * STRIDE
                Y = W = H0 = H1 = H2 = B0 = B1 = B2 = nothing
                for a in range(n0):
                    YA = WA = HA = QA = KA = ZA = nothing
                    for b in range(n1):
                        at = nodes_at + base + a * layer + b * row
                        YB = WB = HB = QB = ZB = nothing
                        for c in range(n2):
                            if values:
                                Z = load(at + c * STRIDE + VELOCITY)
                                YB = axpy(S2[c], Z, YB)
                                if APIC and velocity:
                                    ZB = axpy(S2[c] * (node2[i2 + c] - x2), Z, ZB)
                                if gradient and not apart:
                                    QB = axpy(d2[c], Z, QB)
                            if apart:
                                Z = load(at + c * STRIDE + STRAIN)
                                HB = axpy(S2[c], Z, HB)
                                QB = axpy(d2[c], Z, QB)
                            if velocity:
                                WB = axpy(S2[c], load(at + c * STRIDE), WB)
                        if gradient:
                            if not apart:
                                HB = YB
                            HA = axpy(d1[b], HB, HA)
                            QA = axpy(S1[b], QB, QA)
                            if apart:
                                KA = axpy(S1[b], HB, KA)
                        if values:
                            YA = axpy(S1[b], YB, YA)
                        if velocity:
                            WA = axpy(S1[b], WB, WA)
                        if APIC and velocity:
                            KA = axpy(S1[b] * (node1[i1 + b] - x1), YB, KA)
                            ZA = axpy(S1[b], ZB, ZA)
                    if values:
                        Y = axpy(S0[a], YA, Y)
                    elif move:
                        Y = axpy(S0[a], KA, Y)
                    if velocity:
                        W = axpy(S0[a], WA, W)
                    if APIC and velocity:
                        B0 = axpy(S0[a] * (node0[i0 + a] - x0), YA, B0)
                        B1, B2 = axpy(S0[a], KA, B1), axpy(S0[a], ZA, B2)
                    if gradient:
                        H0 = axpy(d0[a], KA if apart else YA, H0)
                        H1, H2 = axpy(S0[a], HA, H1), axpy(S0[a], QA, H2)
                v0, v1, v2, _ = lanes(Y)
                w0, w1, w2, _ = lanes(W)
                h00, h10, h20, _ = lanes(H0)
                h01, h11, h21, _ = lanes(H1)
                h02, h12, h22, _ = lanes(H2)
                if velocity:
                    if affine or share < 1.0:
                        # what forces make of the point's velocity, less what it gets
                        q0, q1, q2 = v[p, 0] + w0, v[p, 1] + w1, v[p, 2] + w2
                        r0, r1 = share * q0 + (1.0 - share) * v0, share * q1 + (1.0 - share) * v1
                        r2 = share * q2 + (1.0 - share) * v2
                        z0, z1, z2 = q0 + r0, q1 + r1, q2 + r2
                        if not strain:
                            # strains follow the new velocities, see `halfstep.taken`
                            z0, z1, z2 = z0 - w0, z1 - w1, z2 - w2
                        projected += mp * ((q0 - r0) * z0 + (q1 - r1) * z1 + (q2 - r2) * z2)
                    if affine:
                        v[p, 0], v[p, 1], v[p, 2] = v0, v1, v2
                        if APIC:
                            # moments; where the point scatters its functions divide them
                            if cut:
                                B0 = axpy(-drift(S0, node0, i0, n0, x0), Y, B0)
                                B1 = axpy(-drift(S1, node1, i1, n1, x1), Y, B1)
                                B2 = axpy(-drift(S2, node2, i2, n2, x2), Y, B2)
                            C[p, 0, 0], C[p, 1, 0], C[p, 2, 0], _ = lanes(B0)
                            C[p, 0, 1], C[p, 1, 1], C[p, 2, 1], _ = lanes(B1)
                            C[p, 0, 2], C[p, 1, 2], C[p, 2, 2], _ = lanes(B2)
                        else:
                            C[p, 0, 0], C[p, 1, 0], C[p, 2, 0] = h00, h10, h20
                            C[p, 0, 1], C[p, 1, 1], C[p, 2, 1] = h01, h11, h21
                            C[p, 0, 2], C[p, 1, 2], C[p, 2, 2] = h02, h12, h22
                    else:
                        v[p, 0] = share * (v[p, 0] + w0) + (1.0 - share) * v0
                        v[p, 1] = share * (v[p, 1] + w1) + (1.0 - share) * v1
                        v[p, 2] = share * (v[p, 2] + w2) + (1.0 - share) * v2
                    if record:
                        acceleration[p, 0] = w0 / dt
                        acceleration[p, 1] = w1 / dt
                        acceleration[p, 2] = w2 / dt
                if strain:
                    a00, a01, a02 = 1.0 + dt * h00, dt * h01, dt * h02
                    a10, a11, a12 = dt * h10, 1.0 + dt * h11, dt * h12
                    a20, a21, a22 = dt * h20, dt * h21, 1.0 + dt * h22
                    f00, f01, f02 = F[p, 0, 0], F[p, 0, 1], F[p, 0, 2]
                    f10, f11, f12 = F[p, 1, 0], F[p, 1, 1], F[p, 1, 2]
                    f20, f21, f22 = F[p, 2, 0], F[p, 2, 1], F[p, 2, 2]
                    f00, f10, f20 = (
                        a00 * f00 + a01 * f10 + a02 * f20, a10 * f00 + a11 * f10 + a12 * f20,
                        a20 * f00 + a21 * f10 + a22 * f20,
                    )  # fmt: skip
                    f01, f11, f21 = (
                        a00 * f01 + a01 * f11 + a02 * f21, a10 * f01 + a11 * f11 + a12 * f21,
                        a20 * f01 + a21 * f11 + a22 * f21,
                    )  # fmt: skip
                    f02, f12, f22 = (
                        a00 * f02 + a01 * f12 + a02 * f22, a10 * f02 + a11 * f12 + a12 * f22,
                        a20 * f02 + a21 * f12 + a22 * f22,
                    )  # fmt: skip
                    F[p, 0, 0], F[p, 0, 1], F[p, 0, 2] = f00, f01, f02
                    F[p, 1, 0], F[p, 1, 1], F[p, 1, 2] = f10, f11, f12
                    F[p, 2, 0], F[p, 2, 1], F[p, 2, 2] = f20, f21, f22
                    J = (
                        f00 * (f11 * f22 - f12 * f21) + f01 * (f12 * f20 - f10 * f22)
                        + f02 * (f10 * f21 - f11 * f20)
                    )  # fmt: skip
                    change = (
                        a00 * (a11 * a22 - a12 * a21) + a01 * (a12 * a20 - a10 * a22)
                        + a02 * (a10 * a21 - a11 * a20)
                    )  # fmt: skip
                    if not (J > 0.0 and change > 0.0):
                        return np.intp(p), left, behind
                    if kind != SMALL and (kind != NEO or record):
                        # the rate by the middle of the step
                        scale, h00, h01, h02, h10, h11, h12, h20, h21, h22 = carried(
                            0.5 * dt, h00, h01, h02, h10, h11, h12, h20, h21, h22
                        )
                        if kind == JAUMANN and not scale > 0.0:
                            return np.intp(p), left, behind
                    L = np.intp(0) if single else np.intp(which[p])
                    if kind == NEO:
                        lmbda, mu = numbers[L, 0], numbers[L, 1]
                        z = lmbda * logarithm(J)
                        t00 = z + mu * (f00 * f00 + f01 * f01 + f02 * f02 - 1.0)
                        t11 = z + mu * (f10 * f10 + f11 * f11 + f12 * f12 - 1.0)
                        t22 = z + mu * (f20 * f20 + f21 * f21 + f22 * f22 - 1.0)
                        t01 = mu * (f00 * f10 + f01 * f11 + f02 * f12)
                        t12 = mu * (f10 * f20 + f11 * f21 + f12 * f22)
                        t02 = mu * (f00 * f20 + f01 * f21 + f02 * f22)
                    else:
                        y00, y11, y22 = state[p, 0], state[p, 1], state[p, 2]
                        y01, y12, y02 = state[p, 3], state[p, 4], state[p, 5]
                        if kind == LAW:
                            w00 = a00 * y00 + a01 * y01 + a02 * y02
                            w01 = a00 * y01 + a01 * y11 + a02 * y12
                            w02 = a00 * y02 + a01 * y12 + a02 * y22
                            w10 = a10 * y00 + a11 * y01 + a12 * y02
                            w11 = a10 * y01 + a11 * y11 + a12 * y12
                            w12 = a10 * y02 + a11 * y12 + a12 * y22
                            w20 = a20 * y00 + a21 * y01 + a22 * y02
                            w21 = a20 * y01 + a21 * y11 + a22 * y12
                            w22 = a20 * y02 + a21 * y12 + a22 * y22
                            y00 = w00 * a00 + w01 * a01 + w02 * a02
                            y11 = w10 * a10 + w11 * a11 + w12 * a12
                            y22 = w20 * a20 + w21 * a21 + w22 * a22
                            y01 = w00 * a10 + w01 * a11 + w02 * a12
                            y12 = w10 * a20 + w11 * a21 + w12 * a22
                            y02 = w00 * a20 + w01 * a21 + w02 * a22
                        else:
                            if kind == JAUMANN:
                                y00, y11, y22, y01, y12, y02 = turned(
                                    0.5 * dt * (h21 - h12), 0.5 * dt * (h02 - h20),
                                    0.5 * dt * (h10 - h01), y00, y11, y22, y01, y12, y02,
                                )  # fmt: skip
                            y00, y11, y22 = y00 + dt * h00, y11 + dt * h11, y22 + dt * h22
                            y01 += 0.5 * dt * (h01 + h10)
                            y12 += 0.5 * dt * (h12 + h21)
                            y02 += 0.5 * dt * (h02 + h20)
                        (
                            r0, r1, r2, P00, P11, P22, P01, P12, P02, D00, D11, D22, D01, D12, D02
                        ) = axes(y00, y11, y22, y01, y12, y02)  # fmt: skip
                        if kind == LAW:
                            if not (r0 > 0.0 and r2 > 0.0):
                                return np.intp(p), left, behind
                            e0, e1, e2 = (
                                0.5 * logarithm(r0), 0.5 * logarithm(r1), 0.5 * logarithm(r2)
                            )  # fmt: skip
                        else:
                            e0, e1, e2 = r0, r1, r2
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
                            if kind == LAW:
                                r0 *= exponential(2.0 * (e[0] - e0))
                                r1 *= exponential(2.0 * (e[1] - e1))
                                r2 *= exponential(2.0 * (e[2] - e2))
                            else:
                                r0, r1, r2 = e[0], e[1], e[2]
                            y00, y11 = combine(r0, r1, r2, P00, D00), combine(r0, r1, r2, P11, D11)
                            y22 = combine(r0, r1, r2, P22, D22)
                            z, gap = r0 - 0.5 * (r1 + r2), 0.5 * (r1 - r2)
                            y01, y12 = z * P01 + gap * D01, z * P12 + gap * D12
                            y02 = z * P02 + gap * D02
                        state[p, 0], state[p, 1], state[p, 2] = y00, y11, y22
                        state[p, 3], state[p, 4], state[p, 5] = y01, y12, y02
                        r0, r1, r2 = tau[0], tau[1], tau[2]
                        t00, t11 = combine(r0, r1, r2, P00, D00), combine(r0, r1, r2, P11, D11)
                        t22 = combine(r0, r1, r2, P22, D22)
                        z, gap = r0 - 0.5 * (r1 + r2), 0.5 * (r1 - r2)
                        t01, t12 = z * P01 + gap * D01, z * P12 + gap * D12
                        t02 = z * P02 + gap * D02
                        if kind == JAUMANN:
                            # Cauchy's
                            t00, t11, t22 = J * t00, J * t11, J * t22
                            t01, t12, t02 = J * t01, J * t12, J * t02
                    if kind != NEO:
                        k00, k11 = tau_old[p, 0] + t00, tau_old[p, 1] + t11
                        k22, k01 = tau_old[p, 2] + t22, tau_old[p, 3] + t01
                        k12, k02 = tau_old[p, 4] + t12, tau_old[p, 5] + t02
                        work += vp * (
                            k00 * h00 + k11 * h11 + k22 * h22
                            + k01 * (h01 + h10) + k12 * (h12 + h21) + k02 * (h02 + h20)
                        )  # fmt: skip
                    if record:
                        latest += vp * (
                            t00 * h00 + t11 * h11 + t22 * h22
                            + t01 * (h01 + h10) + t12 * (h12 + h21) + t02 * (h02 + h20)
                        )  # fmt: skip
                    if kind != NEO or record:
                        tau_old[p, 0], tau_old[p, 1], tau_old[p, 2] = t00, t11, t22
                        tau_old[p, 3], tau_old[p, 4], tau_old[p, 5] = t01, t12, t02
                    if record:
                        V[p] = J * vp
                        q = 1.0 if kind == SMALL else 1.0 / J
                        stress[p, 0, 0], stress[p, 1, 1], stress[p, 2, 2] = (
                            q * t00,
                            q * t11,
                            q * t22,
                        )
                        stress[p, 0, 1] = stress[p, 1, 0] = q * t01
                        stress[p, 1, 2] = stress[p, 2, 1] = q * t12
                        stress[p, 0, 2] = stress[p, 2, 0] = q * t02
                if same == 2:
                    G = four(g0, g1, g2, 0.0)
                    T0 = four(-vp * t00, -vp * t01, -vp * t02, 0.0)
                    T1 = four(-vp * t01, -vp * t11, -vp * t12, 0.0)
                    T2 = four(-vp * t02, -vp * t12, -vp * t22, 0.0)
                    for a in range(n0):
                        G0 = axpy(d0[a], T0, times(S0[a], G))
                        G1, G2 = times(S0[a], T1), times(S0[a], T2)
                        for b in range(n1):
                            at = out_at + base + a * layer + b * row + FORCE
                            R, Q = axpy(d1[b], G1, times(S1[b], G0)), times(S1[b], G2)
                            for c in range(n2):
                                Z = axpy(S2[c], R, load(at + c * STRIDE))
                                store(at + c * STRIDE, axpy(d2[c], Q, Z))
                if same == 1:
                    P = four(mp * v[p, 0], mp * v[p, 1], mp * v[p, 2], 0.0)
                    K0 = K1 = K2 = nothing
                    if affine:
                        K0, K1, K2 = column(C, p, 0), column(C, p, 1), column(C, p, 2)
                        if APIC:
                            K0, K1, K2 = slopes(
                                cut, K0, K1, K2, S0, node0, i0, n0, x0, S1, node1, i1, n1, x1,
                                S2, node2, i2, n2, x2,
                            )  # fmt: skip
                        K0, K1, K2 = times(mp, K0), times(mp, K1), times(mp, K2)
                    for a in range(n0):
                        PA = P
                        if affine:
                            PA = axpy(node0[i0 + a] - x0, K0, P)
                        for b in range(n1):
                            at = out_at + base + a * layer + b * row + SECOND
                            q = S0[a] * S1[b]
                            R = PA
                            if affine:
                                R = axpy(node1[i1 + b] - x1, K1, PA)
                            R, Q = times(q, R), times(q, K2)
                            for c in range(n2):
                                Z = axpy(S2[c], R, load(at + c * STRIDE))
                                if affine:
                                    Z = axpy(S2[c] * (node2[i2 + c] - x2), Q, Z)
                                store(at + c * STRIDE, Z)
                if move and TPIC:
                    # the gradient by where the points go
                    (
                        _,
                        C[p, 0, 0], C[p, 0, 1], C[p, 0, 2],
                        C[p, 1, 0], C[p, 1, 1], C[p, 1, 2],
                        C[p, 2, 0], C[p, 2, 1], C[p, 2, 2],
                    ) = carried(
                        dt, C[p, 0, 0], C[p, 0, 1], C[p, 0, 2], C[p, 1, 0], C[p, 1, 1],
                        C[p, 1, 2], C[p, 2, 0], C[p, 2, 1], C[p, 2, 2],
                    )  # fmt: skip
                if move:
                    x0, x1, x2 = x0 + dt * v0, x1 + dt * v1, x2 + dt * v2
                    x[p, 0], x[p, 1], x[p, 2] = x0, x1, x2
                    # the others ask where they scatter
                    if (general or not (new and scatter)) and not (
                        start0 <= x0 <= end0 and start1 <= x1 <= end1 and start2 <= x2 <= end2
                    ):
                        return np.intp(p), left, behind
                    way = max(abs(v0) * fine0, abs(v1) * fine1, abs(v2) * fine2) * dt
                    if not alike:
                        outer += g0 * v0 + g1 * v1 + g2 * v2
                    if averaged:
                        k00, k11, k22 = half0[p, 0], half0[p, 1], half0[p, 2]
                        f00, f01, f02 = F[p, 0, 0], F[p, 0, 1], F[p, 0, 2]
                        f10, f11, f12 = F[p, 1, 0], F[p, 1, 1], F[p, 1, 2]
                        f20, f21, f22 = F[p, 2, 0], F[p, 2, 1], F[p, 2, 2]
                        if growth == by_stretch:
                            # l = l0 diag(U), U = √(FᵀF)
                            r0, r1, r2, P00, P11, P22, _, _, _, D00, D11, D22, _, _, _ = axes(
                                f00 * f00 + f10 * f10 + f20 * f20,
                                f01 * f01 + f11 * f11 + f21 * f21,
                                f02 * f02 + f12 * f12 + f22 * f22,
                                f00 * f01 + f10 * f11 + f20 * f21,
                                f01 * f02 + f11 * f12 + f21 * f22,
                                f00 * f02 + f10 * f12 + f20 * f22,
                            )
                            if not r2 > 0.0:
                                return np.intp(p), left, behind
                            r0, r1, r2 = math.sqrt(r0), math.sqrt(r1), math.sqrt(r2)
                            k00 *= combine(r0, r1, r2, P00, D00)
                            k11 *= combine(r0, r1, r2, P11, D11)
                            k22 *= combine(r0, r1, r2, P22, D22)
                        elif growth == by_volume:
                            q = (
                                f00 * (f11 * f22 - f12 * f21) + f01 * (f12 * f20 - f10 * f22)
                                + f02 * (f10 * f21 - f11 * f20)
                            ) ** (1.0 / 3.0)  # fmt: skip
                            k00, k11, k22 = q * k00, q * k11, q * k22
                        way += max((k00 - l0) * fine0, (k11 - l1) * fine1, (k22 - l2) * fine2)
                        l0, l1, l2 = k00, k11, k22
                        half[p, 0], half[p, 1], half[p, 2] = l0, l1, l2
                    fastest = max(fastest, way)
            if new and scatter:
                n0 = n1 = n2 = usual
                if general:
                    i0, n0 = overlapped(line0, uniform, x0, l0)
                    i1, n1 = overlapped(line1, uniform, x1, l1)
                    i2, n2 = overlapped(line2, uniform, x2, l2)
                    line_weights(line0, uniform, degree, i0, n0, x0, l0, S0, d0, part, slope)
                    line_weights(line1, uniform, degree, i1, n1, x1, l1, S1, d1, part, slope)
                    line_weights(line2, uniform, degree, i2, n2, x2, l2, S2, d2, part, slope)
                    n0, n1, n2 = n0 + degree, n1 + degree, n2 + degree
                else:
                    known0, i0 = middle_weights(degree, averaged, x0, l0, start0, s0, last0, S0, d0)
                    known1, i1 = middle_weights(degree, averaged, x1, l1, start1, s1, last1, S1, d1)
                    known2, i2 = middle_weights(degree, averaged, x2, l2, start2, s2, last2, S2, d2)
                    if not (known0 and known1 and known2):
                        if not (
                            start0 <= x0 <= end0 and start1 <= x1 <= end1 and start2 <= x2 <= end2
                        ):
                            return np.intp(p), left, behind
                        if kind == NEO and strain and advance:
                            tau_old[p, 0], tau_old[p, 1], tau_old[p, 2] = t00, t11, t22
                            tau_old[p, 3], tau_old[p, 4], tau_old[p, 5] = t01, t12, t02
                        skipped[1, behind] = rows[index]
                        behind += 1
                        continue
                if i0 < low0 or i1 < low1 or i2 < low2:
                    return np.intp(p), left, behind
                if i0 + n0 > top0 or i1 + n1 > top1 or i2 + n2 > top2:
                    return np.intp(p), left, behind
                base = i0 * layer + i1 * row + i2 * STRIDE
                if new == 2 and not (strain and advance):
                    t00, t11, t22 = tau_old[p, 0], tau_old[p, 1], tau_old[p, 2]
                    t01, t12, t02 = tau_old[p, 3], tau_old[p, 4], tau_old[p, 5]
                P = four(mp * v[p, 0], mp * v[p, 1], mp * v[p, 2], mp)
                G = four(g0, g1, g2, 0.0)
                T0 = four(-vp * t00, -vp * t01, -vp * t02, 0.0)
                T1 = four(-vp * t01, -vp * t11, -vp * t12, 0.0)
                T2 = four(-vp * t02, -vp * t12, -vp * t22, 0.0)
                K0 = K1 = K2 = nothing
                if affine:
                    K0, K1, K2 = column(C, p, 0), column(C, p, 1), column(C, p, 2)
                    if APIC:
                        K0, K1, K2 = slopes(
                            cut, K0, K1, K2, S0, node0, i0, n0, x0, S1, node1, i1, n1, x1,
                            S2, node2, i2, n2, x2,
                        )  # fmt: skip
                    K0, K1, K2 = times(mp, K0), times(mp, K1), times(mp, K2)
                for a in range(n0):
                    PA = P
                    if affine:
                        PA = axpy(node0[i0 + a] - x0, K0, P)
                    G0 = G1 = G2 = nothing
                    if new == 2:
                        G0 = axpy(d0[a], T0, times(S0[a], G))
                        G1, G2 = times(S0[a], T1), times(S0[a], T2)
                    for b in range(n1):
                        at = out_at + base + a * layer + b * row
                        q = S0[a] * S1[b]
                        PB = PA
                        if affine:
                            PB = axpy(node1[i1 + b] - x1, K1, PA)
                        PB, KB = times(q, PB), times(q, K2)
                        R = Q = nothing
                        if new == 2:
                            R, Q = axpy(d1[b], G1, times(S1[b], G0)), times(S1[b], G2)
                        for c in range(n2):
                            Z = axpy(S2[c], PB, load(at + c * STRIDE))
                            if affine:
                                Z = axpy(S2[c] * (node2[i2 + c] - x2), KB, Z)
                            store(at + c * STRIDE, Z)
                            if new == 2:
                                Z = axpy(S2[c], R, load(at + c * STRIDE + FORCE))
                                store(at + c * STRIDE + FORCE, axpy(d2[c], Q, Z))
        done[0] += 0.5 * dt * work
        done[1] += dt * outer
        done[2] = max(done[2], fastest)
        done[6] += dt * latest
        done[7] += 0.5 * projected
        # an address keeps nothing alive: without this Numba frees it before the loop
        tangent[0] = 0.0
        return -1, left, behind

    return run
