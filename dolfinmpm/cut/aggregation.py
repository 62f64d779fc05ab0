"""Aggregation and extension: values at nodes of ill-filled cells follow from well-filled ones.

Aggregated finite elements (Badia, Verdugo & Martín 2018, doi
10.1016/j.cma.2018.03.022; for material points Coombs, Bird & Pretti 2025, doi
10.1016/j.cma.2025.118012) and extended B-splines (Höllig, Reif & Wipper 2001, doi
10.1137/S0036142900373208) are one mechanism. A node with too little support by the body is
constrained to a root cell: the polynomial of the root cell is continued to the node.

A linear function has too little support if all its active cells are filled to less than a
threshold. The two stabilisations then differ in the cells that may be roots. A spline reaches over
several cells, and may have a very small share in the only full cell. So the criterion of a spline
is the share of its integral inside the body. Then both stabilisations are the same. Bodies that are
too small or too thin for a well-filled cell of splines have their best cells as roots.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm.basis import LatticeBasis, LeafBasis, LinearBasis
from dolfinmpm.basis.bspline import extension_weights
from dolfinmpm.basis.cells import pull_back
from dolfinmpm.cut.leafaggregation import leaf_constraints
from dolfinmpm.grid.lattice import cell_volumes
from dolfinmpm.grid.linecells import FAR, relative_rounding

if TYPE_CHECKING:
    from scipy import sparse

__all__ = ["SEARCH_RADIUS", "MeshRoots", "constraint_matrix", "mesh_roots"]

# Cells around a node in which its root is searched.
SEARCH_RADIUS = 4
# Share of the best cell's least function that is enough where no cell is filled well
_SLIGHT = 0.1


@numba.njit(cache=True, error_model="numpy")
def _linear_index(ijk, origin, shape):
    at = 0
    for d in range(ijk.size):
        k = ijk[d] - origin[d]
        if k < 0 or k >= shape[d]:
            return -1
        at = at * shape[d] + k
    return at


@numba.njit(cache=True, error_model="numpy")
def _inner(nodes, node_ijk, degree, origin, shape, good, inner):
    """Whether each node has a good cell in its support."""
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


@numba.njit(cache=True, error_model="numpy")
def _roots(
    outer, node_ijk, x, middles, middle_start, size, degree, origin, shape, root, radius, growth,
    close, found,
):  # fmt: skip
    """Root cell of every outer node: the cell with the least growth, then the nearest cell.

    `growth` is the logarithm of the growth by a continuation over k functions along one direction.
    Among equal cells the lattice position decides; distances are equal up to the share `close`.

    A node on the grid's edge uses only cells on this edge. So it has the same conditions as the
    nodes of its root.
    """
    gdim = node_ijk.shape[1]
    c = np.empty(gdim, np.int64)
    width = 2 * radius + degree + 1
    for k in range(outer.size):
        a = outer[k]
        for attempt in range(2):
            best, least = np.inf, np.inf
            for code in range(width**gdim):
                rest = code
                distance, grown = 0.0, 0.0
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
                    steps = max(c[d] - node_ijk[a, d], node_ijk[a, d] - c[d] - degree, 0)
                    grown += growth[steps]
                worse = grown > least + 1e-9
                if not worse and grown > least - 1e-9:
                    worse = distance >= best * (1.0 - close)
                if not allowed or worse:
                    continue
                at = _linear_index(c, origin, shape)
                if at >= 0 and root[at]:
                    best, least = distance, grown
                    for d in range(gdim):
                        found[k, d] = c[d]
            if best < np.inf:
                break


@functools.cache
def _growth(degree: int):
    """Logarithm of the norm of the weights that continue by k functions, k = 0, 1, ..."""
    line = np.linspace(0.0, 1.0, 2 * (SEARCH_RADIUS + degree) + 6).astype(np.float64)
    first = degree  # away from the repeated knots
    reach = range(SEARCH_RADIUS + degree + 2)
    weights = [extension_weights(line, degree, first, first + degree + k) for k in reach]
    return np.log(np.linalg.norm(weights, axis=1))


def _inner_and_roots(basis: LatticeBasis, nodes, filled, threshold: float, extended: bool):
    """The nodes with enough support, and the cells of the halo's table that may be roots."""
    halo, degree = basis.halo, basis.degree
    cells = halo.cell_table.ravel()
    shape = np.array(halo.cell_table.shape, np.int64)
    close = relative_rounding(basis.lattice.lines)
    if degree == 1:
        known = cells >= 0
        good = np.zeros(cells.size, bool)
        good[known] = filled[cells[known]] >= threshold - close
        inner = np.zeros(basis.nodes.size, bool)
        # a node without a cell of the body has no well-filled cell
        _inner(nodes, halo.node_ijk, degree, halo.origin, shape, good, inner)
        if not extended:
            return inner, good
    else:
        # share of the last function if the body ends in a cell filled to the threshold
        least = threshold ** (degree + 1) / math.factorial(degree + 1)
        inner = filled >= least * (1 - close)
        inner[_best_nodes(basis, filled, least * (1 - close))] = True
    return inner, _lowest(basis, inner).ravel()


