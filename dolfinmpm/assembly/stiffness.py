"""The tangent of a field by itself: sums over the points' stencils, node by node."""

from __future__ import annotations

import functools

import numba
import numpy as np

from dolfinmpm._platform.simd import axpy, load, store, times
from dolfinmpm.basis.incidence import by_nodes

__all__ = ["stiffness_kernel"]


@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _add_one(ns, offset, m, at, N, dN, t_at, places):
    """Add Σ_r φ_br t_r to the vector of four numbers of each node b, with t in registers."""
    t = load(t_at)
    t1 = load(t_at + 32) if ns > 1 else t
    t2 = load(t_at + 64) if ns > 2 else t
    t3 = load(t_at + 96) if ns > 3 else t
    for b in range(m):
        to, q = places[b], at + b
        total = axpy(N[q] if offset else dN[q, 0], t, load(to))
        if ns > 1:
            total = axpy(dN[q, 1 - offset], t1, total)
        if ns > 2:
            total = axpy(dN[q, 2 - offset], t2, total)
        if ns > 3:
            total = axpy(dN[q, 3 - offset], t3, total)
        store(to, total)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _add_three(ns, offset, m, at, N, dN, t_at, places):
    """`_add_one` for three vectors of four numbers each."""
    t, u, w = load(t_at), load(t_at + 32), load(t_at + 64)
    step = t_at + 96 if ns > 1 else t_at
    t1, u1, w1 = load(step), load(step + 32), load(step + 64)
    step = t_at + 192 if ns > 2 else t_at
    t2, u2, w2 = load(step), load(step + 32), load(step + 64)
    step = t_at + 288 if ns > 3 else t_at
    t3, u3, w3 = load(step), load(step + 32), load(step + 64)
    for b in range(m):
        to, q = places[b], at + b
        phi = N[q] if offset else dN[q, 0]
        x, y, z = axpy(phi, t, load(to)), axpy(phi, u, load(to + 32)), axpy(phi, w, load(to + 64))
        if ns > 1:
            phi = dN[q, 1 - offset]
            x, y, z = axpy(phi, t1, x), axpy(phi, u1, y), axpy(phi, w1, z)
        if ns > 2:
            phi = dN[q, 2 - offset]
            x, y, z = axpy(phi, t2, x), axpy(phi, u2, y), axpy(phi, w2, z)
        if ns > 3:
            phi = dN[q, 3 - offset]
            x, y, z = axpy(phi, t3, x), axpy(phi, u3, y), axpy(phi, w3, z)
        store(to, x)
        store(to + 32, y)
        store(to + 64, z)


@functools.cache
def stiffness_kernel(nc: int, ns: int, gradient_only: bool):
    """The loop for a field by itself, with nc components and ns placeholders per component.

    Placeholders are gradients, or values and gradients. The loop goes through the nodes. For each
    node it goes through the node's points, so that the node's rows are summed in the cache and
    added to the matrix once. For a point and a node a it computes t_r,ik = Σ_s φ_as T_is,kr. For
    each node b it adds Σ_r φ_br t_r. All pairs ik of components are side by side in registers.
    """
    offset = 0 if gradient_only else 1
    width = nc * ns
    wide = (nc * nc + 3) // 4

    @numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})
    def kernel(
        begin, end, groups, node_start, nodes, value_start, N, dN, T, row_of, indptr, indices,
        data, prescribed, lift,
    ):  # fmt: skip
        if node_start[begin] == node_start[end]:
            return
        n = groups[end] - groups[begin]
        # T with the pairs of components innermost; a loop compiles faster than `np.zeros`
        turned = np.empty((n, ns * ns, 4 * wide))
        for p in range(n):
            for rs in range(ns * ns):
                for v in range(nc * nc, 4 * wide):
                    turned[p, rs, v] = 0.0
            for i in range(nc):
                for s in range(ns):
                    for k in range(nc):
                        for r in range(ns):
                            turned[p, s * ns + r, i * nc + k] = T[
                                p, (i * ns + s) * width + k * ns + r
                            ]
        low, start, lists, places = by_nodes(begin, end, node_start, nodes)
        size = start.size - 1
        slot, names = np.empty(size, np.int32), np.empty(size, np.int32)
        for a in range(size):
            slot[a] = -1
        rows, t = np.empty((size, 4 * wide)), np.empty((ns, 4 * wide))
        place, places_of = np.empty(indptr.size - 1, np.int32), np.empty(size, np.int64)
        turned_at, rows_at, t_at = turned.ctypes.data, rows.ctypes.data, t.ctypes.data
        for a in range(size):
            node, known = low + a, -1
            for i in range(nc):
                known = max(known, row_of[node, i])
            if known < 0 or start[a] == start[a + 1]:
                continue
            count = 0
            for e in range(start[a], start[a + 1]):
                g = lists[e]
                first = node_start[g]
                m = node_start[g + 1] - first
                for b in range(m):
                    c = nodes[first + b] - low
                    if slot[c] < 0:
                        slot[c], names[count] = count, c
                        for v in range(4 * wide):
                            rows[count, v] = 0.0
                        count += 1
                    places_of[b] = rows_at + 32 * wide * slot[c]
                for position in range(groups[g], groups[g + 1]):
                    at = value_start[g] + (position - groups[g]) * m
                    own = at + places[e]
                    of_point = turned_at + 32 * wide * ns * ns * (position - groups[begin])
                    for r in range(ns):
                        for v in range(wide):
                            slot_at = of_point + 32 * (r * wide + v)
                            if offset:
                                row = times(N[own], load(slot_at))
                            else:
                                row = times(dN[own, 0], load(slot_at))
                            for s in range(1, ns):
                                row = axpy(
                                    dN[own, s - offset], load(slot_at + 32 * s * ns * wide), row
                                )
                            store(t_at + 32 * (r * wide + v), row)
                    if wide == 1:
                        _add_one(ns, offset, m, at, N, dN, t_at, places_of)
                    elif wide == 3:
                        _add_three(ns, offset, m, at, N, dN, t_at, places_of)
                    else:
                        for b in range(m):
                            for v in range(wide):
                                to = places_of[b] + 32 * v
                                total = load(to)
                                for r in range(ns):
                                    phi = dN[at + b, max(r - offset, 0)]
                                    if offset and r == 0:
                                        phi = N[at + b]
                                    total = axpy(phi, load(t_at + 32 * (r * wide + v)), total)
                                store(to, total)
            # all components of a node have the same columns
            for at in range(indptr[known], indptr[known + 1]):
                place[indices[at]] = at - indptr[known]
            for c in range(count):
                other = low + names[c]
                slot[names[c]] = -1
                column = row_of[other, 0]
                free = column >= 0
                for k in range(1, nc):
                    free = free and row_of[other, k] >= 0
                for i in range(nc):
                    row = row_of[node, i]
                    if row < 0:
                        continue
                    if free:
                        to = indptr[row] + place[column]
                        for k in range(nc):
                            data[to + k] += rows[c, i * nc + k]
                        continue
                    for k in range(nc):
                        if row_of[other, k] >= 0:
                            data[indptr[row] + place[row_of[other, k]]] += rows[c, i * nc + k]
                        else:
                            lift[node, i] += rows[c, i * nc + k] * prescribed[other, k]
        # an address does not keep an array alive: without this line Numba frees both early
        t[0, 0] = turned[0, 0, 0]

    return kernel
