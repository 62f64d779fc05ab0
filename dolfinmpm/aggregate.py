"""Aggregation and extension: values at nodes of ill-filled cells follow from well-filled ones.

Aggregated finite elements (Badia, Verdugo & Martín 2018, doi
10.1016/j.cma.2018.03.022; for material points Coombs, Bird & Pretti 2025, doi
10.1016/j.cma.2025.118012) and extended B-splines (Höllig, Reif & Wipper 2001, doi
10.1137/S0036142900373208) are one mechanism: a node all of whose active cells are
filled to less than a threshold is tied to a root cell, whose polynomial is
continued. They differ in which cells may be roots.
"""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.spatial import cKDTree

from dolfinmpm.basis import LatticeBasis, LinearBasis
from dolfinmpm.basis.bspline import extension_weights
from dolfinmpm.basis.cells import pull_back
from dolfinmpm.errors import UnsupportedGridError

__all__ = ["SEARCH_RADIUS", "ties"]

# Cells around a node in which its root is looked for.
SEARCH_RADIUS = 4


@numba.njit(cache=True)
def _linear_index(ijk, origin, shape):
    at = 0
    for d in range(ijk.size):
        k = ijk[d] - origin[d]
        if k < 0 or k >= shape[d]:
            return -1
        at = at * shape[d] + k
    return at


@numba.njit(cache=True)
def _inner(nodes, node_ijk, degree, origin, shape, good, inner):
    """Whether each node has a good cell among those of its support."""
    gdim = node_ijk.shape[1]
    c = np.empty(gdim, np.int64)
    for a in nodes:
        inner[a] = False
        for code in range((degree + 1) ** gdim):
            rest = code
            for d in range(gdim):
                c[d] = node_ijk[a, d] - rest % (degree + 1)
                rest //= degree + 1
            at = _linear_index(c, origin, shape)
            if at >= 0 and good[at]:
                inner[a] = True
                break


@numba.njit(cache=True)
def _roots(
    outer, node_ijk, x, middles, middle_start, size, degree, origin, shape, root, radius, found
):
    """Nearest root cell of every outer node, ties broken by lattice position.

    A node on the grid's edge looks only at cells on that edge, so that conditions
    there are those of the nodes that it is tied to.
    """
    gdim = node_ijk.shape[1]
    c = np.empty(gdim, np.int64)
    width = 2 * radius + degree + 1
    for k in range(outer.size):
        a = outer[k]
        for attempt in range(2):
            best = np.inf
            for code in range(width**gdim):
                rest = code
                distance = 0.0
                allowed = True
                # the last direction runs fastest: the first best cell has the lowest position
                for d in range(gdim - 1, -1, -1):
                    c[d] = node_ijk[a, d] - degree - radius + rest % width
                    rest //= width
                    last = size[d] - 1
                    if c[d] < 0 or c[d] > last:
                        allowed = False
                        break
                    if attempt == 0:
                        if node_ijk[a, d] == 0 and c[d] != 0:
                            allowed = False
                        if node_ijk[a, d] == last + degree and c[d] != last:
                            allowed = False
                    gap = x[a, d] - middles[middle_start[d] + c[d]]
                    distance += gap * gap
                if not allowed or distance >= best * (1.0 - 1e-9):
                    continue
                at = _linear_index(c, origin, shape)
                if at >= 0 and root[at]:
                    best = distance
                    for d in range(gdim):
                        found[k, d] = c[d]
            if best < np.inf:
                break


