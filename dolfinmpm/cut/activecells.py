"""Active nodes and cells of a step, and the ghost facets, of DOLFINx's mesh or between leaves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh, exterior_facet_indices
from mpi4py import MPI

from dolfinmpm._platform.compat import ghosted_partitioner
from dolfinmpm._platform.errors import UnsupportedGridError
from dolfinmpm.basis import LatticeBasis, LeafBasis, LinearBasis, Placement, Stencils
from dolfinmpm.body.points import ACTIVE_CELLS, GHOST_FACETS
from dolfinmpm.cut.edgecells import at_edges, ill_at_edges
from dolfinmpm.grid.halo import Numbering
from dolfinmpm.grid.lattice import once_per_grid
from dolfinmpm.grid.leafsearch import node_at

if TYPE_CHECKING:
    from dolfinmpm.cut.activation import ActiveField

__all__ = ["GhostFacets", "active_cells", "active_nodes", "active_on_grid", "entities"]

GhostRows = npt.NDArray[np.int32]
Mask = npt.NDArray[np.bool_]


def _flags(indices: npt.NDArray[np.int32], numbering: Numbering) -> npt.NDArray[np.bool_]:
    flags = np.zeros(numbering.size, bool)
    flags[indices] = True
    return numbering.share_flags(flags)


def active_nodes(
    stencils: Stencils, basis: LatticeBasis | LinearBasis | LeafBasis
) -> npt.NDArray[np.int32]:
    """Nodes in the stencils of points on any rank, in increasing local order. Collective.

    The nodes that a hanging node follows are active too. They may be those of a large leaf without
    points of the field, which only points of another field overlap.
    """
    flags = _flags(stencils.nodes, basis.nodes)
    if isinstance(basis, LeafBasis):
        flags[basis.hanging[np.flatnonzero(flags)].indices] = True
        flags = basis.nodes.share_flags(flags)
    return np.flatnonzero(flags).astype(np.int32)


def active_cells(stencils: Stencils, numbering: Numbering) -> npt.NDArray[np.bool_]:
    """Mask of the local cells that a point or its domain overlaps, on any rank. Collective."""
    return _flags(stencils.cells, numbering)


@numba.njit(cache=True, error_model="numpy")
def _mark_boundary(active, owned, cell_facets, facet_cells, boundary):
    for c in range(owned):
        if active[c]:
            for f in cell_facets[c]:
                other = facet_cells[f, 0] + facet_cells[f, 1] - c
                if facet_cells[f, 1] >= 0 and not active[other]:
                    boundary[c] = True


@numba.njit(cache=True, error_model="numpy")
def _select_facets(active, boundary, owned_facets, cell_facets, facet_cells, rows):
    number = 0
    for c in range(cell_facets.shape[0]):
        if not active[c]:
            continue
        for i in range(cell_facets.shape[1]):
            f = cell_facets[c, i]
            other = facet_cells[f, 0] + facet_cells[f, 1] - c
            if f >= owned_facets or facet_cells[f, 1] < 0 or other < c or not active[other]:
                continue
            if boundary[c] or boundary[other]:
                if number < rows.shape[0]:
                    j = 0
                    while cell_facets[other, j] != f:
                        j += 1
                    rows[number, 0], rows[number, 1] = c, i
                    rows[number, 2], rows[number, 3] = other, j
                number += 1
    return number


def _filled(select: Any, *arguments: Any) -> GhostRows:
    """Rows that a compiled loop writes, shape (facets, 4); a first call counts them."""
    number = select(*arguments, np.empty((0, 4), np.int32))
    rows = np.empty((number, 4), np.int32)
    if number:
        select(*arguments, rows)
    return rows


class GhostFacets:
    """Interior facets between active cells of which at least one borders on an inactive cell.

    This is the definition of Coombs (2023, doi 10.1002/nme.7332). The outer edge of the grid makes
    no cell a boundary cell, but for those of `dolfinmpm.cut.edgecells`. A cell that only markers
    reach is one.

    Args:
        grid: Background grid.

    Raises:
        UnsupportedGridError: The grid is distributed without ghost cells.
    """

    def __init__(self, grid: Mesh):
        topology, tdim = grid.topology, grid.topology.dim
        topology.create_connectivity(tdim, tdim - 1)
        topology.create_connectivity(tdim - 1, tdim)
        self._owned_facets = topology.index_map(tdim - 1).size_local
        self._cells = Numbering(grid.comm, topology.index_map(tdim))
        to_cells = topology.connectivity(tdim - 1, tdim)
        of_cells = topology.connectivity(tdim, tdim - 1)
        ghosts = grid.comm.allreduce(topology.index_map(tdim).num_ghosts, op=MPI.SUM)
        # a facet with one local cell inside the grid has its other cell on another rank
        cut = int(np.count_nonzero(np.diff(to_cells.offsets) == 1)) - len(
            exterior_facet_indices(topology)
        )
        cut = grid.comm.allreduce(cut, op=MPI.SUM)
        if grid.comm.size > 1 and ghosts == 0 and cut > 0:
            raise UnsupportedGridError(
                "terms over interior facets need ghost cells in parallel; create the mesh with "
                "ghost_mode=dolfinx.mesh.GhostMode.shared_facet, or one of gmsh or of a file "
                f"with partitioner={ghosted_partitioner()}"
            )
        first, count = to_cells.offsets[:-1], np.diff(to_cells.offsets)
        self._facet_cells = np.full((len(count), 2), -1, np.int32)
        for k in (0, 1):
            has = count > k
            self._facet_cells[has, k] = to_cells.array[first[has] + k]
        per_cell = int(of_cells.offsets[1]) if of_cells.num_nodes else 1
        self._cell_facets = of_cells.array.reshape(-1, per_cell)

    def outer(self) -> npt.NDArray[np.bool_]:
        """Mask of the local cells with a facet on the outer edge of the grid. Collective."""
        beside = np.any(self._facet_cells[self._cell_facets, 1] < 0, axis=1)
        # ghost cells lack neighbours on other ranks
        beside[self._cells.owned :] = False
        return self._cells.share_flags(beside)

    def select(
        self, active: npt.NDArray[np.bool_], empty: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.int32]:
        """The facets as rows (cell, local facet, cell, local facet) flattened. Collective.

        Args:
            active: Mask of the active local cells of DOLFINx's mesh.
            empty: Mask of those that are boundary cells wherever they lie.
        """
        cells = self._cells
        boundary = empty.copy()
        _mark_boundary(active, cells.owned, self._cell_facets, self._facet_cells, boundary)
        return self._between(active, cells.share_flags(boundary)).ravel()

    def select_coarse(
        self, active: npt.NDArray[np.bool_], empty: npt.NDArray[np.bool_], basis: LatticeBasis
    ) -> GhostRows:
        """The facets of coarse cells, in parts, in the format of `select`. Collective.

        Args:
            active, empty: See `select`, of the cells of the basis.
            basis: A basis on coarse cells.
        """
        of = basis.grid_cells
        assert of is not None
        boundary = _beside_inactive(active, basis) | empty
        rows = self._between(active[of], boundary[of])
        return rows[of[rows[:, 0]] != of[rows[:, 2]]].ravel()

    def _between(self, active, boundary) -> GhostRows:
        """Facets between active cells, at least one of them a boundary cell, shape (facets, 4)."""
        tables = self._owned_facets, self._cell_facets, self._facet_cells
        return _filled(_select_facets, active, boundary, *tables)


def _beside_inactive(active: npt.NDArray[np.bool_], basis: LatticeBasis) -> npt.NDArray[np.bool_]:
    """Mask of the active cells of a lattice with an inactive neighbour. Collective."""
    halo, shape = basis.halo, np.array(basis.lattice.shape)
    beside = np.zeros(active.size, bool)
    own = np.flatnonzero(active[: basis.cells.owned])
    for step in np.concatenate([np.eye(shape.size, dtype=int), -np.eye(shape.size, dtype=int)]):
        ijk = halo.cell_ijk[own] + step
        inside = np.all((ijk >= 0) & (ijk < shape), axis=1)
        neighbour = halo.cell_table[tuple((ijk[inside] - halo.origin).T)]
        beside[own[inside]] |= ~active[neighbour]
    return basis.cells.share_flags(beside)


@numba.njit(cache=True, error_model="numpy")
def _across(k, c, low, size, axis, upper, sample):
    """Write the finest cell beyond a side of leaf c: the sample-th of 2^(d − 1) in its quarters."""
    half = size[c] // 2
    for j in range(k.size):
        if j == axis:
            k[j] = low[c, j] + (size[c] if upper else -1)
        else:
            k[j] = low[c, j] + (half if sample & 1 else 0)
            sample >>= 1


@numba.njit(cache=True, error_model="numpy")
def _mark_boundary_leaves(low, size, owned, active, cell_of, search, boundary):
    """Mark active leaves with an inactive neighbour, or with a side that active ones only share."""
    levels, shape, tree_low, tree_size, child = search
    d = low.shape[1]
    k = np.empty(d, np.int64)
    for c in range(owned):
        if not active[c]:
            continue
        for axis in range(d):
            for upper in range(2):
                for sample in range(1 << (d - 1)):
                    _across(k, c, low, size, axis, upper, sample)
                    node = node_at(k, levels, shape, tree_low, tree_size, child)
                    if node >= 0 and (cell_of[node] < 0 or not active[cell_of[node]]):
                        boundary[c] = True


@numba.njit(cache=True, error_model="numpy")
def _select_leaf_facets(low, size, owned, active, cell_of, search, boundary, rows):
    """Write the facets as (cell, local facet, cell, local facet), the smaller cell first."""
    levels, shape, tree_low, tree_size, child = search
    d = low.shape[1]
    k = np.empty(d, np.int64)
    number = 0
    for c in range(owned):
        if not active[c]:
            continue
        for axis in range(d):
            for upper in range(2):
                _across(k, c, low, size, axis, upper, 0)
                node = node_at(k, levels, shape, tree_low, tree_size, child)
                other = cell_of[node] if node >= 0 else -1
                if other < 0 or not active[other] or size[other] < size[c]:
                    continue
                if size[other] == size[c] and not upper:
                    continue
                if boundary[c] or boundary[other]:
                    if number < rows.shape[0]:
                        rows[number, 0], rows[number, 1] = c, 2 * axis + upper
                        rows[number, 2], rows[number, 3] = other, 2 * axis + 1 - upper
                    number += 1
    return number


def _ghost_facets_of_leaves(
    active: npt.NDArray[np.bool_], empty: npt.NDArray[np.bool_], basis: LeafBasis
) -> npt.NDArray[np.int32]:
    """Facets between active leaves of which at least one borders on an inactive cell. Collective.

    A local facet is 2 axis, or 2 axis + 1 for the upper side. The facet is a side of the first
    cell, and the second cell is not smaller. A side at the edge of the grid makes no boundary cell.

    Args:
        active: Mask of the active cells of the basis.
        empty: Mask of those that are boundary cells wherever they lie.
        basis: The basis on leaves.

    Returns:
        Rows (cell, local facet, cell, local facet), flattened.
    """
    tree, leaves = basis.leaves.tree, basis.leaves
    low, size = leaves.low[basis.leaf], leaves.size[basis.leaf]
    cell_of = basis.cells_of_nodes()
    _, _, *search = tree.search
    boundary = empty.copy()
    graph = low, size, basis.cells.owned, active, cell_of, tuple(search)
    _mark_boundary_leaves(*graph, boundary)
    return _filled(_select_leaf_facets, *graph, basis.cells.share_flags(boundary)).ravel()


@once_per_grid
def ghost_facets(grid: Mesh) -> GhostFacets:
    """The facet tables of a grid, built once. Collective."""
    return GhostFacets(grid)


def entities(
    grid: Mesh, moving: set[int], where: Placement, seen: Stencils, of_points: Stencils,
    basis: LatticeBasis | LinearBasis | LeafBasis,
) -> dict[int, npt.NDArray[np.int32]]:  # fmt: skip
    """Ghost facets and active cells of a field for integrals, by subdomain id. Collective.

    Args:
        grid: The grid.
        moving: Subdomain ids that occur in the terms.
        where: Points and markers.
        seen: Stencils of points and markers on all active nodes.
        of_points: The same of the points alone.
        basis: The basis of the field.
    """
    found: dict[int, npt.NDArray[np.int32]] = {}
    if not moving:
        return found
    cells = active_cells(seen, basis.cells)
    empty = cells & ~active_cells(of_points, basis.cells)
    if GHOST_FACETS in moving:
        if isinstance(basis, LinearBasis):
            edges = ghost_facets(basis.grid).outer()[None]
        else:
            edges = at_edges(basis)
        empty |= ill_at_edges(where, seen, basis, cells & edges)
    if isinstance(basis, LeafBasis):
        own = np.flatnonzero(cells[: basis.cells.owned]).astype(np.int32)
        return {GHOST_FACETS: _ghost_facets_of_leaves(cells, empty, basis), ACTIVE_CELLS: own}
    tables = ghost_facets(grid) if GHOST_FACETS in moving else None
    if tables is not None and isinstance(basis, LatticeBasis) and basis.coarsen > 1:
        found[GHOST_FACETS] = tables.select_coarse(cells, empty, basis)
    # without a partition, the basis knows further cells behind those of DOLFINx's mesh
    cell_map = grid.topology.index_map(grid.topology.dim)
    known: Any = slice(cell_map.size_local + cell_map.num_ghosts)
    of_mesh = known if basis.grid_cells is None else basis.grid_cells
    cells, empty = cells[of_mesh], empty[of_mesh]
    if tables is not None and GHOST_FACETS not in found:
        found[GHOST_FACETS] = tables.select(cells, empty)
    if ACTIVE_CELLS in moving:
        owned = np.flatnonzero(cells[: cell_map.size_local])
        found[ACTIVE_CELLS] = owned.astype(np.int32)
    return found


def active_on_grid(field: ActiveField) -> npt.NDArray[np.int32]:
    """Own nodes that points reach, in the numbering of the field's space. Collective.

    With leaves these are the nodes of the grid's cells that contain leaves with points.
    """
    basis, base, seen = field.basis, field.space.basis, field.full_stencils
    if isinstance(basis, LeafBasis):
        assert isinstance(base, LatticeBasis)
        cells = np.flatnonzero(active_cells(seen, basis.cells))
        roots = np.unique(basis.leaves.low[basis.leaf[cells]] >> basis.leaves.tree.levels, axis=0)
        flags, table = np.zeros(base.nodes.size, bool), base.halo.node_table
        for offset in np.ndindex(*(base.degree + 1,) * roots.shape[1]):
            at = roots - base.halo.origin + np.array(offset, np.int32)
            at = at[np.all((at >= 0) & (at < table.shape), axis=1)]
            found = table[tuple(at.T)]
            flags[found[found >= 0]] = True
        return np.flatnonzero(base.nodes.share_flags(flags)[: base.nodes.owned]).astype(np.int32)
    nodes = active_nodes(seen, basis)
    if basis.grid_nodes is None:
        return nodes[nodes < basis.nodes.owned]
    flags = np.zeros(basis.nodes.size, bool)
    flags[nodes] = True
    return np.flatnonzero(flags[basis.grid_nodes[: base.nodes.owned]]).astype(np.int32)