def _best_nodes(basis: LatticeBasis, filled, least: float):
    """Nodes of the best cells of small bodies, where no cell has enough support nearby."""
    from scipy.ndimage import maximum_filter

    lowest = _lowest(basis, filled)
    best = maximum_filter(lowest, 2 * SEARCH_RADIUS + 1, mode="constant")
    chosen = np.argwhere((best < least) & (lowest > 0) & (lowest >= _SLIGHT * best))
    corners = np.argwhere(np.ones((basis.degree + 1,) * lowest.ndim))
    return basis.halo.node_table[tuple((chosen[:, None] + corners).reshape(-1, lowest.ndim).T)]


def _lowest(basis: LatticeBasis, values):
    """Lowest value at the nodes of each cell of the halo's table, 0 where a node is unknown."""
    table = basis.halo.node_table
    found = np.where(table >= 0, values[table], values.dtype.type(0))
    for axis, cells in enumerate(basis.halo.cell_table.shape):
        shifts = (np.arange(k, k + cells) for k in range(basis.degree + 1))
        found = functools.reduce(np.minimum, [found.take(shift, axis) for shift in shifts])
    return found


def _lattice_constraints(basis: LatticeBasis, nodes, filled, threshold: float, extended: bool):
    halo, lattice, degree = basis.halo, basis.lattice, basis.degree
    shape = np.array(halo.cell_table.shape, np.int64)
    inner, root = _inner_and_roots(basis, nodes, filled, threshold, extended)
    outer = nodes[~inner[nodes]]
    found = np.full((outer.size, shape.size), -1, np.int64)
    middles = [0.5 * (line[1:] + line[:-1]) for line in lattice.lines]
    starts = np.cumsum([0] + [m.size for m in middles])
    x = basis.node_coordinates()[:, : shape.size]
    _roots(
        outer, halo.node_ijk, x, np.concatenate(middles), starts, np.array(lattice.shape), degree,
        halo.origin, shape, root, SEARCH_RADIUS, _growth(degree),
        relative_rounding(lattice.lines), found,
    )  # fmt: skip
    has_root = found[:, 0] >= 0
    outer, found = outer[has_root], found[has_root]

    @functools.cache
    def along(d: int, cell: int, function: int):
        return extension_weights(lattice.lines[d], degree, cell, function)

    for a, cell in zip(outer, found):
        weights = np.ones(1)
        for d in range(shape.size):
            weights = np.multiply.outer(weights, along(d, int(cell[d]), int(halo.node_ijk[a, d])))
        block = tuple(slice(k, k + degree + 1) for k in cell - halo.origin)
        yield a, halo.node_table[block].ravel(), weights.ravel()


def _all_roots(basis: LinearBasis, good):
    """Well-filled cells of all ranks: corners, global nodes and their owners. Collective.

    The cells are sorted by their middles. So the choice among equal cells does not depend on the
    number of ranks.
    """
    comm, index_map = basis.grid.comm, basis.nodes.index_map
    owner = np.full(basis.nodes.size, comm.rank, np.int32)
    owner[basis.nodes.owned :] = index_map.owners
    nodes = basis.dofs[good].astype(np.int32)
    indices = index_map.local_to_global(nodes.ravel()).reshape(nodes.shape)
    mine = basis.node_coordinates()[nodes], indices, owner[nodes]
    corners, indices, owners = (np.concatenate(part) for part in zip(*comm.allgather(mine)))
    middles = corners.mean(axis=1)
    size = max(float(np.ptp(middles)) if middles.size else 0.0, 1e-300)
    order = np.lexsort(np.round(middles / size, 9).T)
    return corners[order], indices[order], owners[order]


@dataclass(frozen=True)
class MeshRoots:
    """Roots on a grid of any cells.

    Attributes:
        outer: Nodes that need a root, shape (n,).
        corners: Corners of the root of each node (m), shape (n, nodes of a cell, 3).
        nodes: Global numbers of the root's nodes, shape (n, nodes of a cell).
        unknown: Global numbers, owners and positions (m) of root nodes unknown on this rank.
    """

    outer: npt.NDArray[np.int32]
    corners: npt.NDArray[np.float64]
    nodes: npt.NDArray[np.int64]
    unknown: tuple[npt.NDArray, npt.NDArray, npt.NDArray]


