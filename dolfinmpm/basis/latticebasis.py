"""Bases on rectangular grids: products of functions of one direction each.

The bases are linear functions, B-splines, and averages of both over the points' domains. GIMP is
the average of linear functions. The bases differ only in the functions of one direction.
"""

from __future__ import annotations

import copy

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.compat import make_index_map
from dolfinmpm._platform.errors import PointsOutsideGridError, raise_together
from dolfinmpm.basis.bspline import functions_of, greville
from dolfinmpm.basis.latticeloops import group_keys, largest_reach, overlaps, stencil_loop
from dolfinmpm.basis.stencils import Placement, Stencils, group_starts, running_sum
from dolfinmpm.grid.halo import LatticeHalo, Numbering, build_halo
from dolfinmpm.grid.lattice import Lattice, lattice_of
from dolfinmpm.grid.linecells import SNAP, coordinate_rounding
from dolfinmpm.grid.partition import Partition

__all__ = ["LatticeBasis", "first_parts"]


def first_parts(ijk: npt.NDArray[np.int32], by: int) -> npt.NDArray[np.int32]:
    """Coarse cells whose lowest part is among some cells, so that one rank owns each coarse cell.

    Args:
        ijk: Lattice positions of cells of the grid, shape (n, gdim).
        by: Number of cells of the grid per coarse cell and direction.

    Returns:
        Lattice positions of the coarse cells, shape (m, gdim).
    """
    return ijk[np.all(ijk % by == 0, axis=1)] // by


