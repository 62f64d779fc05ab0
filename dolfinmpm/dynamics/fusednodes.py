"""Sums of one point over the nodes that it sees, in two and three dimensions, for compiled loops.

Functions of a point are products of functions per direction. Sums go line by line: over the nodes
of a line, over the lines of a layer, and in three dimensions over the layers. A node has vectors of
four numbers, see `dolfinmpm.dynamics.passes.Columns`.

Names of arguments that all functions share:

- d: dimension of space;
- i, n: first function and number of functions that the point sees, per direction;
- S, dS: values and slopes (1/m) of these functions, per direction;
- x: position of the point (m); places: positions of the functions (m), per direction;
- at, step: address of the point's first node, and bytes from node to node, per direction.
"""

from __future__ import annotations

import numba
import numpy as np

from dolfinmpm._platform.simd import add_at, axpy, four, lanes, load, number_at, times
from dolfinmpm._platform.simd import store as put
from dolfinmpm.basis.lineweights import (
    cell_shares,
    line_shares,
    line_weights,
    overlapped,
    ring_slopes,
)
from dolfinmpm.basis.uniformweights import middle_weights
from dolfinmpm.dynamics.smalltensors import INLINE

__all__ = [
    "add_shares",
    "affine_columns",
    "centre_cell",
    "force_vector",
    "force_vectors",
    "gather",
    "locate",
    "locate_in_middle",
    "mean_of",
    "momentum_vector",
    "radial_slopes",
    "scatter",
    "shares_of",
    "take_moments",
    "within",
]


@numba.njit(cache=True, error_model="numpy")
def locate(lines, uniform, degree, x, half, i, S, dS, part, slope):
    """Find the functions that a point sees, wherever it is; returns their numbers."""
    n = np.zeros(3, np.intp)
    for k in range(len(lines)):
        i[k], cells = overlapped(lines[k], uniform, x[k], half[k])
        line_weights(
            lines[k], uniform, degree, i[k], cells, x[k], half[k], S[k], dS[k], part, slope
        )
        n[k] = cells + degree
    return n[0], n[1], n[2]


@numba.njit(**INLINE)
def locate_in_middle(d, degree, averaged, x, half, start, per_length, last, i, S, dS):
    """Find the functions that a point sees; False where `middle_weights` does not know them."""
    # one call per direction: the compiler would not unroll a loop as large as this
    known, i[0] = middle_weights(
        degree, averaged, x[0], half[0], start[0], per_length[0], last[0], S[0], dS[0]
    )
    more, i[1] = middle_weights(
        degree, averaged, x[1], half[1], start[1], per_length[1], last[1], S[1], dS[1]
    )
    known = known and more
    if d == 3:
        more, i[2] = middle_weights(
            degree, averaged, x[2], half[2], start[2], per_length[2], last[2], S[2], dS[2]
        )
        known = known and more
    return known


@numba.njit(cache=True, error_model="numpy")
def radial_slopes(line, uniform, degree, first, count, x, half, dS, part, slope):
    """Averages of radial slopes over the domain of a ring; see `ring_slopes`.

    Args:
        count: Number of functions, with those of cells behind the domain.
        others: See `ring_slopes`.
    """
    cells = count - degree
    while cells > 1 and line[first + cells - 1] >= x + half:
        cells -= 1
        dS[cells + degree] = 0.0
    ring_slopes(line, uniform, degree, first, cells, x, half, dS, part, slope)


@numba.njit(**INLINE)
def momentum_vector(d, scale, a, mass):
    """Where a node's vector has momenta, and in three dimensions a mass."""
    if d == 2:
        return four(scale * a[0], scale * a[1], 0.0, 0.0)
    return four(scale * a[0], scale * a[1], scale * a[2], mass)


@numba.njit(**INLINE)
def force_vector(d, scale, a):
    """Where a node's vector has forces: behind momenta, or in a vector of their own."""
    if d == 2:
        return four(0.0, 0.0, scale * a[0], scale * a[1])
    return four(scale * a[0], scale * a[1], scale * a[2], 0.0)


@numba.njit(**INLINE)
def force_vectors(d, scale, A, T):
    """`force_vector` of the columns of a symmetric tensor."""
    for k in range(d):
        T[k] = force_vector(d, scale, A[k])


@numba.njit(**INLINE)
def within(d, i, n, low, top):
    """Whether nodes from low on, and before top, have all functions that a point sees."""
    found = True
    for k in range(d):
        found = found and i[k] >= low[k] and i[k] + n[k] <= top[k]
    return found


