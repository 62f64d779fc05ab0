"""Inverse of lists of nodes: the lists that contain each node."""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["by_nodes"]


@numba.njit(cache=True, error_model="numpy")
def by_nodes(begin, end, node_start, nodes):
    """Find the lists that contain each node, and the node's place in each list.

    For compiled loops. The lists together must contain at least one node.

    Args:
        begin, end: First list, and the number behind the last list.
        node_start, nodes: Lists of nodes, one behind the other: list g is
            nodes[node_start[g]:node_start[g + 1]].

    Returns:
        low: The least node.
        start: First entry of each node from the least to the largest one, and the end.
        lists, places: List and place in the list of every entry, by increasing list per node.
    """
    first, last = node_start[begin], node_start[end]
    low, high = nodes[first], nodes[first]
    for e in range(first, last):
        low, high = min(low, nodes[e]), max(high, nodes[e])
    # a loop compiles faster than `np.zeros`
    start = np.empty(high - low + 3, np.int32)
    for a in range(start.size):
        start[a] = 0
    for e in range(first, last):
        start[nodes[e] - low + 2] += 1
    for a in range(2, start.size):
        start[a] += start[a - 1]
    lists, places = np.empty(last - first, np.int32), np.empty(last - first, np.int32)
    # while entries are written, each row's start moves to its end, which is the next row's start
    for g in range(begin, end):
        for e in range(node_start[g], node_start[g + 1]):
            a = nodes[e] - low + 1
            lists[start[a]], places[start[a]] = g, e - node_start[g]
            start[a] += 1
    return low, start[:-1], lists, places
