"""Compiled search in a tree of cells: the leaf at a position, and the leaves of a domain.

A tree begins with the cells of a rectangular grid, its roots. A cell may be split into 2^d children
of half its size. Positions in the tree are integers: numbers of the lines of the finest level, with
2^levels lines per root and direction.
"""

from __future__ import annotations

import numba
import numpy as np

from dolfinmpm.grid.linecells import cell_of, rounding

__all__ = [
    "ROOM",
    "coordinate",
    "leaf_at",
    "leaves_in",
    "mark_touched",
    "node_at",
    "nodes_at",
    "overlaps_of",
    "too_coarse",
]

# Largest number of leaves in the domain of a point
ROOM = 4096


@numba.njit(cache=True, inline="always")
def coordinate(lines, start, levels, d, k):
    """Coordinate of line k of the finest level in direction d (m)."""
    i = k >> levels
    f = k - (i << levels)
    low = lines[start[d] + i]
    if f == 0:
        return low
    return low + (lines[start[d] + i + 1] - low) * (f / (1 << levels))


@numba.njit(cache=True, error_model="numpy")
def _root_cell(lines, start, d, x):
    """Root that contains a coordinate, in one direction; the nearest root outside the grid."""
    line = lines[start[d] : start[d + 1]]
    cell = cell_of(line, False, x)
    if cell < line.size - 2 and line[cell + 1] - x < rounding(line[cell], line[cell + 1]):
        cell += 1
    return cell


@numba.njit(cache=True, error_model="numpy")
def leaf_at(x, lines, start, levels, shape, low, size, child):
    """Node of the tree without children that contains a position.

    A position on the side of a leaf belongs to the upper leaf.
    """
    d = x.size
    node = 0
    for k in range(d):
        node = node * shape[k] + _root_cell(lines, start, k, x[k])
    while child[node] >= 0:
        number, half = 0, size[node] >> 1
        for k in range(d):
            a = coordinate(lines, start, levels, k, low[node, k])
            middle = coordinate(lines, start, levels, k, low[node, k] + half)
            number = 2 * number + int(middle - x[k] < rounding(a, middle))
        node = child[node] + number
    return node


@numba.njit(cache=True, error_model="numpy")
def node_at(k, levels, shape, low, size, child):
    """Node without children that contains a cell of the finest level; -1 outside the grid."""
    node = 0
    for d in range(k.size):
        root = k[d] >> levels
        if k[d] < 0 or root >= shape[d]:
            return -1
        node = node * shape[d] + root
    while child[node] >= 0:
        number, half = 0, size[node] >> 1
        for d in range(k.size):
            number = 2 * number + int(k[d] >= low[node, d] + half)
        node = child[node] + number
    return node


@numba.njit(cache=True, error_model="numpy")
def leaves_in(x, half, lines, start, levels, shape, low, size, child, stack, found):
    """Write the leaves that a domain overlaps, and return their number; -1 without room.

    Args:
        x, half: Position and half-lengths of the domain (m), shape (d,); 0 without a domain.
        stack, found: Scratch array and result, `ROOM` numbers each.
    """
    d = x.size
    point = True
    for k in range(d):
        point = point and half[k] == 0.0
    if point:
        found[0] = leaf_at(x, lines, start, levels, shape, low, size, child)
        return 1
    first = np.empty(d, np.int64)
    count = np.empty(d, np.int64)
    roots = 1
    for k in range(d):
        first[k] = _root_cell(lines, start, k, x[k] - half[k])
        count[k] = _root_cell(lines, start, k, x[k] + half[k]) - first[k] + 1
        roots *= count[k]
    top = 0
    for r in range(roots):
        rest, node, width = r, 0, 1
        for k in range(d - 1, -1, -1):
            node += width * (first[k] + rest % count[k])
            rest //= count[k]
            width *= shape[k]
        if top == stack.size:
            return -1
        stack[top] = node
        top += 1
    number = 0
    while top > 0:
        top -= 1
        node = stack[top]
        inside = True
        for k in range(d):
            a = coordinate(lines, start, levels, k, low[node, k])
            b = coordinate(lines, start, levels, k, low[node, k] + size[node])
            least = rounding(a, b)
            if half[k] == 0.0:
                last = low[node, k] + size[node] >= shape[k] << levels
                before = x[k] < a - least and low[node, k] > 0
                inside = inside and not before and (last or b - x[k] >= least)
                continue
            common = min(x[k] + half[k], b) - max(x[k] - half[k], a)
            inside = inside and common > min(least, 0.25 * half[k])
        if not inside:
            continue
        if child[node] < 0:
            if number == found.size:
                return -1
            found[number] = node
            number += 1
            continue
        if top + (1 << d) > stack.size:
            return -1
        # the last child first: leaves come out in increasing order
        for c in range((1 << d) - 1, -1, -1):
            stack[top] = child[node] + c
            top += 1
    return number


@numba.njit(cache=True, error_model="numpy")
def mark_touched(x, half, lines, start, levels, shape, low, size, child, touched):
    """Mark the leaves that domains overlap; returns a domain in too many leaves, or -1."""
    stack, found = np.empty(ROOM, np.int64), np.empty(ROOM, np.int64)
    for p in range(x.shape[0]):
        number = leaves_in(
            x[p], half[p], lines, start, levels, shape, low, size, child, stack, found
        )
        if number < 0:
            return p
        for a in range(number):
            touched[found[a]] = True
    return -1


@numba.njit(cache=True, error_model="numpy")
def overlaps_of(x, half, lines, start, levels, shape, low, size, child, count, begin, leaves):
    """Count the leaves of every domain; write their nodes of the tree if `leaves` has room."""
    stack, found = np.empty(ROOM, np.int64), np.empty(ROOM, np.int64)
    for p in range(x.shape[0]):
        number = leaves_in(
            x[p], half[p], lines, start, levels, shape, low, size, child, stack, found
        )
        count[p] = number
        if leaves.size:
            for a in range(number):
                leaves[begin[p] + a] = found[a]


@numba.njit(cache=True, error_model="numpy")
def nodes_at(low, levels, shape, tree_low, size, child, nodes):
    """Write the node of each of some cells of the finest level; see `node_at`."""
    for a in range(low.shape[0]):
        nodes[a] = node_at(low[a], levels, shape, tree_low, size, child)


@numba.njit(cache=True, error_model="numpy")
def too_coarse(nodes, levels, shape, low, size, child, touched, split):
    """Mark leaves that are more than twice as large as a neighbour across a side, edge or corner.

    Returns whether there is one.
    """
    d = low.shape[1]
    some = False
    k = np.empty(d, np.int64)
    for node in nodes:
        if 4 * size[node] > 1 << levels:
            continue
        for side in range(3**d):
            rest = side
            for j in range(d):
                k[j] = low[node, j] + (rest % 3 - 1) * size[node]
                rest //= 3
            other = node_at(k, levels, shape, low, size, child)
            if other >= 0 and touched[other] and size[other] > 2 * size[node]:
                split[other] = True
                some = True
    return some
