"""Facets of rectangular grids: their cells, the splines around them, and how these couple."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.basis.latticebasis import LatticeBasis
from dolfinmpm.basis.stencils import running_sum

__all__ = [
    "Couplings", "FacetPatch", "LatticeFacet", "couplings_of", "facet_patch", "gauss_rule",
    "one_dimensional", "product", "splines", "splines_between",
]  # fmt: skip

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@dataclass(frozen=True)
class LatticeFacet:
    """Position of a facet in a lattice.

    Attributes:
        lines: Coordinates of the lattice's nodes in each direction (m).
        low: Lattice position of the lower one of the two cells at the facet.
        direction: Direction from the lower to the upper cell.
        swapped: Whether the upper cell is the first cell, "+".
    """

    lines: Sequence[Array]
    low: tuple[int, ...]
    direction: int
    swapped: bool

    def cell(self, side: str) -> tuple[int, ...]:
        """Lattice position of the cell on a side."""
        upper = (side == "+") == self.swapped
        return tuple(i + (upper and d == self.direction) for d, i in enumerate(self.low))

    def sizes(self, side: str) -> tuple[float, ...]:
        """Lengths of the edges of the cell on a side (m)."""
        return tuple(float(x[i + 1] - x[i]) for x, i in zip(self.lines, self.cell(side)))


gauss_rule = functools.cache(np.polynomial.legendre.leggauss)


def splines(line: Array, degree: int, cell: int, x: Array, order: int) -> Array:
    """Derivatives of the functions of a cell of a line, see `splines_between`."""
    knots = np.concatenate([[line[0]] * degree, line, [line[-1]] * degree])
    return splines_between(knots[cell + 1 : cell + 2 * degree + 1], x, order)


def splines_between(knots: Array, x: Array, order: int) -> Array:
    """Derivatives of the functions of a cell, as polynomials also outside it, shape (x, p + 1).

    First come recursions of Cox and de Boor for values, then recursions for derivatives (de Boor,
    A Practical Guide to Splines, 1978, ch. X).

    Args:
        knots: Knots around the cell (m), shape (2 p,); the cell is between the middle two.
        x: Positions (m).
        order: Order of the derivative.
    """
    p = knots.size // 2
    if order > p:
        return np.zeros((x.size, p + 1))
    values: Array = np.ones((x.size, 1))
    for k in range(1, p + 1):
        # functions p − k + 1 ... p of degree k − 1 begin at `start` and end at `end`
        start, end = knots[p - k : p], knots[p : p + k]
        share = values / (end - start)
        before = np.zeros((x.size, k + 1))
        after = np.zeros((x.size, k + 1))
        if k > p - order:
            before[:, 1:], after[:, :-1] = k * share, -k * share
        else:
            before[:, 1:] = (x[:, None] - start) * share
            after[:, :-1] = (end - x[:, None]) * share
        values = before + after
    return values


def one_dimensional(
    place: LatticeFacet, side: str, direction: int, degree: int
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Integrals of products of the splines around a facet, over a cell's edge in one direction.

    Args:
        place: The facet.
        side: Side of the cell, "+" or "-".
        direction: The direction.
        degree: Degree of the splines.

    Returns:
        Matrices of ∫ N_a^(i) N_b^(k), by the orders i and k of derivatives, 0 or 1.
    """
    line, cell, low = place.lines[direction], place.cell(side)[direction], place.low[direction]
    points, weights = gauss_rule(degree + 1)
    h = line[cell + 1] - line[cell]
    x = line[cell] + 0.5 * h * (points + 1)
    values = np.zeros((2, x.size, degree + 1 + (direction == place.direction)))
    for order in (0, 1):
        values[order, :, cell - low : cell - low + degree + 1] = splines(
            line, degree, cell, x, order
        )
    first, second = (
        tuple((0.5 * h * weights * values[i].T) @ values[k] for k in (0, 1)) for i in (0, 1)
    )
    return first, second


def product(lines: Sequence[Array]) -> Array:
    """Kronecker product of matrices, one per direction."""
    product: Array = np.ones((1, 1))
    for matrix in lines:
        product = np.asarray(np.kron(product, matrix))
    return product


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
