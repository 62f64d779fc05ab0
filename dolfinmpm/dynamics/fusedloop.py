"""The fused loop of explicit steps in two and three dimensions: grid → points → grid in one pass.

A pass brings the motion of the nodes to the points, updates the points, and scatters their masses,
momenta and forces to the nodes. It takes each point once, so that the point's data are in the
cache. The parts of a pass are fixed when it is compiled, see `Pass`. Loops over directions are
short: the compiler unrolls them, see `dolfinmpm._platform.simd`.
"""

from __future__ import annotations

import functools
import math

import numba
import numpy as np

from dolfinmpm._platform.simd import (
    add_at,
    axpy,
    four,
    integers,
    matrix,
    number_at,
    numbers,
    vectors,
)
from dolfinmpm.basis.uniformweights import middle_count
from dolfinmpm.dynamics.fusednodes import (
    add_shares,
    affine_columns,
    centre_cell,
    force_vector,
    force_vectors,
    gather,
    locate,
    locate_in_middle,
    mean_of,
    momentum_vector,
    radial_slopes,
    scatter,
    shares_of,
    take_moments,
    within,
)
from dolfinmpm.dynamics.fusedumat import begin_umats, umat_stress
from dolfinmpm.dynamics.passes import COLUMNS, FAST, GROWTH, JAUMANN, LAW, MEANS, NEO, SMALL, Pass
from dolfinmpm.dynamics.smalltensors import (
    add_symmetric,
    carried,
    combine,
    contracted,
    deformed,
    determinant,
    dot,
    exponential,
    inside,
    keep,
    keep_symmetric,
    logarithm,
    neo_hookean,
    plus_one,
    root,
    scaled,
    spectrum,
    stretches,
    take,
    take_symmetric,
    trace,
    transform,
    turned,
)
from dolfinmpm.kinematics.heldsides import inside_sides
from dolfinmpm.materials.lawkernel import call_law

__all__ = ["kernel"]


