"""Bases on rectangular grids: products of functions of one direction each.

Linear functions and B-splines, and the averages of both over the points' domains
(GIMP is that of linear functions), differ in the functions of one direction only.
"""

from __future__ import annotations

import copy
import functools

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.compat import make_index_map
from dolfinmpm._platform.errors import PointsOutsideGridError, raise_together
from dolfinmpm.basis.bspline import functions_of, greville
from dolfinmpm.basis.gimp import domain_weights
from dolfinmpm.basis.lineweights import (
    SNAP,
    cell_of,
    line_weights,
    overlapped,
    ring_slopes,
    snapped,
)
from dolfinmpm.basis.stencils import Placement, Stencils, group_starts, running_sum
from dolfinmpm.grid.halo import LatticeHalo, build_halo
from dolfinmpm.grid.lattice import Lattice, lattice_of
from dolfinmpm.grid.partition import Partition

__all__ = ["LatticeBasis", "first_parts"]


@numba.njit(cache=True, error_model="numpy")
def _overlaps(x, half, lines, line_start, uniform, origin, low, count):
    """First overlapped cell, counted from the origin, and number of them a direction."""
    for p in range(x.shape[0]):
        for d in range(x.shape[1]):
            line = lines[line_start[d] : line_start[d + 1]]
            first, number = overlapped(line, uniform, x[p, d], half[p, d])
            low[p, d], count[p, d] = first - origin[d], number


@numba.njit(cache=True, error_model="numpy")
def _reach(x, half, averaged, lines, line_start, uniform):
    """Most layers of cells that domains reach beyond those of their points, and cells across.

    Args:
        averaged: Whether points have domains; the cell below one without may be its own.

    Returns:
        Layers, cells that a domain spans at most, and the point whose it is.
    """
    layers, most, worst = 0, 1, 0
    for d in range(x.shape[1]):
        line = lines[line_start[d] : line_start[d + 1]]
        n = line.size - 1
        scale = n / (line[n] - line[0])
        for p in range(x.shape[0]):
            at, number = overlapped(line, uniform, x[p, d], half[p, d] if averaged else 0.0)
            # as `Lattice.cells_at` finds it
            own = int(np.floor((x[p, d] - line[0]) * scale)) if uniform else -1
            own = min(max(own, 0), n - 1) if uniform else cell_of(line, False, x[p, d])
            layers = max(layers, own - at, at + number - 1 - own)
            if number > most:
                most, worst = number, p
            if not averaged and at > 0 and layers < 1:
                layers = int(x[p, d] - line[at] < SNAP * (line[at + 1] - line[at]))
    return layers, most, worst


@numba.njit(cache=True, error_model="numpy")
def _keys(low, count, table_shape, key):
    for p in range(low.shape[0]):
        k, c = 0, 0
        for d in range(low.shape[1]):
            k = k * table_shape[d] + low[p, d]
            c = c * 64 + count[p, d]
        # 18 bits are room for 63 cells a direction in 3D
        key[p] = k * 262144 + c


