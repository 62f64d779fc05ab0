"""Compiled loops of stencils on leaves: linear functions, at points or averaged over domains.

The average over a domain is a sum over the leaves it overlaps. Each summand is the multilinear
function at the middle of the overlap, times the overlap's share of the domain: the functions are
products of linear functions of one direction, so that this is exact.
"""

from __future__ import annotations

import numba
import numpy as np

from dolfinmpm.grid.linecells import rounding

__all__ = ["fill_stencils", "group_nodes", "list_hashes", "place", "starts_of_lists"]


@numba.njit(cache=True, error_model="numpy")
def list_hashes(begin, leaves, hashes):
    """Write a number per list of leaves that is the same for equal lists."""
    for p in range(begin.size - 1):
        h = np.uint64(1469598103934665603)
        for at in range(begin[p], begin[p + 1]):
            h = (h ^ np.uint64(leaves[at] + 1)) * np.uint64(1099511628211)
        hashes[p] = h


@numba.njit(cache=True, error_model="numpy")
def starts_of_lists(order, begin, leaves, starts):
    """Mark the positions at which the list of leaves differs from that before."""
    for position in range(order.size):
        p = order[position]
        starts[position] = True
        if position == 0:
            continue
        q = order[position - 1]
        number = begin[p + 1] - begin[p]
        if begin[q + 1] - begin[q] != number:
            continue
        same = True
        for a in range(number):
            same = same and leaves[begin[p] + a] == leaves[begin[q] + a]
        starts[position] = not same


@numba.njit(cache=True, error_model="numpy")
def group_nodes(order, groups, begin, leaves, corners, node_start, nodes):
    """Write the nodes of every group in increasing order; only count them without room."""
    most = 1
    for g in range(groups.size - 1):
        p = order[groups[g]]
        most = max(most, (begin[p + 1] - begin[p]) * corners.shape[1])
    room = np.empty(most, np.int64)
    for g in range(groups.size - 1):
        p = order[groups[g]]
        number = 0
        for at in range(begin[p], begin[p + 1]):
            for a in range(corners.shape[1]):
                room[number] = corners[leaves[at], a]
                number += 1
        own = room[:number]
        own.sort()
        count = 0
        for a in range(number):
            if a == 0 or own[a] != own[a - 1]:
                if nodes.size:
                    nodes[node_start[g] + count] = own[a]
                count += 1
        if not nodes.size:
            node_start[g + 1] = node_start[g] + count


@numba.njit(cache=True, error_model="numpy")
def place(nodes, first, end, node):
    """Position of a node in an increasing list."""
    while end - first > 1:
        middle = (first + end) // 2
        if nodes[middle] <= node:
            first = middle
        else:
            end = middle
    return first


@numba.njit(cache=True, error_model="numpy")
def fill_stencils(
    x, half, axisymmetric, low, high, order, groups, begin, leaves, corners, node_start, nodes,
    value_start, N, dN,
):  # fmt: skip
    """Write values and gradients of all groups.

    Args:
        x, half: Positions and half-lengths (m), shape (points, d).
        axisymmetric: Whether radial slopes are averages over domains that go around the axis: the
            mean of r ∂N/∂r over the mean radius.
        low, high: Corners of the leaves (m), shape (leaves, d).
        begin, leaves: Leaves of each point.
        corners: Nodes of the leaves, the last direction fastest, shape (leaves, 2^d).
    """
    d = x.shape[1]
    each = corners.shape[1]
    middle = np.empty(d)
    S, slope = np.empty((d, 2)), np.empty((d, 2))
    for g in range(groups.size - 1):
        m = node_start[g + 1] - node_start[g]
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            to = value_start[g] + (position - groups[g]) * m
            for a in range(m):
                N[to + a] = 0.0
                for k in range(d):
                    dN[to + a, k] = 0.0
            total, radius = 0.0, 0.0
            for at in range(begin[p], begin[p + 1]):
                cell, part = leaves[at], 1.0
                for k in range(d):
                    a, b = low[cell, k], high[cell, k]
                    middle[k] = x[p, k]
                    if half[p, k] > 0.0:
                        left, right = max(x[p, k] - half[p, k], a), min(x[p, k] + half[p, k], b)
                        part *= right - left
                        middle[k] = 0.5 * (left + right)
                    S[k, 1] = (middle[k] - a) / (b - a)
                    least = rounding(a, b) / (b - a)
                    if half[p, k] == 0.0 and abs(S[k, 1]) < least:
                        S[k, 1] = 0.0
                    if half[p, k] == 0.0 and abs(S[k, 1] - 1.0) < least:
                        S[k, 1] = 1.0
                    S[k, 0] = 1.0 - S[k, 1]
                    slope[k, 1] = 1.0 / (b - a)
                    slope[k, 0] = -slope[k, 1]
                total += part
                radius += part * middle[0]
                for a in range(each):
                    value = part
                    for k in range(d):
                        value *= S[k, (a >> (d - 1 - k)) & 1]
                    node = place(nodes, node_start[g], node_start[g + 1], corners[cell, a])
                    node += to - node_start[g]
                    N[node] += value
                    for k in range(d):
                        value = part * slope[k, (a >> (d - 1 - k)) & 1]
                        for e in range(d):
                            if e != k:
                                value *= S[e, (a >> (d - 1 - e)) & 1]
                        if k == 0 and axisymmetric and half[p, 0] > 0.0:
                            value *= middle[0]
                        dN[node, k] += value
            for a in range(m):
                N[to + a] /= total
                for k in range(d):
                    if k == 0 and axisymmetric and half[p, 0] > 0.0:
                        dN[to + a, k] /= radius
                    else:
                        dN[to + a, k] /= total
