"""Compiled loops of stencils of splines on leaves, at points or averaged over domains.

The average over a domain is a sum over the leaves it overlaps. Each summand is the average of the
leaf's splines over the overlap, times the overlap's share of the domain. Splines are products of
splines of one direction, and two Gauss points per direction integrate cubic polynomials exactly.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from dolfinmpm.basis.bspline import spline_weights
from dolfinmpm.basis.leafstencils import place
from dolfinmpm.grid.linecells import rounding

__all__ = ["fill_spline_stencils", "leaf_integrals"]


@numba.njit(cache=True, error_model="numpy")
def _average(knots, degree, x, half, S, dS, dR, part, slope):
    """Averages over the part of a domain in a leaf, in one direction; returns length and middle.

    Args:
        knots: Knots around the leaf (m).
        x, half: Position and half-length of the domain (m).
        S, dS: Written: averages of splines (-) and slopes (1/m).
        dR: Written: averages of the slopes times the coordinate (-).
        part, slope: Scratch arrays, degree + 1 numbers each.
    """
    # around a leaf, the knots are a line of which the leaf is the middle cell
    a, b = knots[degree - 1], knots[degree]
    if half == 0.0:
        least = rounding(a, b)
        if abs(x - a) < least:
            x = a
        if abs(x - b) < least:
            x = b
        spline_weights(knots, degree - 1, degree, x, S, dS)
        for i in range(degree + 1):
            dR[i] = x * dS[i]
        return 1.0, x
    a, b = max(a, x - half), min(b, x + half)
    middle, reach = 0.5 * (a + b), 0.5 * (b - a) / math.sqrt(3.0)
    for i in range(degree + 1):
        S[i] = dS[i] = dR[i] = 0.0
    for side in range(2):
        at = middle - reach if side == 0 else middle + reach
        spline_weights(knots, degree - 1, degree, at, part, slope)
        for i in range(degree + 1):
            S[i] += 0.5 * part[i]
            dS[i] += 0.5 * slope[i]
            dR[i] += 0.5 * at * slope[i]
    return b - a, middle


@numba.njit(cache=True, error_model="numpy")
def fill_spline_stencils(
    x, half, axisymmetric, knots, order, groups, begin, leaves, corners, node_start, nodes,
    value_start, N, dN,
):  # fmt: skip
    """Write values and gradients of all groups.

    Args:
        x, half: Positions and half-lengths (m), shape (points, d).
        axisymmetric: Whether radial slopes are averages over domains that go around the axis: the
            mean of r ∂N/∂r over the mean radius.
        knots: Knots around the leaves (m), shape (leaves, d, 2 degree).
        begin, leaves: Leaves of each point.
        corners: Splines of the leaves, the last direction fastest, shape (leaves, (degree + 1)^d).
    """
    d, degree = x.shape[1], knots.shape[2] // 2
    n, each = degree + 1, corners.shape[1]
    S, dS, dR = np.empty((d, n)), np.empty((d, n)), np.empty((d, n))
    part, slope = np.empty(n), np.empty(n)
    at_k = np.empty(d, np.int64)
    for g in range(groups.size - 1):
        m = node_start[g + 1] - node_start[g]
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            to = value_start[g] + (position - groups[g]) * m
            for a in range(m):
                N[to + a] = 0.0
                for k in range(d):
                    dN[to + a, k] = 0.0
            ring = axisymmetric and half[p, 0] > 0.0
            total, radius = 0.0, 0.0
            for at in range(begin[p], begin[p + 1]):
                cell, share, mean = leaves[at], 1.0, 0.0
                for k in range(d):
                    length, middle = _average(
                        knots[cell, k], degree, x[p, k], half[p, k], S[k], dS[k], dR[k], part, slope
                    )
                    share *= length
                    if k == 0:
                        mean = middle
                total += share
                radius += share * mean
                for a in range(each):
                    rest, value = a, share
                    for k in range(d - 1, -1, -1):
                        at_k[k] = rest % n
                        rest //= n
                        value *= S[k, at_k[k]]
                    node = place(nodes, node_start[g], node_start[g + 1], corners[cell, a])
                    node += to - node_start[g]
                    N[node] += value
                    for k in range(d):
                        value = dR[k, at_k[k]] if k == 0 and ring else dS[k, at_k[k]]
                        value *= share
                        for e in range(d):
                            if e != k:
                                value *= S[e, at_k[e]]
                        dN[node, k] += value
            for a in range(m):
                N[to + a] /= total
                for k in range(d):
                    dN[to + a, k] /= radius if k == 0 and ring else total


@numba.njit(cache=True, error_model="numpy")
def leaf_integrals(knots, integrals):
    """Write the integrals of the splines over their leaves in each direction (m).

    Args:
        knots: Knots around the leaves (m), shape (leaves, d, 2 degree).
        integrals: Written, shape (leaves, d, degree + 1).
    """
    degree = knots.shape[2] // 2
    S, dS, dR = np.empty(degree + 1), np.empty(degree + 1), np.empty(degree + 1)
    part, slope = np.empty(degree + 1), np.empty(degree + 1)
    for c in range(knots.shape[0]):
        for k in range(knots.shape[1]):
            a, b = knots[c, k, degree - 1], knots[c, k, degree]
            middle, half = 0.5 * (a + b), 0.5 * (b - a)
            _average(knots[c, k], degree, middle, half, S, dS, dR, part, slope)
            for i in range(degree + 1):
                integrals[c, k, i] = (b - a) * S[i]