class LatticeBasis:
    """Products of linear functions or B-splines, or of their averages over domains.

    For B-splines the word "node" means a function.

    Args:
        grid: Background grid.
        lattice: Its lattice.
        degree: Degree of the functions: 1, 2 or 3.
        averaged: Whether functions are averaged over the points' domains.
        node_map: Index map of the nodes.
        node_ijk: Lattice positions of the nodes, shape (nodes, gdim).
        coarsen: Number of cells of the grid per cell of the lattice and direction. Above 1 the
            lattice is the grid's `Lattice.coarsened`. "Cells" are cells of the lattice.

    Attributes:
        partition: Which rank computes a cell; None if the owner in DOLFINx's mesh computes it.
        grid_nodes: Numbers in `nodes` of the nodes of the basis without a partition; None where
            the numbers are the same.
        grid_cells: For each cell of DOLFINx's mesh, the number in `cells` of the cell that
            contains it; None where the numbers are the same.
    """

    def __init__(
        self,
        grid: Mesh,
        lattice: Lattice,
        degree: int,
        averaged: bool,
        node_map,
        node_ijk,
        coarsen: int = 1,
    ):
        self.grid = grid
        self.coarsen = coarsen
        self.lattice = lattice
        self.degree = degree
        self.averaged = averaged
        # index map and lattice positions of the nodes without a partition
        self._node_numbering = node_map, node_ijk
        self.partition: Partition | None = None
        # lines of all directions, one after the other, and the start of each direction
        start = running_sum(np.array([x.size for x in lattice.lines]), np.int64)
        self._lines = np.concatenate(lattice.lines), start
        self._grown: dict[tuple[Partition | None, int], LatticeBasis] = {}
        self._surround(self._least_layers)

    @property
    def nodes(self) -> Numbering:
        """Numbering of the nodes that this rank knows."""
        return self.halo.nodes

    @property
    def cells(self) -> Numbering:
        """Numbering of the cells that this rank knows."""
        return self.halo.cells

    @property
    def continuity(self) -> int:
        """Highest derivative that is continuous across facets."""
        return self.degree - 1

    @property
    def _least_layers(self) -> int:
        # points near the edge of a coarse cell see its neighbours, whose activity must be known
        return int(self.averaged or self.degree > 1 or self.coarsen > 1)

    def own_cells(self) -> npt.NDArray[np.int32]:
        """Lattice positions of the grid's cells whose points this rank computes, shape (n, gdim).

        The positions are in the lattice of the grid, and not in a coarser one.
        """
        if self.partition is not None:
            return self.partition.cells(self.grid.comm.rank)
        fine = lattice_of(self.grid)
        assert fine is not None
        return fine.cell_ijk[: self.grid.topology.index_map(self.grid.topology.dim).size_local]

    def _surround(self, layers: int) -> None:
        grid, shape, on_grid = self.grid, self.lattice.shape, self.lattice.cell_ijk
        cells = grid.topology.index_map(grid.topology.dim), on_grid
        nodes, node_ijk = self._node_numbering, self._node_numbering[1]
        around = None
        if self.partition is not None or self.coarsen > 1:
            own = self.own_cells()
            if self.coarsen > 1:
                around = np.unique(own // self.coarsen, axis=0)
                own = first_parts(own, self.coarsen)
            cells = make_index_map(grid.comm, len(own), [], []), own
            if self.partition is not None:
                nodes = functions_of(grid.comm, own, shape, self.degree)
        self.halo: LatticeHalo = build_halo(
            grid.comm, shape, self.degree, *cells, *nodes, layers, on_grid, around
        )
        self._node_x: npt.NDArray[np.float64] | None = None
        self._corners: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None = None
        self.grid_cells: npt.NDArray[np.int32] | None = None
        self.grid_nodes: npt.NDArray[np.int32] | None = None
        origin = self.halo.origin
        if self.partition is not None or self.coarsen > 1:
            self.grid_cells = self.halo.cell_table[tuple((on_grid - origin).T)]
        if self.partition is not None:
            self.grid_nodes = self.halo.node_table[tuple((node_ijk - origin).T)]

    def grown(self, layers: int, partition: Partition | None = None) -> LatticeBasis:
        """The basis that knows all nodes and cells within some layers of own cells. Collective.

        The basis has its own numberings. Without a partition, owned nodes and cells and the ghosts
        of DOLFINx keep their numbers. The same arguments return the same object.

        Args:
            layers: Layers of cells around this rank's own cells.
            partition: Which rank computes a cell; None if the owner in DOLFINx's mesh computes it.
        """
        if self.grid.comm.size == 1:
            return self
        if partition is self.partition and layers <= self.halo.layers:
            return self
        # nobody asks again for the basis of an old partition
        for old in [k for k in self._grown if k[0] is not None and k[0] is not partition]:
            del self._grown[old]
        key = partition, max(layers, self._least_layers)
        if key not in self._grown:
            wider = copy.copy(self)
            wider.partition = partition
            wider._surround(key[1])
            self._grown[key] = wider
        return self._grown[key]

    def regrid(self, lattice: Lattice) -> None:
        """Replace the lattice by a lattice of the grid with the same number of lines.

        Numberings stay. Values that were computed from coordinates are dropped.

        Args:
            lattice: The new lattice of the grid, not coarsened.
        """
        lattice = lattice.coarsened(self.coarsen)
        self.lattice = lattice
        self._lines = np.concatenate(lattice.lines), self._lines[1]
        self._node_x = self._corners = None
        # copies with more overlap must be built again
        self._grown = {}

    def node_coordinates(self) -> npt.NDArray[np.float64]:
        """Positions (m) of the nodes, or Greville points of the splines, shape (nodes, 3)."""
        if self._node_x is None:
            x = np.zeros((self.nodes.size, 3))
            for d, line in enumerate(self.lattice.lines):
                x[:, d] = greville(line, self.degree)[self.halo.node_ijk[:, d]]
            # all steps in time share one array
            x.flags.writeable = False
            self._node_x = x
        return self._node_x

    def cell_corners(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Lower and upper corners of the cells (m), both of shape (cells, gdim)."""
        if self._corners is None:
            ijk, lines = self.halo.cell_ijk, enumerate(self.lattice.lines)
            both = [(line[ijk[:, d]], line[ijk[:, d] + 1]) for d, line in lines]
            low, high = (np.column_stack(side) for side in zip(*both))
            self._corners = low, high
        return self._corners

    def spans(self, x, half) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        """First cell that each domain overlaps, in the halo's tables, and number of cells.

        Args:
            x, half: Positions and half-lengths (m), shape (points, gdim).

        Returns:
            Two arrays of shape (points, gdim).
        """
        low, count = np.empty(x.shape, np.int32), np.empty(x.shape, np.int32)
        lattice, origin = self.lattice, self.halo.origin
        overlaps(x, half, *self._lines, lattice.uniform, origin, low, count)
        return low, count

    def _on_lines(self, x, low) -> npt.NDArray[np.bool_]:
        """Whether points without domains lie on the lower grid lines of their cells.

        Args:
            x: Positions (m), shape (points, gdim).
            low: Lattice positions of their cells, shape (points, gdim).

        Returns:
            One answer per point and direction, shape (points, gdim).
        """
        on = np.zeros(x.shape, bool)
        if not self.averaged:
            for d, line in enumerate(self.lattice.lines):
                i = low[:, d]
                least = coordinate_rounding(line[i], line[i + 1], SNAP)
                on[:, d] = (i > 0) & (x[:, d] - line[i] < least)
        return on

    def _in_filled_cells(self, x, low) -> npt.NDArray[np.int32]:
        """Cells of the points; a point on a grid line takes a cell with other points. Collective.

        A function that begins at the line is 0 at the line. It must make neither its node nor its
        cell active. The slope of such a linear function also belongs to a node without mass. From
        a cell that has other points, the point gets the body's gradient and nodes of other points.
        A point without such a neighbour stays in the upper cell.

        Args:
            x: Positions (m), shape (points, gdim).
            low: Positions of their cells in the halo's tables, shape (points, gdim). Points on
                grid lines have the upper cells.
        """
        on = self._on_lines(x, low + self.halo.origin)
        some = on.any(axis=1)
        if not self.grid.comm.allreduce(bool(some.any()), op=MPI.LOR):
            return low
        table, low = self.halo.cell_table, low.copy()
        filled = np.zeros(self.cells.size, bool)
        filled[table[tuple(low[~some].T)]] = True
        filled = self.cells.share_flags(filled)
        rows = np.flatnonzero(some)
        upper, left = low[rows], np.ones(rows.size, bool)
        for below in np.ndindex(*(2,) * x.shape[1]):
            cell = upper - on[rows] * np.array(below, np.int32)
            at = table[tuple(np.maximum(cell, 0).T)]
            take = left & np.all(cell >= 0, axis=1) & (at >= 0) & filled[at]
            low[rows[take]] = cell[take]
            left &= ~take
        return low

    def reach(self, where: Placement) -> tuple[int, int]:
        """Reach of the points' domains beyond their own cells, and their span. Collective.

        Args:
            where: The points.

        Returns:
            Most layers of cells around a point's own cell that its domain reaches, and most cells
            that a domain spans in one direction, over all ranks.

        Raises:
            PointsOutsideGridError: A domain spans more than 60 cells, the room in stencils.
        """
        layers, most, p = largest_reach(
            where.x, where.half, self.averaged, *self._lines, self.lattice.uniform
        )
        error = None
        if most > 60:
            error = PointsOutsideGridError(
                f"the domain of the point at {where.x[p]} m spans {most} cells, at most "
                f"60 are possible; its half-lengths are {where.half[p]} m: use a coarser grid, "
                "domains='volume' if the body flows, or basis='linear'"
            )
        raise_together(self.grid.comm, error)
        both = np.array([layers, most], np.int64)
        self.grid.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.MAX)
        return int(both[0]), int(both[1])

    def stencils(self, where: Placement) -> Stencils:
        """Stencils of the points. Collective.

        Args:
            where: The points.

        Raises:
            PointsOutsideGridError: A domain reaches beyond the cells and nodes that this rank
                knows; see `grown`.
        """
        half = where.half if self.averaged else np.zeros_like(where.x)
        low, count = self.spans(where.x, half)
        table = self.halo.cell_table.shape
        known = bool(np.all(low >= 0) and np.all(low + count <= table))
        if not self.averaged and self.grid.comm.allreduce(known, op=MPI.LAND):
            low = self._in_filled_cells(where.x, low)
        result = self.stencils_in(where.x, half, low, count, where.axisymmetric) if known else None
        if result is None:
            raise PointsOutsideGridError(
                f"domains reach beyond the {self.halo.layers} layers of cells that this rank "
                "knows around its own cells; take grown(layers)"
            )
        return result

    def stencils_in(self, x, half, low, count, axisymmetric: bool = False) -> Stencils | None:
        """Stencils for given overlapped cells; None if this rank does not know one of the nodes.

        Args:
            x, half: Positions and half-lengths (m), shape (points, gdim).
            low: Positions of the first overlapped cells in the halo's tables, shape (points, gdim).
            count: Numbers of overlapped cells, shape (points, gdim).
            axisymmetric: Whether the domains belong to an axisymmetric body.
        """
        halo, gdim = self.halo, x.shape[1]
        cell_shape = np.array(halo.cell_table.shape, np.int64)
        key = np.empty(len(x), np.int64)
        group_keys(low, count, cell_shape, key)
        order = np.argsort(key, kind="stable").astype(np.int32)
        groups = group_starts(key[order])
        spans = count[order[groups[:-1]]].astype(np.int64)
        nodes_each, cells_each = np.prod(spans + self.degree, axis=1), np.prod(spans, axis=1)
        node_start = running_sum(nodes_each, np.int32)
        cell_start = running_sum(cells_each, np.int32)
        value_start = running_sum(nodes_each * np.diff(groups), np.int64)
        s = Stencils(
            order, groups, node_start, np.empty(node_start[-1], np.int32), value_start,
            np.empty(value_start[-1]), np.empty((value_start[-1], gdim)),
            cell_start, np.empty(cell_start[-1], np.int32),
        )  # fmt: skip
        known = stencil_loop(gdim, self.degree == 1, axisymmetric)(
            x, half, *self._lines, halo.origin,
            halo.node_table.ravel(), np.array(halo.node_table.shape, np.int64),
            halo.cell_table.ravel(), cell_shape,
            order, groups, low, count, node_start, s.nodes, value_start, s.N, s.dN,
            cell_start, s.cells, self.degree, self.lattice.uniform,
        )  # fmt: skip
        return s if known else None