@numba.njit(**INLINE)
def gather(
    d, at, step, i, n, S, dS, x, places, gradient, moments, change, Y, H, B, v, dv, h
):  # fmt: skip
    """Sum up what nodes have at a point.

    Args:
        d, at, step, i, n, S, dS, x, places: See above.
        gradient, moments: Whether H and B are asked for.
        change: Bytes to changes of velocity if these are asked for and stand in a vector of
            their own, else 0.
        Y, H: Room.
        B: Written: Σ v N (x_a − x)ₖ, by direction k.
        v, dv, h: Written: velocity (m/s), its change (m/s), and its gradient (1/s).
    """
    row, line = d - 2, d - 1
    nothing = four(0.0, 0.0, 0.0, 0.0)
    Y[0] = Y[1] = nothing
    for k in range(d):
        H[k] = B[k] = nothing
    for a in range(n[0] if d == 3 else 1):
        R = W = G = Q = K = M = nothing
        layer = at + a * step[0] if d == 3 else at
        for b in range(n[row]):
            here = layer + b * step[row]
            r = w = q = m = nothing
            for c in range(n[line]):
                Z = load(here + c * step[line])
                r = axpy(S[line, c], Z, r)
                if gradient:
                    q = axpy(dS[line, c], Z, q)
                if moments:
                    m = axpy(S[line, c] * (places[line][i[line] + c] - x[line]), Z, m)
                if change:
                    w = axpy(S[line, c], load(here + c * step[line] + change), w)
            R = axpy(S[row, b], r, R)
            if change:
                W = axpy(S[row, b], w, W)
            if gradient:
                G, Q = axpy(dS[row, b], r, G), axpy(S[row, b], q, Q)
            if moments:
                K = axpy(S[row, b] * (places[row][i[row] + b] - x[row]), r, K)
                M = axpy(S[row, b], m, M)
        s = S[0, a] if d == 3 else 1.0
        Y[0], Y[1] = axpy(s, R, Y[0]), axpy(s, W, Y[1])
        if gradient:
            H[row], H[line] = axpy(s, G, H[row]), axpy(s, Q, H[line])
            if d == 3:
                H[0] = axpy(dS[0, a], R, H[0])
        if moments:
            B[row], B[line] = axpy(s, K, B[row]), axpy(s, M, B[line])
            if d == 3:
                B[0] = axpy(s * (places[0][i[0] + a] - x[0]), R, B[0])
    if d == 2:
        v[0], v[1], dv[0], dv[1] = lanes(Y[0])
    else:
        v[0], v[1], v[2], _ = lanes(Y[0])
        dv[0], dv[1], dv[2], _ = lanes(Y[1])
    for k in range(d):
        h[0, k], h[1, k], h[2, k], _ = lanes(H[k])


@numba.njit(**INLINE)
def scatter(
    d, at, step, i, n, S, dS, x, places, momenta, forces, affine, mass_apart, force, mass, P, K, G,
    T,
):  # fmt: skip
    """Add what a point has to the sums at its nodes.

    Args:
        d, at, step, i, n, S, dS, x, places: See above.
        momenta, forces, affine: Whether P, G and T, and K count.
        mass_apart: Bytes to a mass that has no place in the vectors, or 0 without one.
        force: Bytes to forces that stand in a vector of their own.
        mass: The point's mass (kg).
        P, K: Momentum (kg m/s), and its slopes by direction (kg/s).
        G, T: Force (N), and stress times volume by direction (N m).
    """
    row, line = d - 2, d - 1
    nothing = four(0.0, 0.0, 0.0, 0.0)
    for a in range(n[0] if d == 3 else 1):
        s, A, layer = 1.0, P, at
        g = t = u = nothing
        if d == 3:
            s, layer = S[0, a], at + a * step[0]
            if affine:
                A = axpy(places[0][i[0] + a] - x[0], K[0], P)
        if forces:
            g, t, u = times(s, G), times(s, T[row]), times(s, T[line])
            if d == 3:
                g = axpy(dS[0, a], T[0], g)
        for b in range(n[row]):
            here = layer + b * step[row]
            w = s * S[row, b]
            M = N = R = Q = nothing
            if momenta:
                M = A
                if affine:
                    M = axpy(places[row][i[row] + b] - x[row], K[row], M)
                    N = times(w, K[line])
                M = times(w, M)
            if forces:
                R, Q = axpy(dS[row, b], t, times(S[row, b], g)), times(S[row, b], u)
            if d == 2:
                # both are in one vector
                M = axpy(1.0, M, R)
            for c in range(n[line]):
                node = here + c * step[line]
                if d == 2 or momenta:
                    Z = axpy(S[line, c], M, load(node))
                    if d == 2 and forces:
                        Z = axpy(dS[line, c], Q, Z)
                    if affine:
                        Z = axpy(S[line, c] * (places[line][i[line] + c] - x[line]), N, Z)
                    put(node, Z)
                if d == 3 and forces:
                    Z = axpy(S[line, c], R, load(node + force))
                    put(node + force, axpy(dS[line, c], Q, Z))
                if mass_apart:
                    add_at(node + mass_apart, S[line, c] * (w * mass))


# -- moments of the functions, which affine velocities are divided by -----------


@numba.njit(error_model="numpy", fastmath=INLINE["fastmath"])
def spread(S, places, first, count, x):
    """Second moment Σ S (x_a − x)² of the functions in one direction (m²)."""
    total = 0.0
    for a in range(count):
        total += S[a] * (places[first + a] - x) ** 2
    return total