def _mesh_rounding(grid: Mesh) -> float:
    """Relative rounding error of lengths in the cells of any grid. Collective."""
    far = grid.comm.allreduce(np.abs(grid.geometry.x).max(initial=0.0), op=MPI.MAX)
    least = grid.comm.allreduce(cell_volumes(grid).min(initial=math.inf), op=MPI.MIN)
    return float(max(1e-9, FAR * far / least ** (1 / grid.geometry.dim)))


def mesh_roots(basis: LinearBasis, nodes, fraction, threshold: float) -> MeshRoots:
    """Roots of the nodes that have no well-filled cell, on any grid. Collective.

    Args:
        basis: The basis.
        nodes: Active nodes known on this rank.
        fraction: Fill fraction of every local cell, shape (cells,).
        threshold: Fraction from which a cell is well-filled.
    """
    d, owned = basis.grid.geometry.dim, basis.cells.owned
    close = _mesh_rounding(basis.grid)
    good = np.flatnonzero(fraction[:owned] >= threshold - close)
    inner = np.zeros(basis.nodes.size, bool)
    inner[basis.dofs[good]] = True
    inner = basis.nodes.share_flags(inner)
    corners, indices, owners = _all_roots(basis, good)
    outer = nodes[~inner[nodes]] if len(corners) else nodes[:0]
    middles, X = corners.mean(axis=1)[:, :d], basis.node_coordinates()[:, :d]
    root: npt.NDArray[np.int64] = np.empty(0, np.int64)
    if outer.size:
        count = min(16, len(middles))
        from scipy.spatial import cKDTree

        distance, near = cKDTree(middles).query(X[outer], k=[*range(1, count + 1)])
        equal = distance <= distance[:, :1] * (1 + close)
        root = np.where(equal, near, len(middles)).min(axis=1)
    wanted = indices[root].ravel()
    unknown = basis.nodes.index_map.global_to_local(wanted) < 0
    new, first = np.unique(wanted[unknown], return_index=True)
    whose, where = owners[root].ravel()[unknown], corners[root].reshape(-1, 3)[unknown]
    return MeshRoots(outer, corners[root], indices[root], (new, whose[first], where[first]))


def _mesh_constraints(basis: LinearBasis, roots: MeshRoots):
    """Constraints to the roots. The basis must know all nodes of the roots."""
    d, m = basis.grid.geometry.dim, basis.dofs.shape[1]
    X = basis.node_coordinates()[:, :d]
    local = basis.nodes.index_map.global_to_local(roots.nodes.ravel())
    N, dN = np.empty(m), np.empty((m, d))
    J, K, xi = np.empty((d, d)), np.empty((d, d)), np.empty(d)
    for a, corners, masters in zip(roots.outer, roots.corners, local.reshape(-1, m)):
        cell: npt.NDArray[np.float64] = np.ascontiguousarray(np.asarray(corners)[:, :d])
        if pull_back(basis.kind, cell, X[a], xi, N, dN, J, K):
            yield a, masters, N.copy()


def constraint_matrix(
    basis: LatticeBasis | LeafBasis | LinearBasis,
    nodes: npt.NDArray[np.int32],
    filled: npt.NDArray[np.float64],
    threshold: float,
    extended: bool,
    fixed: npt.NDArray[np.bool_],
    roots: MeshRoots | None,
) -> sparse.csr_matrix:
    """The matrix C of aggregation or extension, u = C x.

    Args:
        basis: The basis.
        nodes: Active nodes known on this rank.
        filled: Fill fraction of every local cell, shape (cells,); for splines the
            share of every function's integral in the body, shape (nodes,), see `support_shares`.
        threshold: Fill fraction t from which a cell is well-filled. A spline of degree q needs the
            share t^(q+1)/(q+1)!. The last spline has this share if a body with a straight edge
            ends in a cell filled to t.
        extended: Whether every cell of inner functions may be a root, not only a
            well-filled cell.
        fixed: Mask of prescribed components, shape (nodes, components). A node with prescribed
            components follows only nodes with the same prescribed components.
        roots: Roots of a grid that is not rectangular; see `mesh_roots`.

    Returns:
        C, shape (nodes, nodes). A node without a root nearby keeps its value.
    """
    from scipy import sparse

    size = basis.nodes.size
    if isinstance(basis, LatticeBasis):
        found = _lattice_constraints(basis, nodes, filled, threshold, extended)
    elif isinstance(basis, LeafBasis):
        found = leaf_constraints(basis, nodes, filled, threshold, extended)
    else:
        assert roots is not None
        found = _mesh_constraints(basis, roots)
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
