"""Compiled loops of the bases on rectangular grids: overlapped cells, and rows of stencils."""

from __future__ import annotations

import functools

import numba
import numpy as np

from dolfinmpm.basis.gimp import domain_weights
from dolfinmpm.basis.lineweights import (
    cell_of,
    line_weights,
    overlapped,
    ring_slopes,
    snapped,
)
from dolfinmpm.grid.linecells import rounding

__all__ = ["group_keys", "largest_reach", "overlaps", "stencil_loop"]


@numba.njit(cache=True, error_model="numpy")
def overlaps(x, half, lines, line_start, uniform, origin, low, count):
    """Write the first overlapped cell, counted from the origin, and the number of overlapped cells.

    Both are written per point and direction.
    """
    for p in range(x.shape[0]):
        for d in range(x.shape[1]):
            line = lines[line_start[d] : line_start[d + 1]]
            first, number = overlapped(line, uniform, x[p, d], half[p, d])
            low[p, d], count[p, d] = first - origin[d], number


@numba.njit(cache=True, error_model="numpy")
def largest_reach(x, half, averaged, lines, line_start, uniform):
    """Largest reach of the points' domains beyond their own cells, and largest span in cells.

    Args:
        averaged: Whether points have domains. A point without a domain on a grid line may be
            seen from the cell below.

    Returns:
        Layers of cells, largest number of cells that a domain spans, and the point with this
        domain.
    """
    layers, most, worst = 0, 1, 0
    for d in range(x.shape[1]):
        line = lines[line_start[d] : line_start[d + 1]]
        n = line.size - 1
        scale = n / (line[n] - line[0])
        for p in range(x.shape[0]):
            at, number = overlapped(line, uniform, x[p, d], half[p, d] if averaged else 0.0)
            # same result as `Lattice.cells_at`
            own = int(np.floor((x[p, d] - line[0]) * scale)) if uniform else -1
            own = min(max(own, 0), n - 1) if uniform else cell_of(line, False, x[p, d])
            layers = max(layers, own - at, at + number - 1 - own)
            if number > most:
                most, worst = number, p
            if not averaged and at > 0 and layers < 1:
                layers = int(x[p, d] - line[at] < rounding(line[at], line[at + 1]))
    return layers, most, worst


@numba.njit(cache=True, error_model="numpy")
def group_keys(low, count, table_shape, key):
    """Write a number per point that is the same for points with the same overlapped cells."""
    for p in range(low.shape[0]):
        k, c = 0, 0
        for d in range(low.shape[1]):
            k = k * table_shape[d] + low[p, d]
            c = c * 64 + count[p, d]
        # 18 bits have room for 63 cells per direction in 3D
        key[p] = k * 262144 + c


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def _write_products(gdim, S, dS, at, to, N, dN):
    """Write value and slopes of a function: products of those of the directions.

    Args:
        gdim: Number of directions, a constant where this is compiled.
        S, dS: Values and slopes (1/m) of the functions of each direction.
        at: Number of the function in each direction.
        to: Where to write.
        N, dN: Written.
    """
    a, da = S[0, at[0]], dS[0, at[0]]
    if gdim == 1:
        N[to], dN[to, 0] = a, da
        return
    b, db = S[1, at[1]], dS[1, at[1]]
    if gdim == 2:
        N[to], dN[to, 0], dN[to, 1] = a * b, da * b, a * db
        return
    c, dc = S[2, at[2]], dS[2, at[2]]
    N[to] = a * b * c
    dN[to, 0], dN[to, 1], dN[to, 2] = da * b * c, db * a * c, dc * a * b


@functools.cache
def stencil_loop(gdim: int, linear: bool, axisymmetric: bool):
    """The loop that makes stencils; for linear functions it is compiled without splines' code."""

    @numba.njit(cache=True, error_model="numpy")
    def kernel(
        x, half, lines, line_start, origin, node_table, node_shape, cell_table, cell_shape,
        order, groups, low, count, node_start, nodes, value_start, N, dN, cell_start, cells, degree,
        uniform,
    ):  # fmt: skip
        S = np.empty((gdim, 64))
        dS = np.empty((gdim, 64))
        part = np.empty(degree + 1)
        slope = np.empty(degree + 1)
        largest = 1
        for g in range(groups.size - 1):
            largest = max(largest, node_start[g + 1] - node_start[g])
        local = np.empty(largest, np.int64)
        index = np.empty((largest, gdim), np.int64)
        rank = np.empty(largest, np.int64)
        known = True
        for g in range(groups.size - 1):
            p = order[groups[g]]
            m = node_start[g + 1] - node_start[g]
            for a in range(m):
                rest, at, size = a, 0, 1
                for d in range(gdim - 1, -1, -1):
                    index[a, d] = rest % (count[p, d] + degree)
                    rest //= count[p, d] + degree
                    at += size * (low[p, d] + index[a, d])
                    size *= node_shape[d]
                local[a] = node_table[at]
                known = known and local[a] >= 0
            # nodes in increasing order: assembly walks through the matrix rows once
            for a in range(m):
                before = 0
                for b in range(m):
                    if local[b] < local[a]:
                        before += 1
                rank[a] = before
                nodes[node_start[g] + before] = local[a]
            for a in range(cell_start[g + 1] - cell_start[g]):
                rest, at, size = a, 0, 1
                for d in range(gdim - 1, -1, -1):
                    at += size * (low[p, d] + rest % count[p, d])
                    rest //= count[p, d]
                    size *= cell_shape[d]
                cells[cell_start[g] + a] = cell_table[at]
                known = known and cell_table[at] >= 0
            for position in range(groups[g], groups[g + 1]):
                p = order[position]
                for d in range(gdim):
                    line = lines[line_start[d] : line_start[d + 1]]
                    first = origin[d] + low[p, d]
                    if linear:
                        at_x = snapped(line, first, x[p, d], half[p, d])
                        domain_weights(line, first, count[p, d], at_x, half[p, d], S[d], dS[d])
                    else:
                        line_weights(
                            line, uniform, degree, first, count[p, d], x[p, d], half[p, d], S[d],
                            dS[d], part, slope,
                        )  # fmt: skip
                if axisymmetric and half[p, 0] > 0.0:
                    ring_slopes(
                        lines[line_start[0] : line_start[1]], uniform, degree,
                        origin[0] + low[p, 0], count[p, 0], x[p, 0], half[p, 0], dS[0], part, slope,
                    )  # fmt: skip
                start = value_start[g] + (position - groups[g]) * m
                for a in range(m):
                    _write_products(gdim, S, dS, index[a], start + rank[a], N, dN)
        return known

    return kernel