def _lattice_ties(basis: LatticeBasis, nodes, fraction, threshold: float, extended: bool):
    halo, lattice, degree = basis.halo, basis.lattice, basis.degree
    shape = np.array(halo.cell_table.shape, np.int64)
    cells = halo.cell_table.ravel()
    good = np.zeros(cells.size, bool)
    known = cells >= 0
    good[known] = fraction[cells[known]] >= threshold - 1e-9
    inner = np.zeros(basis.nodes.size, bool)
    _inner(nodes, halo.node_ijk, degree, halo.origin, shape, good, inner)
    root = good
    if extended:
        # a root is any cell whose functions are all inner, filled or not
        table = halo.node_table
        seen = np.zeros(basis.nodes.size, bool)
        everywhere = np.arange(basis.nodes.size)
        _inner(everywhere, halo.node_ijk, degree, halo.origin, shape, good, seen)
        of_node = np.where(table >= 0, seen[table], False)
        whole = np.ones(halo.cell_table.shape, bool)
        for corner in np.ndindex(*(degree + 1,) * shape.size):
            whole &= of_node[tuple(slice(c, c + n) for c, n in zip(corner, shape))]
        root = whole.ravel()
    outer = nodes[~inner[nodes]]
    found = np.full((outer.size, shape.size), -1, np.int64)
    middles = [0.5 * (line[1:] + line[:-1]) for line in lattice.lines]
    starts = np.cumsum([0] + [m.size for m in middles])
    x = basis.node_coordinates()[:, : shape.size]
    _roots(
        outer, halo.node_ijk, x, np.concatenate(middles), starts, np.array(lattice.shape), degree,
        halo.origin, shape, root, SEARCH_RADIUS, found,
    )  # fmt: skip
    tied = found[:, 0] >= 0
    outer, found = outer[tied], found[tied]

    @cache
    def along(d: int, cell: int, function: int):
        return extension_weights(lattice.lines[d], degree, cell, function)

    for a, cell in zip(outer, found):
        weights = np.ones(1)
        for d in range(shape.size):
            weights = np.multiply.outer(weights, along(d, int(cell[d]), int(halo.node_ijk[a, d])))
        block = tuple(slice(k, k + degree + 1) for k in cell - halo.origin)
        yield a, halo.node_table[block].ravel(), weights.ravel()


def _mesh_ties(basis: LinearBasis, nodes, fraction, threshold: float):
    if basis.nodes.comm.size > 1:
        raise UnsupportedGridError(
            "aggregation on a grid that is not rectangular works on one rank only; use "
            'stabilisation="ghost" or a rectangular grid in parallel'
        )
    dofs, X = basis.dofs, basis.node_coordinates()[:, : basis.grid.geometry.dim]
    good = np.flatnonzero(fraction >= threshold - 1e-9)
    if good.size == 0:
        return
    inner = np.zeros(basis.nodes.size, bool)
    inner[dofs[good]] = True
    outer = nodes[~inner[nodes]]
    tree = cKDTree(X[dofs[good]].mean(axis=1))
    _, nearest = tree.query(X[outer])
    d, m = X.shape[1], dofs.shape[1]
    N, dN = np.empty(m), np.empty((m, d))
    J, K, xi = np.empty((d, d)), np.empty((d, d)), np.empty(d)
    for a, k in zip(outer, nearest):
        masters = dofs[good[k]]
        if pull_back(basis.kind, np.ascontiguousarray(X[masters]), X[a], xi, N, dN, J, K):
            yield a, masters, N.copy()


def ties(
    basis: LatticeBasis | LinearBasis,
    nodes: npt.NDArray[np.int32],
    fraction: npt.NDArray[np.float64],
    threshold: float,
    extended: bool,
    fixed: npt.NDArray[np.bool_],
) -> sparse.csr_matrix:
    """The matrix C of aggregation or extension, u = C x.

    Args:
        basis: The basis.
        nodes: Active nodes known here.
        fraction: Fill fraction of every local cell, shape (cells,).
        threshold: Share to which a cell must be filled to need no help.
        extended: Whether any cell of inner functions may be a root, not only a
            well-filled one.
        fixed: Which components are prescribed, shape (nodes, components); a node
            with such ones is tied only to nodes where they are prescribed too.

    Returns:
        C, shape (nodes, nodes). A node for which no root is near keeps its value.
    """
    size = basis.nodes.size
    if isinstance(basis, LatticeBasis):
        found = _lattice_ties(basis, nodes, fraction, threshold, extended)
    else:
        found = _mesh_ties(basis, nodes, fraction, threshold)
    keep = np.ones(size, bool)
    rows, columns, values = [np.empty(0, int)], [np.empty(0, int)], [np.empty(0)]
    for a, masters, weights in found:
        used = np.abs(weights) > 1e-14
        masters, weights = masters[used], weights[used]
        if np.all(fixed[a]) or np.any(fixed[a] & ~np.all(fixed[masters], axis=0)):
            continue
        keep[a] = False
        rows.append(np.full(masters.size, a))
        columns.append(masters)
        values.append(weights)
    own = np.flatnonzero(keep)
    data = np.concatenate([*values, np.ones(own.size)])
    where = np.concatenate([*rows, own]), np.concatenate([*columns, own])
    return sparse.csr_matrix((data, where), shape=(size, size))
