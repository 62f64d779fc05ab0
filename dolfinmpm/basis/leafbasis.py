"""The basis on leaves: linear functions or splines on cells of several sizes.

Functions are evaluated at points or averaged over their domains, as in GIMP.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.compat import make_index_map
from dolfinmpm._platform.errors import PointsOutsideGridError
from dolfinmpm.basis.latticebasis import LatticeBasis
from dolfinmpm.basis.leafsplines import LeafSplines, knots_around
from dolfinmpm.basis.leafsplinestencils import fill_spline_stencils
from dolfinmpm.basis.leafstencils import (
    fill_stencils,
    group_nodes,
    list_hashes,
    starts_of_lists,
)
from dolfinmpm.basis.stencils import Placement, Stencils, running_sum, stencil_matrix
from dolfinmpm.grid.halo import Numbering, dilated
from dolfinmpm.grid.lattice import Lattice, once_per_grid
from dolfinmpm.grid.leafnodes import LeafNodes
from dolfinmpm.grid.leaves import Leaves
from dolfinmpm.grid.linecells import SNAP, coordinate_rounding
from dolfinmpm.grid.partition import Partition

if TYPE_CHECKING:
    from scipy import sparse

__all__ = ["LeafBasis"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@once_per_grid
def _owners_on_grid(grid: Mesh) -> Ints:
    """Rank that owns each cell of a rectangular grid in DOLFINx's mesh. Collective."""
    from dolfinmpm.grid.lattice import lattice_of

    lattice = lattice_of(grid)
    assert lattice is not None
    own = lattice.cell_ijk[: grid.topology.index_map(grid.topology.dim).size_local]
    owner = np.zeros(lattice.shape, np.int32)
    owner[tuple(own.T)] = grid.comm.rank
    return np.asarray(grid.comm.allreduce(owner, op=MPI.SUM))


