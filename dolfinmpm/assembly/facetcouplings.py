"""Couplings of splines around facets of a rectangular grid, and sums of the facets' tensors."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.basis.latticebasis import LatticeBasis
from dolfinmpm.basis.stencils import running_sum

__all__ = ["Couplings", "FacetPatch", "couplings_of", "facet_patch"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@numba.njit(cache=True, error_model="numpy")
def _nodes_around(low, direction, table, table_shape, patch, nodes, count):
    """Write the nodes around every facet and count the facets of each node.

    Returns whether all nodes are known.
    """
    gdim = low.shape[1]
    known = True
    for f in range(low.shape[0]):
        for a in range(nodes.shape[1]):
            at = 0
            for d in range(gdim):
                at = at * table_shape[d] + low[f, d] + patch[direction[f], a, d]
            nodes[f, a] = table[at]
            known = known and table[at] >= 0
            count[table[at]] += 1
    return known


@numba.njit(cache=True, error_model="numpy")
def _facets_of_nodes(nodes, place, start, facet, position):
    """Write the facets of every touched node, and the node's position in each facet's nodes."""
    fill = start[:-1].copy()
    for f in range(nodes.shape[0]):
        for a in range(nodes.shape[1]):
            row = place[nodes[f, a]]
            facet[fill[row]], position[fill[row]] = f, a
            fill[row] += 1


@numba.njit(cache=True, error_model="numpy")
def _couple(nodes, direction, start, facet, position, slot, seen, begin, columns, slots):
    """Write the nodes coupled to each touched node; only count them if the arrays are empty."""
    seen[:] = -1
    total = 0
    for row in range(start.size - 1):
        for e in range(start[row], start[row + 1]):
            f = facet[e]
            for b in range(nodes.shape[1]):
                s = slot[direction[f], position[e], b]
                if seen[s] != row:
                    seen[s] = row
                    if columns.size:
                        columns[total], slots[total] = nodes[f, b], s
                    total += 1
        begin[row + 1] = total


@dataclass(frozen=True)
class FacetPatch:
    """Nodes around a facet, by the direction of the facet.

    Attributes:
        nodes: Lattice positions relative to the first node of the facet's lower cell, shape
            (gdim, m, gdim).
        slot: Position of node b relative to node a, as one number, shape (gdim, m, m).
        slots: Number of relative positions.
    """

    nodes: Ints
    slot: Ints
    slots: int


def facet_patch(gdim: int, degree: int) -> FacetPatch:
    """The nodes around a facet for splines of a degree."""
    shapes = [tuple(degree + 1 + (d == e) for e in range(gdim)) for d in range(gdim)]
    nodes = np.array([list(np.ndindex(*shape)) for shape in shapes], np.int32)
    strides = (2 * degree + 3) ** np.arange(gdim)[::-1]
    apart = nodes[:, None, :, :] - nodes[:, :, None, :] + degree + 1
    return FacetPatch(nodes, (apart @ strides).astype(np.int32), (2 * degree + 3) ** gdim)


@dataclass(frozen=True)
class Couplings:
    """Entries of the matrix of facet terms between splines.

    Attributes:
        rows, columns: Nodes of each entry, in the basis's local numbering.
        patch: Nodes around a facet.
        direction: Direction of each facet.
        facets_of_nodes: For the touched nodes the start of their facets, the facets, and the
            positions of the nodes in the patches of the facets.
        begin: First entry of every touched node.
        slots: Relative position of the nodes of each entry, see `FacetPatch`.
    """

    rows: Ints
    columns: Ints
    patch: FacetPatch
    direction: Ints
    facets_of_nodes: tuple[npt.NDArray[np.int64], Ints, Ints]
    begin: npt.NDArray[np.int64]
    slots: Ints


def couplings_of(patch: FacetPatch, basis: LatticeBasis, low: Ints, direction: Ints) -> Couplings:
    """Couplings of the splines around facets.

    Args:
        patch: Nodes around a facet.
        basis: Basis whose numbering of nodes is used.
        low: Lattice position of the lower cell of each facet, shape (facets, gdim).
        direction: Direction of each facet.
    """
    halo = basis.halo
    nodes = np.empty((len(low), patch.nodes.shape[1]), np.int32)
    count = np.zeros(basis.nodes.size, np.int64)
    shape = np.array(halo.node_table.shape, np.int64)
    table = low - halo.origin, direction, halo.node_table.ravel(), shape
    known = _nodes_around(*table, patch.nodes, nodes, count)
    assert known
    touched = np.flatnonzero(count)
    start = running_sum(count[touched], np.int64)
    place = np.empty(count.size, np.int32)
    place[touched] = np.arange(touched.size, dtype=np.int32)
    facet, position = np.empty(start[-1], np.int32), np.empty(start[-1], np.int32)
    _facets_of_nodes(nodes, place, start, facet, position)
    begin = np.zeros(touched.size + 1, np.int64)
    seen = np.empty(patch.slots, np.int64)
    graph = nodes, direction, start, facet, position, patch.slot, seen, begin
    _couple(*graph, np.empty(0, np.int32), np.empty(0, np.int32))
    columns, slots = np.empty((2, begin[-1]), np.int32)
    _couple(*graph, columns, slots)
    rows = np.repeat(touched.astype(np.int32), np.diff(begin))
    return Couplings(rows, columns, patch, direction, (start, facet, position), begin, slots)