@functools.cache
def _fill(linear: bool, axisymmetric: bool):
    """The loop that makes stencils, of linear functions without what splines need."""

    @numba.njit(cache=True, error_model="numpy")
    def kernel(
        x, half, lines, line_start, origin, node_table, node_shape, cell_table, cell_shape,
        order, groups, low, count, node_start, nodes, value_start, N, dN, cell_start, cells, degree,
        uniform,
    ):  # fmt: skip
        gdim = x.shape[1]
        S = np.empty((gdim, 64))
        dS = np.empty((gdim, 64))
        part = np.empty(degree + 1)
        slope = np.empty(degree + 1)
        largest = 1
        for g in range(groups.size - 1):
            largest = max(largest, node_start[g + 1] - node_start[g])
        local = np.empty(largest, np.int64)
        index = np.empty((largest, gdim), np.int64)
        rank = np.empty(largest, np.int64)
        known = True
        for g in range(groups.size - 1):
            p = order[groups[g]]
            m = node_start[g + 1] - node_start[g]
            for a in range(m):
                rest, at, size = a, 0, 1
                for d in range(gdim - 1, -1, -1):
                    index[a, d] = rest % (count[p, d] + degree)
                    rest //= count[p, d] + degree
                    at += size * (low[p, d] + index[a, d])
                    size *= node_shape[d]
                local[a] = node_table[at]
                known = known and local[a] >= 0
            # nodes in increasing order: assembly walks through the matrix rows once
            for a in range(m):
                before = 0
                for b in range(m):
                    if local[b] < local[a]:
                        before += 1
                rank[a] = before
                nodes[node_start[g] + before] = local[a]
            for a in range(cell_start[g + 1] - cell_start[g]):
                rest, at, size = a, 0, 1
                for d in range(gdim - 1, -1, -1):
                    at += size * (low[p, d] + rest % count[p, d])
                    rest //= count[p, d]
                    size *= cell_shape[d]
                cells[cell_start[g] + a] = cell_table[at]
                known = known and cell_table[at] >= 0
            for position in range(groups[g], groups[g + 1]):
                p = order[position]
                for d in range(gdim):
                    line = lines[line_start[d] : line_start[d + 1]]
                    first = origin[d] + low[p, d]
                    if linear:
                        at_x = snapped(line, first, x[p, d], half[p, d])
                        domain_weights(line, first, count[p, d], at_x, half[p, d], S[d], dS[d])
                    else:
                        line_weights(
                            line, uniform, degree, first, count[p, d], x[p, d], half[p, d], S[d],
                            dS[d], part, slope,
                        )  # fmt: skip
                if axisymmetric and half[p, 0] > 0.0:
                    ring_slopes(
                        lines[line_start[0] : line_start[1]], uniform, degree,
                        origin[0] + low[p, 0], count[p, 0], x[p, 0], half[p, 0], dS[0], part, slope,
                    )  # fmt: skip
                start = value_start[g] + (position - groups[g]) * m
                for a in range(m):
                    to, product = start + rank[a], 1.0
                    for d in range(gdim):
                        product *= S[d, index[a, d]]
                        slope_d = dS[d, index[a, d]]
                        for e in range(gdim):
                            if e != d:
                                slope_d *= S[e, index[a, e]]
                        dN[to, d] = slope_d
                    N[to] = product
        return known

    return kernel


def first_parts(ijk: npt.NDArray[np.int32], by: int) -> npt.NDArray[np.int32]:
    """Coarse cells, given by positions, of which some cells are the lowest parts, shape (n, gdim).

    So a coarse cell that several ranks have parts of is one rank's own.
    """
    return ijk[np.all(ijk % by == 0, axis=1)] // by