class LeafBasis:
    """Linear functions or splines on leaves, evaluated at points or averaged over their domains.

    Hanging nodes are nodes of the basis; `hanging` gives their values. "Cells" are leaves. All
    numberings belong to one set of leaves. With another set there is another basis. For splines
    the word "node" means a function.

    Args:
        base: Basis of the same functions on the cells of the grid.
        leaves: The leaves.
        layers: Layers of cells of the grid, around this rank's own cells, that it knows.
        partition: Which rank computes a cell of the grid; None if the owner in DOLFINx's mesh
            computes it.

    Attributes:
        knots: Knots around the cells (m), shape (cells, gdim, 2 degree); the cell is between the
            middle two, which are its corners for linear functions.
        corner_nodes: Nodes of the cells, the last direction fastest, shape (cells,
            (degree + 1)^gdim).
        hanging: Matrix from the nodes that do not hang to all nodes, shape (nodes, nodes).
        leaf: Number of each cell in the leaves of all ranks, shape (cells,).
    """

    coarsen = 1
    grid_nodes = None
    grid_cells = None

    def __init__(
        self, base: LatticeBasis, leaves: Leaves, layers: int, partition: Partition | None = None
    ):
        self._base, self.leaves, self.partition, self.layers = base, leaves, partition, layers
        every = LeafNodes.of(leaves) if self.degree == 1 else LeafSplines.of(leaves, self.degree)
        # functions of all ranks, and those that this rank knows
        self._functions, self._chosen = every, self._number(every, *self._known())
        tree, cells = leaves.tree, leaves.node[self.leaf]
        self.knots = knots_around(tree, self.degree, tree.low[cells], tree.size[cells])
        self._node_x = np.zeros((self._chosen.size, 3))
        self._node_x[:, : self.knots.shape[1]] = self.inner_knots.mean(axis=2)
        self._node_x.flags.writeable = False

    def _known(self) -> tuple[Ints, npt.NDArray[np.bool_]]:
        """Rank that owns each leaf, and mask of the leaves that this rank knows."""
        comm, shape = self.grid.comm, self.lattice.shape
        root = self.leaves.low >> self.leaves.tree.levels
        if comm.size == 1:
            return np.zeros(len(root), np.int32), np.ones(len(root), bool)
        if self.partition is None:
            owner = _owners_on_grid(self.grid)
        else:
            cells = np.indices(shape, np.int32).reshape(len(shape), -1).T
            owner = self.partition.rank_of(cells).reshape(shape)
        mask = dilated(owner == comm.rank, max(self.layers, 1))
        mask[tuple(self.lattice.cell_ijk.T)] = True
        at = tuple(root.T)
        return owner[at], mask[at]

    def _number(
        self, every: LeafNodes | LeafSplines, owner: Ints, known: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.intp]:
        """Number the leaves and nodes that this rank knows; returns the nodes, own ones first."""
        comm = self.grid.comm
        own_node = owner[every.first]
        flags = np.zeros(every.hanging.size, bool)
        flags[every.corners[known].ravel()] = True
        # masters of known nodes are known
        masters = every.matrix[np.flatnonzero(flags)].indices
        flags[masters] = True
        self.cells, self.leaf = _numbering(comm, owner, known)
        self.nodes, chosen = _numbering(comm, own_node, flags)
        place = np.full(every.hanging.size, -1, np.int32)
        place[chosen] = np.arange(chosen.size, dtype=np.int32)
        self.corner_nodes = place[every.corners[self.leaf]]
        self.hanging: sparse.csr_matrix = every.matrix[chosen][:, chosen].tocsr()
        self.hanging.sort_indices()
        self._cell_of = np.full(len(self.leaves.node), -1, np.int32)
        self._cell_of[self.leaf] = np.arange(self.leaf.size, dtype=np.int32)
        return chosen

    @property
    def grid(self) -> Mesh:
        """Background grid."""
        return self._base.grid

    @property
    def lattice(self) -> Lattice:
        """The grid of the roots."""
        return self.leaves.tree.lattice

    @property
    def averaged(self) -> bool:
        """Whether functions are averaged over the points' domains."""
        return self._base.averaged

    @property
    def degree(self) -> int:
        """Degree of the functions."""
        return self._base.degree

    @property
    def continuity(self) -> int:
        """Highest derivative that is continuous across facets."""
        return self._base.continuity

    @property
    def fine(self) -> Ints:
        """Numbers of the lines of the nodes on the finest level, shape (nodes, gdim)."""
        assert isinstance(self._functions, LeafNodes)
        return self._functions.fine[self._chosen]

    @property
    def levelled(self) -> Ints:
        """Level and position of each spline, shape (nodes, 1 + gdim); see `LeafSplines`."""
        assert isinstance(self._functions, LeafSplines)
        both = np.column_stack([self._functions.level, self._functions.index])
        return both[self._chosen]

    @functools.cached_property
    def inner_knots(self) -> Array:
        """Inner knots of the functions (m), shape (nodes, gdim, degree).

        For linear functions they are the positions of the nodes.
        """
        return self._functions.inner_knots(self.leaves.tree)[self._chosen]

    def integrals_outside(self) -> Array:
        """Integral of each independent spline where there are no leaves (m^d), shape (nodes,)."""
        assert isinstance(self._functions, LeafSplines)
        return self._functions.integrals_outside(self.leaves)[self._chosen]

    def node_coordinates(self) -> Array:
        """Positions (m) of the nodes, or Greville points of the splines, shape (nodes, 3)."""
        return self._node_x

    @functools.cached_property
    def _box(self) -> tuple[Array, Array]:
        low, high = (self.knots[..., self.degree - 1 + k] for k in (0, 1))
        return np.ascontiguousarray(low), np.ascontiguousarray(high)

    def cell_corners(self) -> tuple[Array, Array]:
        """Lower and upper corners of the cells (m), both of shape (cells, gdim)."""
        return self._box

    def cell_sizes(self) -> Array:
        """Sizes of the cells (m): d-th roots of their volumes, shape (cells,)."""
        low, high = self._box
        edges = high - low
        return np.asarray(np.prod(edges, axis=1) ** (1 / edges.shape[1]))

    @property
    def hangs(self) -> npt.NDArray[np.bool_]:
        """Mask of the hanging nodes, shape (nodes,)."""
        return np.asarray(self.hanging.diagonal() == 0.0)

    def node_sizes(self) -> Array:
        """Size of the smallest known cell at each node (m), shape (nodes,)."""
        sizes = np.full(self.nodes.size, np.inf)
        each = self.corner_nodes.shape[1]
        np.minimum.at(sizes, self.corner_nodes.ravel(), np.repeat(self.cell_sizes(), each))
        # a master of a hanging node may be known without its cells
        return np.where(np.isfinite(sizes), sizes, self.cell_sizes().max(initial=0.0))

    def cells_of_nodes(self) -> Ints:
        """Local cell of each cell of the tree, -1 for no leaf or an unknown one."""
        number = self.leaves.number
        return np.where(number >= 0, self._cell_of[number], -1).astype(np.int32)

    def cells_at(self, x: Array) -> Ints:
        """Local cells at positions x (m), shape (n, gdim); -1 where this rank knows no leaf."""
        _, leaf = self.leaves.overlapped(x, np.zeros_like(x))
        return np.where(leaf >= 0, self._cell_of[leaf], -1).astype(np.int32)

    def values_at(self, x: Array) -> tuple[npt.NDArray[np.intp], sparse.csr_matrix]:
        """Values of the functions at positions in leaves, upper sides included.

        Args:
            x: Positions (m), shape (n, gdim).

        Returns:
            Rows of the positions that are in leaves, and a matrix of the shape (rows, nodes).
        """
        cells = self.cells_at(x)
        # a position at the upper sides of the leaves is in none of them
        sizes = self.cell_sizes()
        least = 1e-6 * sizes.min() if sizes.size else 0.0
        for corner in np.ndindex(*(2,) * x.shape[1]):
            lost = np.flatnonzero(cells < 0)
            cells[lost] = self.cells_at(x[lost] - least * np.array(corner))
        rows = np.flatnonzero(cells >= 0)
        s = self.in_cells(x[rows], cells[rows])
        return rows, stencil_matrix(s, s.N, (rows.size, self.nodes.size))

    def _inwards(self, at: Array, x: Array, half: Array) -> Array:
        """Positions in domains, moved off the ends of the domains by more than rounding (m).

        The search for leaves begins in the roots, and rounds by their sizes.
        """
        rounding = np.empty_like(x)
        for d, line in enumerate(self.lattice.lines):
            ends = np.searchsorted(line, [x[:, d] - half[:, d], x[:, d] + half[:, d]], "right")
            low = line[np.maximum(ends[0] - 1, 0)]
            high = line[np.minimum(ends[1], line.size - 1)]
            rounding[:, d] = 4 * coordinate_rounding(low, high, SNAP)
        inside = np.maximum(half - rounding, 0.5 * half)
        return np.clip(at, x - inside, x + inside)

    def in_domains(self, at: Array, within: Array, x: Array, half: Array) -> Stencils:
        """Stencils of parts of domains, from functions of the leaves that the domains overlap.

        Args:
            at, within: Positions and half-lengths of the parts (m), shape (n, gdim).
            x, half: Positions and half-lengths of the domains (m), shape (n, gdim).
        """
        begin, leaf = self.leaves.overlapped(self._inwards(at, x, half), within)
        cells = np.where(leaf >= 0, self._cell_of[leaf], -1).astype(np.int32)
        # beyond the sides of the grid there are no functions to continue
        ends = np.array([[line[0], line[-1]] for line in self.lattice.lines])
        at = np.where(within > 0.0, at, np.clip(at, *ends.T))
        return self._stencils(at, within, begin, cells, False)

    def stencils(self, where: Placement) -> Stencils:
        """Stencils of the points, on all nodes. Collective.

        Args:
            where: The points.

        Raises:
            PointsOutsideGridError: A domain overlaps a leaf that this rank does not know.
        """
        half = where.half if self.averaged else np.zeros_like(where.x)
        begin, leaf = self.leaves.overlapped(where.x, half)
        cells = np.where(leaf >= 0, self._cell_of[leaf], -1).astype(np.int32)
        if not self.averaged:
            cells = self._in_filled_cells(where.x, cells)
        if cells.size and cells.min() < 0:
            raise PointsOutsideGridError(
                f"domains reach beyond the {self.layers} layers of cells that this rank knows "
                "around its own cells, or beyond the leaves of this step"
            )
        return self._stencils(where.x, half, begin, cells, where.axisymmetric)

    def _in_filled_cells(self, x: Array, cells: Ints) -> Ints:
        """Cells of points without domains; a point on a side takes a cell with other points.

        See `LatticeBasis`. Collective.
        """
        low, high = (corner[cells] for corner in self._box)
        h = high - low
        lower = self.lattice.lines
        inside = np.column_stack([x[:, d] > lower[d][0] + 0.5 * h[:, d] for d in range(x.shape[1])])
        on = inside & (x - low < coordinate_rounding(low, high, SNAP))
        some = on.any(axis=1)
        if not self.grid.comm.allreduce(bool(some.any()), op=MPI.LOR):
            return cells
        filled = np.zeros(self.cells.size, bool)
        filled[cells[~some]] = True
        filled = self.cells.share_flags(filled)
        rows, cells = np.flatnonzero(some), cells.copy()
        upper, left = cells[rows].copy(), np.ones(rows.size, bool)
        least = h[rows].min(axis=1, keepdims=True) * 2.0 ** -(self.leaves.tree.levels + 1)
        for below in np.ndindex(*(2,) * x.shape[1]):
            moved = on[rows] & np.array(below, bool)
            at = self.cells_at(np.where(moved, x[rows] - least, x[rows]))
            at[~moved.any(axis=1)] = upper[~moved.any(axis=1)]
            take = left & (at >= 0) & filled[at]
            cells[rows[take]] = at[take]
            left &= ~take
        return cells

    def in_cells(self, x: Array, cells: Ints) -> Stencils:
        """Stencils of positions from the functions of given cells, not averaged.

        Args:
            x: Positions (m), shape (n, gdim). Outside their cells, functions are continued.
            cells: Local cells, shape (n,).
        """
        begin = np.arange(len(x) + 1, dtype=np.int64)
        return self._stencils(x, np.zeros_like(x), begin, np.asarray(cells, np.int32), False)

    def _stencils(self, x, half, begin, cells, axisymmetric: bool) -> Stencils:
        hashes = np.empty(len(x), np.uint64)
        list_hashes(begin, cells, hashes)
        first = cells[begin[:-1]] if len(x) else cells
        order = np.lexsort((hashes, first)).astype(np.int32)
        starts = np.zeros(len(x), bool)
        starts_of_lists(order, begin, cells, starts)
        groups = np.append(np.flatnonzero(starts), len(x)).astype(np.int32)
        node_start = np.zeros(groups.size, np.int32)
        graph = order, groups, begin, cells, self.corner_nodes
        group_nodes(*graph, node_start, np.empty(0, np.int32))
        nodes = np.empty(node_start[-1], np.int32)
        if nodes.size:
            group_nodes(*graph, node_start, nodes)
        each = np.diff(node_start).astype(np.int64)
        value_start = running_sum(each * np.diff(groups), np.int64)
        N, dN = np.empty(value_start[-1]), np.empty((value_start[-1], x.shape[1]))
        places = np.ascontiguousarray(x), np.ascontiguousarray(half), axisymmetric
        where = *graph, node_start, nodes, value_start, N, dN
        if self.degree == 1:
            fill_stencils(*places, *self._box, *where)
        else:
            fill_spline_stencils(*places, self.knots, *where)
        head = order[groups[:-1]]
        cell_start = running_sum(np.diff(begin)[head], np.int32)
        at = np.arange(cell_start[-1]) + np.repeat(begin[:-1][head] - cell_start[:-1],
                                                   np.diff(cell_start))  # fmt: skip
        return Stencils(order, groups, node_start, nodes, value_start, N, dN, cell_start, cells[at])


def _numbering(
    comm: MPI.Intracomm, owner: Ints, known: npt.NDArray[np.bool_]
) -> tuple[Numbering, npt.NDArray[np.intp]]:
    """A numbering of known items, and their numbers in the order of all ranks.

    Args:
        comm: Communicator.
        owner: Rank of each item, shape (n,).
        known: Items that this rank knows, shape (n,); its own items among them.
    """
    order = np.argsort(owner, kind="stable")
    place = np.empty(owner.size, np.int64)
    place[order] = np.arange(owner.size)
    own = np.flatnonzero(owner == comm.rank)
    ghosts = np.flatnonzero(known & (owner != comm.rank))
    index_map = make_index_map(comm, own.size, place[ghosts], owner[ghosts])
    return Numbering(comm, index_map), np.concatenate([own, ghosts])
