"""The lists of nodes the other way round: which of them have a node."""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["by_nodes"]


@numba.njit(cache=True, error_model="numpy")
def by_nodes(begin, end, node_start, nodes):
    """Which lists have each node, at which place, for compiled loops; there must be one node.

    Args:
        begin, end: The first list, and the one behind the last.
        node_start, nodes: Lists of nodes one after the other.

    Returns:
        The least node; first entries of it and all behind it, up to the largest, and the end;
        lists and places of the entries, lists increasing for each node.
    """
    first, last = node_start[begin], node_start[end]
    low, high = nodes[first], nodes[first]
    for e in range(first, last):
        low, high = min(low, nodes[e]), max(high, nodes[e])
    # to fill by hand compiles faster than `np.zeros`
    start = np.empty(high - low + 3, np.int32)
    for a in range(start.size):
        start[a] = 0
    for e in range(first, last):
        start[nodes[e] - low + 2] += 1
    for a in range(2, start.size):
        start[a] += start[a - 1]
    lists, places = np.empty(last - first, np.int32), np.empty(last - first, np.int32)
    # each row's first entry runs to its end, which is the next one's first
    for g in range(begin, end):
        for e in range(node_start[g], node_start[g + 1]):
            a = nodes[e] - low + 1
            lists[start[a]], places[start[a]] = g, e - node_start[g]
            start[a] += 1
    return low, start[:-1], lists, places