@numba.njit(error_model="numpy", fastmath=INLINE["fastmath"])
def drift(S, places, first, count, x):
    """First moment Σ S (x_a − x) (m): 0 but for domains that the grid's edge cuts."""
    total = 0.0
    for a in range(count):
        total += S[a] * (places[first + a] - x)
    return total


@numba.njit(**INLINE)
def take_moments(d, cut, i, n, S, x, places, B, v, C, p):
    """Set the affine part of point p to the moments of its velocities about their mean v.

    See `affine_columns` for the arguments, and `gather` for B.
    """
    for k in range(d):
        if cut:
            B[k] = axpy(
                -drift(S[k], places[k], i[k], n[k], x[k]), momentum_vector(d, 1.0, v, 0.0), B[k]
            )
        first, second, third, _ = lanes(B[k])
        C[p, 0, k], C[p, 1, k] = first, second
        if d == 3:
            C[p, 2, k] = third


@numba.njit(**INLINE)
def affine_columns(d, apic, cut, mass, C, p, i, n, S, x, places, K):
    """Write mass times the columns of a point's affine part, as gradients.

    The moments B of "apic" are multiplied by D⁻¹, with D the second moments of the functions. D is
    A + m mᵀ, with A diagonal and m the first moments; its inverse is that of Sherman and Morrison.

    Args:
        d, i, n, S, x, places: See above.
        apic: Whether the affine part is that of "apic".
        cut: Whether the grid's edge may cut domains, so that m is not 0.
        mass: The mass (kg).
        C, p: Affine parts of all points, and number of the point.
        K: Written.
    """
    for k in range(d):
        if d == 2:
            K[k] = four(C[p, 0, k], C[p, 1, k], 0.0, 0.0)
        else:
            K[k] = four(C[p, 0, k], C[p, 1, k], C[p, 2, k], 0.0)
    if not apic:
        for k in range(d):
            K[k] = times(mass, K[k])
        return
    if not cut:
        for k in range(d):
            K[k] = times(mass / spread(S[k], places[k], i[k], n[k], x[k]), K[k])
        return
    along, size = four(0.0, 0.0, 0.0, 0.0), 1.0
    for k in range(d):
        m = drift(S[k], places[k], i[k], n[k], x[k])
        A = spread(S[k], places[k], i[k], n[k], x[k]) - m * m
        along, size = axpy(m / A, K[k], along), size + m * m / A
    along = times(-1.0 / size, along)
    for k in range(d):
        m = drift(S[k], places[k], i[k], n[k], x[k])
        A = spread(S[k], places[k], i[k], n[k], x[k]) - m * m
        K[k] = times(mass / A, axpy(m, along, K[k]))


# -- means of F-bar over cells, or over splines one degree lower ----------------


@numba.njit(cache=True, error_model="numpy")
def centre_cell(lines, i, n, degree, x, step):
    """Bytes from the first cell that a point's domain overlaps to that of its centre."""
    total = 0
    for k in range(len(lines)):
        own = 0
        while own < n[k] - degree - 1 and x[k] >= lines[k][i[k] + own + 1]:
            own += 1
        total += own * step[k]
    return total


@numba.njit(**INLINE)
def shares_of(
    d, general, lines, uniform, degree, per_length, x, half, i, n, dS, L, room, part, slope
):  # fmt: skip
    """Write a point's shares in cells, or in splines one degree lower, per direction."""
    if general:
        for k in range(d):
            line_shares(
                lines[k], uniform, degree, i[k], n[k] - degree, x[k], half[k], L[k], room, part,
                slope,
            )  # fmt: skip
        return
    if degree == 1:
        for k in range(d):
            cell_shares(lines[k], i[k], n[k] - 1, x[k], half[k], L[k])
        return
    # slopes of splines are differences of those one degree lower
    for k in range(d):
        carried = 0.0
        for a in range(n[k] - 1):
            carried -= dS[k, a] / per_length[k]
            L[k, a] = carried


@numba.njit(**INLINE)
def add_shares(d, at, step, n, L, volume, change):
    """Add a point's volume, and volume times its change, to the sums of its cells."""
    row, line = d - 2, d - 1
    for a in range(n[0] - 1 if d == 3 else 1):
        for b in range(n[row] - 1):
            here, w = at + b * step[row], L[row, b] * volume
            if d == 3:
                here, w = here + a * step[0], L[0, a] * w
            for c in range(n[line] - 1):
                add_at(here + c * step[line], L[line, c] * w)
                add_at(here + c * step[line] + 8, L[line, c] * w * change)


@numba.njit(**INLINE)
def mean_of(d, at, step, n, L):
    """The mean change of volume of a point's cells, weighted with its shares."""
    row, line = d - 2, d - 1
    mean = 0.0
    for a in range(n[0] - 1 if d == 3 else 1):
        for b in range(n[row] - 1):
            here, w = at + b * step[row], L[row, b]
            if d == 3:
                here, w = here + a * step[0], L[0, a] * w
            total = 0.0
            for c in range(n[line] - 1):
                total += L[line, c] * number_at(here + c * step[line] + 8)
            mean += w * total
    return mean