@functools.cache
def kernel(
    d: int,
    degree: int,
    growth: int,
    kind: int,
    affine: int,
    parts: Pass,
    general: bool,
    means: int = 0,
    umat: bool = False,
    ring: bool = False,
):
    """The loop for a dimension, a basis, a strain formulation, an affine part and a pass.

    `kernel(grid, nodes, out, points, law, dt, share, record, advance, spread, rows, skipped,
    done)` returns the first bad point or -1, and the numbers of points skipped and not scattered;
    see `Window`, `PointArrays` and `Laws` for what the tuples hold. A general one takes the points
    of `rows`, wherever they are; the others take all points, and skip what `middle_weights` does
    not know. `record` tells whether what only others read is written: accelerations, volumes,
    stresses. Without `advance` points only scatter where they are, as `new` tells, and without
    `spread` they do not: the first pass of all and the last one need no loops of their own.
    Growth of domains and `means` of F-bar: see `dolfinmpm.dynamics.passes`. `umat`: laws are UMATs.
    `ring`: points go around the axis, see `dolfinmpm.body.axisymmetry`.
    """
    averaged, by_volume, by_stretch = growth > 0, GROWTH["volume"], GROWTH["stretch"]
    velocity, strain, move, same, new, moved = parts
    # the sections of axisymmetric points hardly turn
    moved = moved and not ring
    centres, taken = means in MEANS["centres"], means in (MEANS[True][0], MEANS["centres"][0])
    used = means > 0 and not taken
    apic, tpic = affine == 1, affine == 2
    gradient, moments = strain or (tpic and velocity), apic and velocity
    # strains have a component across the section of a ring
    ds = 3 if ring else d
    width, mass, force, second = (8 * column for column in COLUMNS[d])
    # points that take velocities are strained by the same, others by those that nodes have for it
    column = 0 if velocity else second
    # in two dimensions changes of velocity are in the vector of velocities, and masses in none
    change = force if velocity and d == 3 else 0
    mass_apart = mass if d == 2 else 0
    # compiled functions among the closed-over values would keep the loop out of Numba's cache
    usual = middle_count(degree, averaged)
    # whether the grid's edge may cut domains, which couples the directions' moments
    cut = general and averaged

    @numba.njit(cache=True, error_model="numpy", fastmath=FAST)
    def run(
        grid, nodes, out, points, law, dt, share, record, advance, spread, rows, skipped, done
    ):  # fmt: skip
        lines, places, uniform, origin, shape, first, last, fine, held = grid
        X, half, half0, v, C, F, V, V0, m, state, internal, stress, acceleration = points[:13]
        tau_old, e_out, body = points[13:16]
        addresses, parameters, stride, which = law
        # of the grid
        start, end = numbers(3), numbers(3)
        per_length, final, low, top = numbers(3), integers(3), integers(3), integers(3)
        step, cell_step = integers(3), integers(3)
        nodes_at, cells_at = np.intp(nodes.ctypes.data) + column, np.intp(0)
        out_at = np.intp(out.ctypes.data)
        if means > 0:
            sums, J_bar = points[16:]
            cells_at = np.intp(sums.ctypes.data)
        if umat:
            begin_umats(points[16])
        between = 1
        for k in range(d - 1, -1, -1):
            final[k] = lines[k].size - 2
            start[k], end[k] = lines[k][0], lines[k][final[k] + 1]
            per_length[k] = (final[k] + 1) / (end[k] - start[k])
            step[k], cell_step[k] = width * between, 16 * between
            between *= shape[k]
            nodes_at, out_at = nodes_at - origin[k] * step[k], out_at - origin[k] * step[k]
            cells_at -= origin[k] * cell_step[k]
            low[k], top[k] = origin[k] + first[k], origin[k] + last[k]
        # of a point: functions that it sees
        i, n = integers(3), (usual, usual, usual)
        S, dS = matrix(3, 64), matrix(3, 64)
        L, room = matrix(3, 64), np.empty(64)
        part, slope = np.empty(4), np.empty(4)
        # its motion
        x, reach, g, v_new, dv = numbers(3), numbers(3), numbers(3), numbers(3), numbers(3)
        Y, H, B, K, T = vectors(2), vectors(3), vectors(3), vectors(3), vectors(3)
        h, u, a = matrix(3, 3), matrix(3, 3), matrix(3, 3)
        # strain and stress
        f, y, t, P, D = matrix(3, 3), matrix(3, 3), matrix(3, 3), matrix(3, 3), matrix(3, 3)
        r, e, trial, tau, tangent = numbers(3), numbers(3), numbers(3), numbers(3), numbers(9)
        scratch = np.empty(max(internal.shape[1], 1))
        e_at, tau_at, tangent_at = e.ctypes.data, tau.ctypes.data, tangent.ctypes.data
        scratch_at, inner_at = scratch.ctypes.data, internal.ctypes.data
        parameters_at = parameters.ctypes.data
        single, alike = which.shape[0] == 1, body.shape[0] == 0
        radial = four(0.0, 0.0, 1.0, 0.0)
        work = outer = fastest = last_work = projected = 0.0
        left = behind = 0
        for k in range(3):
            g[k] = reach[k] = 0.0
            for j in range(3):
                t[k, j] = y[k, j] = h[k, j] = 0.0
        number_of_points = rows.size if general else X.shape[0]
        for index in range(number_of_points):
            # an index without a sign needs no look at whether it counts from the end
            p = np.uintp(rows[index] if general else index)
            for k in range(d):
                x[k] = X[p, k]
                if averaged:
                    reach[k] = half[p, k]
                if not alike:
                    g[k] = body[p, k]
            mp, vp = m[p], V0[p]
            if advance and (velocity or strain or move or same):
                if general:
                    n = locate(lines, uniform, degree, x, reach, i, S, dS, part, slope)
                elif not locate_in_middle(
                    d, degree, averaged, x, reach, start, per_length, final, i, S, dS
                ):
                    # one of the few at an edge or with a large domain: see `general`
                    skipped[0, left] = rows[index]
                    left += 1
                    continue
                base = dot(d, i, step)
                if means > 0 and not centres:
                    shares_of(
                        d, general, lines, uniform, degree, per_length, x, reach, i, n, dS, L,
                        room, part, slope,
                    )  # fmt: skip
                if ring and averaged:
                    radial_slopes(
                        lines[0], uniform, degree, i[0], n[0], x[0], reach[0], dS[0], part, slope
                    )
                gather(
                    d, nodes_at + base, step, i, n, S, dS, x, places, gradient, moments, change, Y,
                    H, B, v_new, dv, h,
                )  # fmt: skip
                if ring:
                    h[0, 2] = h[1, 2] = h[2, 0] = h[2, 1] = 0.0
                    h[2, 2] = v_new[0] / x[0]
                # to the gradient where the motion began
                if moved and not carried(d, -dt, h, h) > 0.0:
                    return np.intp(p), left, behind
                if strain:
                    plus_one(ds, dt, h, 1.0, a)
                mean = 0.0
                if means > 0:
                    cell = cells_at + dot(d, i, cell_step)
                    if centres:
                        cell += centre_cell(lines, i, n, degree, x, cell_step)
                    if taken:
                        take(ds, F, p, f)
                        volume = vp * determinant(ds, f)
                        grown = determinant(ds, a) if kind == LAW else dt * trace(ds, h)
                        if centres:
                            add_at(cell, volume)
                            add_at(cell + 8, volume * grown)
                        else:
                            add_shares(d, cell, cell_step, n, L, volume, grown)
                        continue
                    mean = number_at(cell + 8) if centres else mean_of(d, cell, cell_step, n, L)
                if velocity:
                    for k in range(d):
                        # by forces alone, and as the mapping has it
                        pushed = v[p, k] + dv[k]
                        mapped = share * pushed + (1.0 - share) * v_new[k]
                        if affine or share < 1.0:
                            both = pushed + mapped
                            if not strain:
                                # strains follow the new velocities, see `energies.mapping_loss`
                                both -= dv[k]
                            projected += mp * (pushed - mapped) * both
                        v[p, k] = v_new[k] if affine else mapped
                        if record:
                            acceleration[p, k] = dv[k] / dt
                    if apic:
                        # moments; where the point scatters its functions divide them
                        take_moments(d, cut, i, n, S, x, places, B, v_new, C, p)
                    if tpic:
                        keep(d, C, p, h, 1.0)
                if strain:
                    if umat:
                        take(d, F, p, D)
                    deformed(ds, a, F, p, f)
                    J, stretched = determinant(ds, f), determinant(ds, a)
                    if not (J > 0.0 and stretched > 0.0):
                        return np.intp(p), left, behind
                    ratio = 1.0
                    if kind in (SMALL, JAUMANN):
                        # F-bar: the law sees the mean's change of volume. In "usf" the strain of
                        # the first step takes no time.
                        shared = used and dt > 0.0
                        plus_one(ds, 1.0, h, (mean / dt - trace(ds, h)) / ds if shared else 0.0, u)
                    elif used:
                        q = mean / stretched
                        if not q > 0.0:
                            return np.intp(p), left, behind
                        scaled(a, root(ds, q))
                        J_bar[p] *= mean
                        ratio = J / J_bar[p]
                    which_law = np.intp(0) if single else np.intp(which[p])
                    if kind == NEO:
                        lmbda, mu = parameters[which_law, 0], parameters[which_law, 1]
                        neo_hookean(ds, f, J, lmbda, mu, t)
                    elif umat:
                        if not umat_stress(
                            d, kind == JAUMANN, points[16], law, which_law, dt, u, D, a,
                            J / stretched, X, p, state, internal, tau_old, e_out, t,
                        ):  # fmt: skip
                            return np.intp(p), left, behind
                    else:
                        take_symmetric(d, 3, state, p, y)
                        if kind == LAW:
                            transform(d, a, y)
                        elif kind == SMALL:
                            add_symmetric(d, dt, u, y)
                        else:
                            # the increment by the middle of the step, and the turn of its spin
                            if not carried(ds, 0.5 * dt, u, u) > 0.0:
                                return np.intp(p), left, behind
                            turned(d, dt, u, y)
                            add_symmetric(d, dt, u, y)
                        spectrum(d, y, r, P, D)
                        if kind == LAW:
                            if d == 2:
                                # by the determinant: a difference of eigenvalues would cancel
                                r[2] = determinant(2, y) / r[1]
                            if not (r[2] > 0.0 and (d == 2 or r[0] > 0.0)):
                                return np.intp(p), left, behind
                        if d == 2:
                            # across the plane, kept as the law has it
                            trial[0] = e_out[p]
                            if ring:
                                trial[0] += logarithm(a[2, 2]) if kind == LAW else dt * u[2, 2]
                                e_out[p] = trial[0]
                        for k in range(3 - d, 3):
                            trial[k] = 0.5 * logarithm(r[k]) if kind == LAW else r[k]
                        for k in range(3):
                            e[k] = trial[k]
                        offset = (np.intp(p) if stride else which_law) * parameters.shape[1] * 8
                        inner = inner_at + 8 * np.intp(p) * internal.shape[1]
                        status = call_law(
                            addresses[which_law], parameters_at + offset, e_at, inner, scratch_at,
                            tau_at, tangent_at,
                        )  # fmt: skip
                        if status != 0:
                            return np.intp(p), left, behind
                        for k in range(internal.shape[1]):
                            internal[p, k] = scratch[k]
                        if e[0] != trial[0] or e[1] != trial[1] or e[2] != trial[2]:
                            if d == 2:
                                e_out[p] = e[0]
                            for k in range(3 - d, 3):
                                if kind == LAW:
                                    r[k] *= exponential(2.0 * (e[k] - trial[k]))
                                else:
                                    r[k] = e[k]
                            combine(d, r, P, D, y)
                        keep_symmetric(d, 3, state, p, y)
                        combine(d, tau, P, D, t)
                        if d == 2:
                            t[2, 2] = tau[0]
                            if record:
                                state[p, 2] = math.exp(2.0 * e[0]) if kind == LAW else e[0]
                        if used and kind != JAUMANN:
                            scaled(t, ratio)
                    if kind == JAUMANN:
                        # Kirchhoff's of Cauchy's
                        scaled(t, J)
                    if kind != SMALL and (kind != NEO or record):
                        # the rate by the middle of the step
                        carried(ds, 0.5 * dt, h, h)
                    if kind != NEO:
                        take_symmetric(d, d, tau_old, p, y)
                        if ring:
                            y[2, 2] = tau_old[p, 3]
                        work += vp * (contracted(ds, y, h) + contracted(ds, t, h))
                    if kind != NEO or record:
                        keep_symmetric(d, d, tau_old, p, t)
                        if ring:
                            tau_old[p, 3] = t[2, 2]
                    if record:
                        last_work += vp * contracted(ds, t, h)
                        V[p] = J * vp
                        q = 1.0 if kind == SMALL else 1.0 / J
                        keep(d, stress, p, t, q)
                        stress[p, 2, 2] = q * t[2, 2]
                if same == 1:
                    if affine:
                        affine_columns(d, apic, cut, mp, C, p, i, n, S, x, places, K)
                    scatter(
                        d, out_at + base + second, step, i, n, S, dS, x, places, True, False,
                        affine > 0, 0, force, mp, momentum_vector(d, mp, v[p], 0.0), K, T[0], T,
                    )  # fmt: skip
                if same == 2:
                    force_vectors(d, -vp, t, T)
                    G = force_vector(d, 1.0, g)
                    if ring:
                        G = axpy(-vp * t[2, 2] / x[0], radial, G)
                    scatter(
                        d, out_at + base, step, i, n, S, dS, x, places, False, True, False, 0,
                        force, mp, T[0], K, G, T,
                    )  # fmt: skip
                if move:
                    if tpic:
                        # the gradient by where the points go
                        take(d, C, p, u)
                        carried(d, dt, u, u)
                        keep(d, C, p, u, 1.0)
                    way = 0.0
                    for k in range(d):
                        going = dt * v_new[k]
                        if general and averaged:
                            going = inside_sides(held, k, start[k], end[k], x[k], reach[k], going)
                        x[k] += going
                        X[p, k] = x[k]
                        way = max(way, abs(v_new[k]) * fine[k] * dt)
                    # the others ask where they scatter
                    if (general or not (new and spread)) and not inside(d, x, start, end):
                        return np.intp(p), left, behind
                    if not alike:
                        outer += dot(d, g, v_new)
                    if averaged:
                        r[0] = r[1] = r[2] = 1.0
                        take(d, F, p, f)
                        if growth == by_stretch and not stretches(d, f, r):
                            return np.intp(p), left, behind
                        if growth == by_volume:
                            r[0] = r[1] = r[2] = root(d, determinant(d, f))
                        growing = -np.inf
                        for k in range(d):
                            growing = max(growing, (r[k] * half0[p, k] - reach[k]) * fine[k])
                            reach[k] = r[k] * half0[p, k]
                            half[p, k] = reach[k]
                        way += growing
                    fastest = max(fastest, way)
            if new and spread:
                if general:
                    n = locate(lines, uniform, degree, x, reach, i, S, dS, part, slope)
                elif not locate_in_middle(
                    d, degree, averaged, x, reach, start, per_length, final, i, S, dS
                ):
                    if not inside(d, x, start, end):
                        return np.intp(p), left, behind
                    if kind == NEO and strain and advance:
                        keep_symmetric(d, d, tau_old, p, t)
                        if ring:
                            tau_old[p, 3] = t[2, 2]
                    skipped[1, behind] = rows[index]
                    behind += 1
                    continue
                if not within(d, i, n, low, top):
                    return np.intp(p), left, behind
                G = force_vector(d, 1.0, g)
                if new == 2:
                    if not (strain and advance):
                        take_symmetric(d, d, tau_old, p, t)
                        if ring:
                            t[2, 2] = tau_old[p, 3]
                    force_vectors(d, -vp, t, T)
                    if ring:
                        G = axpy(-vp * t[2, 2] / x[0], radial, G)
                        if averaged:
                            radial_slopes(
                                lines[0], uniform, degree, i[0], n[0], x[0], reach[0], dS[0],
                                part, slope,
                            )  # fmt: skip
                if affine:
                    affine_columns(d, apic, cut, mp, C, p, i, n, S, x, places, K)
                scatter(
                    d, out_at + dot(d, i, step), step, i, n, S, dS, x, places, True, new == 2,
                    affine > 0, mass_apart, force, mp, momentum_vector(d, mp, v[p], mp), K, G, T,
                )  # fmt: skip
        done[0] += 0.5 * dt * work
        done[1] += dt * outer
        done[2] = max(done[2], fastest)
        done[6] += dt * last_work
        done[7] += 0.5 * projected
        return -1, left, behind

    return run
