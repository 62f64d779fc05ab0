"""The tangent of a field on itself: sums over the points' stencils, four nodes at a time."""

from __future__ import annotations

import functools

import numba
import numpy as np

from dolfinmpm._platform.lanes import axpy, load, store, times

__all__ = ["stiffness_kernel"]


@functools.cache
def stiffness_kernel(nc: int, ns: int, gradient_only: bool):
    """The loop of a field on itself: nc components, ns slots (gradients, or values too) each.

    A group's sum between its nodes comes first, then goes into the matrix. At a point that is
    Σ_s φ_as T_is,kr by node a, then Σ_r of these times φ_br, with nodes b side by side in
    registers: rows of all arrays are filled up to whole ones.
    """
    offset = 0 if gradient_only else 1
    width = nc * ns
    wide = (width + 3) // 4

    @numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})
    def kernel(
        begin, end, groups, node_start, nodes, value_start, N, dN, T, row_of, indptr, indices,
        data, prescribed, lift,
    ):  # fmt: skip
        largest = 0
        for g in range(begin, end):
            largest = max(largest, node_start[g + 1] - node_start[g])
        line = 4 * ((largest + 3) // 4)
        phi, K = np.zeros((ns, line)), np.empty((largest, nc, nc, line))
        slope, t = np.zeros((width, 4 * wide)), np.empty((nc, 4 * wide))
        place = np.empty(largest * nc, np.int64)
        phi_at, K_at = phi.ctypes.data, K.ctypes.data
        slope_at, t_at = slope.ctypes.data, t.ctypes.data
        for g in range(begin, end):
            first = node_start[g]
            m = node_start[g + 1] - first
            lots = (m + 3) // 4
            for s in range(ns):
                for b in range(m, 4 * lots):
                    phi[s, b] = 0.0
            for a in range(m):
                for i in range(nc):
                    for k in range(nc):
                        for b in range(4 * lots):
                            K[a, i, k, b] = 0.0
            for position in range(groups[g], groups[g + 1]):
                p = position - groups[begin]
                at = value_start[g] + (position - groups[g]) * m
                for b in range(m):
                    if offset:
                        phi[0, b] = N[at + b]
                    for s in range(ns - offset):
                        phi[offset + s, b] = dN[at + b, s]
                for i in range(width):
                    for k in range(width):
                        slope[i, k] = T[p, i * width + k]
                for a in range(m):
                    for i in range(nc):
                        for v in range(wide):
                            here = slope_at + 32 * (i * ns * wide + v)
                            row = times(phi[0, a], load(here))
                            for s in range(1, ns):
                                row = axpy(phi[s, a], load(here + 32 * s * wide), row)
                            store(t_at + 32 * (i * wide + v), row)
                    for i in range(nc):
                        for k in range(nc):
                            start = K_at + 8 * ((a * nc + i) * nc + k) * line
                            for w in range(lots):
                                total = load(start + 32 * w)
                                for r in range(ns):
                                    four = load(phi_at + 8 * r * line + 32 * w)
                                    total = axpy(t[i, k * ns + r], four, total)
                                store(start + 32 * w, total)
            for a in range(m):
                node, known = nodes[first + a], False
                for i in range(nc):
                    row = row_of[node, i]
                    if row < 0:
                        continue
                    start = indptr[row]
                    if not known:
                        # nodes and columns both increase: one walk along the row, which is
                        # alike for all components of a node
                        known, at = True, start
                        for b in range(m):
                            for k in range(nc):
                                column = row_of[nodes[first + b], k]
                                place[b * nc + k] = -1
                                if column >= 0:
                                    while indices[at] != column:
                                        at += 1
                                    place[b * nc + k] = at - start
                                    at += 1
                    for b in range(m):
                        for k in range(nc):
                            to = place[b * nc + k]
                            if to >= 0:
                                data[start + to] += K[a, i, k, b]
                            else:
                                lift[node, i] += K[a, i, k, b] * prescribed[nodes[first + b], k]

    return kernel