class LatticeBasis:
    """Products of linear functions or B-splines, or of their averages over domains.

    What is said of nodes holds for B-splines too: a node is then a function.

    Args:
        grid: Background grid.
        lattice: Its lattice.
        degree: Degree of the functions: 1, 2 or 3.
        averaged: Whether functions are averaged over the points' domains.
        node_map: Index map of the nodes.
        node_ijk: Lattice position of its nodes, shape (nodes, gdim).
        coarsen: How many of the grid's lines there are to one of the lattice's, which is then
            `Lattice.coarsened`. Cells are those of the lattice.

    Attributes:
        nodes, cells: Numberings of the nodes and cells that are known here.
        partition: Which rank computes a cell; None for the one that has it in DOLFINx's mesh.
        grid_nodes, grid_cells: The nodes that `nodes` has without a partition, and the cells that
            those of DOLFINx's mesh are, or are part of, as they are numbered here; None where
            the numbers are the same.
        continuity: Highest derivative that is continuous across facets.
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
        self.continuity = degree - 1
        self._node_map = node_map
        self._node_ijk = node_ijk
        self.partition: Partition | None = None
        self._lines = np.concatenate(lattice.lines)
        self._line_start = running_sum(np.array([x.size for x in lattice.lines]), np.int64)
        self._grown: dict[tuple[Partition | None, int], LatticeBasis] = {}
        self._surround(self._least_layers)

    @property
    def _least_layers(self) -> int:
        # beside a coarse cell points see others, and which cells are active is asked for
        return int(self.averaged or self.degree > 1 or self.coarsen > 1)

    def own_cells(self) -> npt.NDArray[np.int32]:
        """Lattice positions of the grid's cells whose points this rank computes, shape (n, gdim).

        Of the grid's own lattice, and not of a coarser one.
        """
        if self.partition is not None:
            return self.partition.cells(self.grid.comm.rank)
        fine = lattice_of(self.grid)
        assert fine is not None
        return fine.cell_ijk[: self.grid.topology.index_map(self.grid.topology.dim).size_local]

    def _surround(self, layers: int) -> None:
        grid, shape, on_grid = self.grid, self.lattice.shape, self.lattice.cell_ijk
        cells = grid.topology.index_map(grid.topology.dim), on_grid
        nodes = self._node_map, self._node_ijk
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
        self.nodes = self.halo.nodes
        self.cells = self.halo.cells
        self._node_x: npt.NDArray[np.float64] | None = None
        self._corners: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None = None
        self.grid_cells: npt.NDArray[np.int32] | None = None
        self.grid_nodes: npt.NDArray[np.int32] | None = None
        origin = self.halo.origin
        if self.partition is not None or self.coarsen > 1:
            self.grid_cells = self.halo.cell_table[tuple((on_grid - origin).T)]
        if self.partition is not None:
            self.grid_nodes = self.halo.node_table[tuple((self._node_ijk - origin).T)]

    def grown(self, layers: int, partition: Partition | None = None) -> LatticeBasis:
        """The basis that knows what is within so many layers of this rank's own cells. Collective.

        It has numberings of its own. Without a partition the owned nodes and cells, and the ghosts
        of DOLFINx, are the same in them. Asked again, it is the same one.

        Args:
            layers: Layers of cells.
            partition: Which rank computes a cell; None for the one that has it in DOLFINx's mesh.
        """
        if self.grid.comm.size == 1:
            return self
        if partition is self.partition and layers <= self.halo.layers:
            return self
        # bases of a partition that is no more are not asked for again
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
        """Take a lattice of the grid of as many lines in place of the own one.

        Numberings stay; what was computed from places does not.
        """
        lattice = lattice.coarsened(self.coarsen)
        self.lattice = lattice
        self._lines = np.concatenate(lattice.lines)
        self._node_x = self._corners = None
        # copies with more overlap are made anew
        self._grown = {}

    def node_coordinates(self) -> npt.NDArray[np.float64]:
        """Positions of the nodes, the Greville points of splines (m), shape (nodes, 3)."""
        if self._node_x is None:
            x = np.zeros((self.nodes.size, 3))
            for d, line in enumerate(self.lattice.lines):
                x[:, d] = greville(line, self.degree)[self.halo.node_ijk[:, d]]
            # every step in time asks for them
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

    def _spans(self, where: Placement, origin):
        """Half-lengths that count, and first overlapped cell and number of them a direction."""
        x = where.x
        half = where.half if self.averaged else np.zeros_like(x)
        low, count = np.empty(x.shape, np.int32), np.empty(x.shape, np.int32)
        lattice = self.lattice
        _overlaps(x, half, self._lines, self._line_start, lattice.uniform, origin, low, count)
        return half, low, count

    def spans(self, x, half) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        """The first cell that each domain overlaps, in the halo's tables, and number of them.

        Args:
            x, half: Positions and half-lengths (m), shape (points, gdim).

        Returns:
            Two arrays of shape (points, gdim).
        """
        low, count = np.empty(x.shape, np.int32), np.empty(x.shape, np.int32)
        lattice, origin = self.lattice, self.halo.origin
        _overlaps(x, half, self._lines, self._line_start, lattice.uniform, origin, low, count)
        return low, count

    def _on_lines(self, x, low) -> npt.NDArray[np.bool_]:
        """Whether points without domains are on the lower grid lines of their cells, a direction.

        Args:
            x: Positions (m), shape (points, gdim).
            low: Lattice position of their cells, likewise.
        """
        on = np.zeros(x.shape, bool)
        if not self.averaged:
            for d, line in enumerate(self.lattice.lines):
                i = low[:, d]
                on[:, d] = (i > 0) & (x[:, d] - line[i] < SNAP * (line[i + 1] - line[i]))
        return on

    def _beside_others(self, x, low) -> npt.NDArray[np.int32]:
        """Cells of points on grid lines: one that others are in, if any is beside. Collective.

        A function that begins at the line is 0 there and must make no node active, nor its first
        cell; and the slope of a linear one is that towards a node without mass. Seen from a cell
        of the body such a point has its gradient, and sees nodes that others see. One that is
        alone is in the upper cell.

        Args:
            x: Positions (m), shape (points, gdim).
            low: Positions of their cells in the halo's tables, the upper ones on grid lines.
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
        """How far the points' domains reach beyond their own cells, and across. Collective.

        Args:
            where: The points.

        Returns:
            Layers of cells around a point's own cell that its domain reaches, and cells that
            it spans in one direction, at most, over all ranks.

        Raises:
            PointsOutsideGridError: A domain spans more cells than stencils have room for.
        """
        layers, most, p = _reach(
            where.x, where.half, self.averaged, self._lines, self._line_start, self.lattice.uniform
        )
        error = None
        if most > 60:
            error = PointsOutsideGridError(
                f"the domain of the point at {where.x[p]} m spans {most} cells, at most "
                f"60 are possible; its half-lengths are {where.half[p]} m: use a coarser grid, "
                "domains='volume' where the body flows, or basis='linear'"
            )
        raise_together(self.grid.comm, error)
        both = np.array([layers, most], np.int64)
        self.grid.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.MAX)
        return int(both[0]), int(both[1])

    def stencils(self, where: Placement) -> Stencils:
        """Stencils of the points; the overlap must hold all nodes that they see. Collective.

        Args:
            where: The points.

        Raises:
            PointsOutsideGridError: A domain reaches beyond the overlap; see `grown`.
        """
        half, low, count = self._spans(where, self.halo.origin)
        table = self.halo.cell_table.shape
        known = bool(np.all(low >= 0) and np.all(low + count <= table))
        if not self.averaged and self.grid.comm.allreduce(known, op=MPI.LAND):
            low = self._beside_others(where.x, low)
        result = self.stencils_in(where.x, half, low, count, where.axisymmetric) if known else None
        if result is None:
            raise PointsOutsideGridError(
                f"domains reach beyond the {self.halo.layers} layers of cells that are known "
                "around this rank's own; take grown(layers)"
            )
        return result

    def stencils_in(self, x, half, low, count, axisymmetric: bool = False) -> Stencils | None:
        """Stencils where the overlapped cells are given; None if a node is not known here.

        Args:
            x, half: Positions and half-lengths (m), shape (points, gdim).
            low: Position of the first overlapped cell in the halo's tables, likewise.
            count: Number of overlapped cells, likewise.
            axisymmetric: Whether domains are those of a body of revolution.
        """
        halo, gdim = self.halo, x.shape[1]
        cell_shape = np.array(halo.cell_table.shape, np.int64)
        key = np.empty(len(x), np.int64)
        _keys(low, count, cell_shape, key)
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
        known = _fill(self.degree == 1, axisymmetric)(
            x, half, self._lines, self._line_start, halo.origin,
            halo.node_table.ravel(), np.array(halo.node_table.shape, np.int64),
            halo.cell_table.ravel(), cell_shape,
            order, groups, low, count, node_start, s.nodes, value_start, s.N, s.dN,
            cell_start, s.cells, self.degree, self.lattice.uniform,
        )  # fmt: skip
        return s if known else None
