"""Means of what stands at the material points, over cells or splines, and their couplings.

A scalar m at the points has in cell c the mean M_c = Σ_q s_qc V_q m_q / W_c with
W_c = Σ_q s_qc V_q, over the points of all ranks whose domains lie in the cell by the
shares s_qc, and at point p the mean m̄_p = Σ_c s_pc M_c. What depends on it couples
all nodes seen by points that share a cell: the tangent gains Σ_c b_c g_cᵀ / W_c,
where b_c sums up what the points in the cell do to the forces when its mean
changes, and g_c how W_c M_c changes with the nodal increments.

Splines of degree 2 and more can alternate from cell to cell without a mean over any cell:
there would be no stiffness against such a change of volume. Their means are those of
the splines one degree lower on the same cells, as in the B-bar and F-bar projections of
Elguedj, Bazilevs, Calo & Hughes (2008, doi 10.1016/j.cma.2008.01.012), with the mass
matrix lumped: s_pc is the value at the point of the lower spline c, averaged over the
point's domain as the basis is. Shares in cells and in splines alike are not negative and
sum to 1 at a point, and what is said of a cell below holds for a lower spline too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.assembly.points import Pattern
from dolfinmpm.basis import LatticeBasis, LinearBasis, Stencils
from dolfinmpm.basis.bspline import number_functions
from dolfinmpm.basis.stencils import add_weighted, running_sum
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.fractions import domain_shares
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.grid.halo import Numbering
from dolfinmpm.grid.lattice import once_per_grid, require_lattice

__all__ = ["CellCouplings", "CellMeans", "Shares", "layers_needed", "shares_of", "widen"]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def _to_points(order, groups, cell_start, cells, share_start, shares, values, out):
    for g in range(groups.size - 1):
        number = cell_start[g + 1] - cell_start[g]
        for position in range(groups[g], groups[g + 1]):
            start = share_start[g] + (position - groups[g]) * number
            value = 0.0
            for k in range(number):
                value += shares[start + k] * values[cells[cell_start[g] + k]]
            out[order[position]] = value


@dataclass(frozen=True)
class Shares:
    """Shares of the points in cells or lower splines; those of a point sum to 1.

    Attributes:
        cells: Numbering of the cells, or of the splines.
        cell_start: First entry of every group of the stencils in `of`, shape (groups + 1,).
        of: Local indices of the cells that the group's points share in.
        start: First entry of every group in `values`, shape (groups + 1,).
        values: The shares (-): for each of a group's points one row of the group's cells.
    """

    cells: Numbering
    cell_start: npt.NDArray[np.int32]
    of: npt.NDArray[np.int32]
    start: npt.NDArray[np.int64]
    values: Array


@once_per_grid
def _lower_splines(grid, degree: int, averaged: bool) -> LatticeBasis:
    """Splines for means alone: their overlap of ranks follows that of the basis above. Collective.

    The basis of a field on them would not do, for its numbering must not change when
    that of another one does.
    """
    lattice = require_lattice(grid, "a mean over splines")
    node_map, ijk = number_functions(grid, lattice, degree)
    return LatticeBasis(grid, lattice, degree, averaged, node_map, ijk)


def _over_splines(basis: LatticeBasis | LinearBasis) -> bool:
    """Whether means are taken over splines one degree lower, and not over cells."""
    return basis.degree > 1


def shares_of(
    points: MaterialPoints, stencils: Stencils, basis: LatticeBasis | LinearBasis
) -> Shares:
    """The points' shares in cells or, for splines, in those one degree lower. Collective.

    Args:
        points: Material points; reads x and l.
        stencils: Their stencils.
        basis: The basis that these belong to.
    """
    if not _over_splines(basis):
        start, values = domain_shares(points, stencils, basis)
        return Shares(basis.cells, stencils.cell_start, stencils.cells, start, values)
    assert isinstance(basis, LatticeBasis)
    lower = _lower_splines(basis.grid, basis.degree - 1, basis.averaged)
    # with as many layers both have the same tables of cells, and so the same groups of points
    lower.extend(basis.halo.layers)
    s = lower.stencils(points)
    return Shares(lower.nodes, s.node_start, s.nodes, s.value_start, s.N)


def layers_needed(stencils: Stencils, basis: LatticeBasis | LinearBasis) -> int:
    """Layers of cells beyond a rank's own that couplings of means need. Collective.

    The rank that owns a cell, or a lower spline, has to know all nodes that points in
    it see: their domains reach as far as they span cells, and the support of a spline of
    degree 1 or 2 to the neighbours of the cell that it is numbered with. Nodes that
    a prolongation puts in the place of others may lie further off; see
    `CellCouplings.complete`.

    Args:
        stencils: Stencils of the points, before any prolongation.
        basis: The basis that these belong to.
    """
    if not isinstance(basis, LatticeBasis) or not (basis.averaged or basis.degree > 1):
        return 0
    span = 1
    if stencils.cells.size:
        ijk = basis.halo.cell_ijk[stencils.cells]
        first = stencils.cell_start[:-1]
        spans = np.maximum.reduceat(ijk, first) - np.minimum.reduceat(ijk, first) + 1
        span = int(spans.max())
    span = basis.grid.comm.allreduce(span, op=MPI.MAX)
    return span - 1 + int(_over_splines(basis))


class CellMeans:
    """Means over cells, weighted with the points' volumes as they are now. Collective.

    Args:
        points: Material points; reads V, x and, for the shares, l.
        stencils: Their stencils.
        basis: The basis that these belong to.

    Attributes:
        shares: Shares of the points in the cells.
        volume: W_c, the volume of the points in every local cell (m^d), shape (cells,).
        weight: V, the volumes of the points (m^d), shape (points,).
        exchanges: Whether points of some rank are in cells of another.
    """

    def __init__(
        self, points: MaterialPoints, stencils: Stencils, basis: LatticeBasis | LinearBasis
    ):
        self.shares = shares = shares_of(points, stencils, basis)
        cells, of = shares.cells, shares.of
        self._graph = (
            stencils.order, stencils.groups, shares.cell_start, of, shares.start, shares.values
        )  # fmt: skip
        self._shared = cells.vector()
        # points of linear functions are in cells of their own rank only
        beyond = cells.comm.size > 1 and of.size > 0 and int(of.max()) >= cells.owned
        self.exchanges = cells.comm.size > 1 and cells.comm.allreduce(bool(beyond), op=MPI.LOR)
        self.weight = points["V"].copy()
        self.volume = self._sums(self.weight).copy()

    def _sums(self, values: Array) -> Array:
        out = self._shared.array
        out[:] = 0.0
        add_weighted(*self._graph, values, out)
        if self.exchanges:
            self._shared.scatter_reverse(InsertMode.add)
            self._shared.scatter_forward()
        return out

    def mean(self, values: Array) -> Array:
        """Means m̄ at the points of a scalar m at the points, shape (points,). Collective."""
        sums = self._sums(self.weight * values)
        of_cell = np.divide(sums, self.volume, out=np.zeros_like(sums), where=self.volume > 0)
        out = np.empty(len(values))
        _to_points(*self._graph, of_cell, out)
        return out


@numba.njit(cache=True, error_model="numpy")
def _cell_nodes(
    node_start, nodes, group_of, first, of_cell, seen, place, start, out, entry_start, entry
):
    """Nodes seen by the points in every cell, in increasing order; only counts if `out` is empty.

    For each pair of group and cell, `entry` says where the group's nodes stand in `out`.
    """
    total = 0
    for c in range(first.size - 1):
        for k in range(first[c], first[c + 1]):
            g = group_of[of_cell[k]]
            for b in range(node_start[g], node_start[g + 1]):
                if seen[nodes[b]] != c:
                    seen[nodes[b]] = c
                    if out.size:
                        out[total] = nodes[b]
                    total += 1
        start[c + 1] = total
        if out.size:
            out[start[c] : total].sort()
            for b in range(start[c], total):
                place[out[b]] = b
            for k in range(first[c], first[c + 1]):
                pair = of_cell[k]
                g = group_of[pair]
                for b in range(node_start[g + 1] - node_start[g]):
                    entry[entry_start[pair] + b] = place[nodes[node_start[g] + b]]


@numba.njit(cache=True, error_model="numpy")
def _add_forces(
    begin, end, groups, node_start, value_start, N, dN, cell_start, share_start, shares,
    entry_start, entry, flux, out,
):  # fmt: skip
    components, gdim = out.shape[1], dN.shape[1]
    for g in range(begin, end):
        m = node_start[g + 1] - node_start[g]
        number = cell_start[g + 1] - cell_start[g]
        for position in range(groups[g], groups[g + 1]):
            p = position - groups[begin]
            at = value_start[g] + (position - groups[g]) * m
            share = share_start[g] + (position - groups[g]) * number
            for a in range(m):
                for i in range(components):
                    f = N[at + a] * flux[p, i * (1 + gdim)]
                    for j in range(gdim):
                        f += dN[at + a, j] * flux[p, i * (1 + gdim) + 1 + j]
                    for k in range(number):
                        out[entry[entry_start[cell_start[g] + k] + a], i] += shares[share + k] * f


@numba.njit(cache=True, error_model="numpy")
def _add_outer(start, nodes, volume, left, right, row_of, indptr, indices, data, prescribed, lift):
    components = left.shape[1]
    for c in range(start.size - 1):
        # nodes and columns both increase: one walk along each row of the matrix
        for a in range(start[c], start[c + 1]):
            for i in range(components):
                row = row_of[nodes[a], i]
                if row < 0:
                    continue
                f = left[a, i] / volume[c]
                at = indptr[row]
                for b in range(start[c], start[c + 1]):
                    for k in range(components):
                        column = row_of[nodes[b], k]
                        if column >= 0:
                            while indices[at] != column:
                                at += 1
                            data[at] += f * right[b, k]
                        else:
                            lift[nodes[a], i] += f * right[b, k] * prescribed[nodes[b], k]


class CellCouplings:
    """What couples all nodes seen by points that share a cell. Collective.

    A cell at a rank border has points of several ranks: what they contribute goes
    to the rank that owns the cell, which adds the products to the matrix.

    Args:
        means: Means over the cells.
        stencils: Stencils on the solver's nodes.
        numbering: Numbering of the nodes.
        nodes: The solver's active nodes known here.

    Attributes:
        means: The means.
        complete: Whether every rank knows the nodes seen by points in its cells; the
            couplings cannot be used otherwise.
    """

    def __init__(self, means: CellMeans, stencils: Stencils, numbering, nodes):
        self.means = means
        self._stencils = s = stencils
        cells, of = means.shares.cells, means.shares.of
        pairs = np.diff(means.shares.cell_start)
        group_of = np.repeat(np.arange(pairs.size), pairs)
        first = running_sum(np.bincount(of, minlength=cells.size), np.int64)
        of_cell = np.argsort(of, kind="stable")
        self._start = np.zeros(cells.size + 1, np.int64)
        self._entry_start = running_sum(np.diff(s.node_start)[group_of], np.int64)
        self._entry = np.empty(self._entry_start[-1], np.int64)
        place = np.empty(numbering.size, np.int64)
        out = np.empty(0, np.int32)
        for _ in range(2):  # first count, then fill
            _cell_nodes(
                s.node_start, s.nodes, group_of, first, of_cell, np.full(numbering.size, -1), place,
                self._start, out, self._entry_start, self._entry,
            )  # fmt: skip
            if out.size == self._start[-1]:
                break
            out = np.empty(self._start[-1], np.int32)
        self._nodes = out
        # where every cell has one group the stencils have all couplings already
        self._simple = not means.exchanges and bool(np.all(np.diff(first) <= 1))
        self.complete = True
        self._exchange: _Exchange | None = None
        if means.exchanges:
            self._exchange = _Exchange(cells, numbering, nodes, self._start, self._nodes)
            self.complete = self._exchange.complete

    def graph(self) -> Stencils:
        """The stencils, and behind their groups the nodes of every cell; for `Pattern.build`."""
        s = self._stencils
        if self._simple:
            return s
        start, nodes = self._merged()
        return replace(
            s,
            node_start=np.concatenate([s.node_start, s.node_start[-1] + start[1:]]).astype(
                np.int64
            ),
            nodes=np.concatenate([s.nodes, nodes]),
        )

    def _merged(self):
        """Nodes of the cells that this rank adds to the matrix."""
        return (self._start, self._nodes) if self._exchange is None else self._exchange.lists

    def forces(self, components: int) -> Array:
        """Zeros, for every cell and each of its nodes, shape (entries, components)."""
        return np.zeros((self._nodes.size, components))

    def add_forces(self, first: int, last: int, flux: Array, out: Array) -> None:
        """Add Σ_p s_pc (N_a f_p + ∇N_a · q_p) over the points of some groups.

        Args:
            first: The first of the groups.
            last: The group behind the last.
            flux: f and q of every component, as `add_vector` takes them.
            out: Forces by cell and node, see `forces`.
        """
        s, shares = self._stencils, self.means.shares
        _add_forces(
            first, last, s.groups, s.node_start, s.value_start, s.N, s.dN, shares.cell_start,
            shares.start, shares.values, self._entry_start, self._entry, flux, out,
        )  # fmt: skip

    def add_outer(
        self, left: Array, right: Array, unknowns: Unknowns, pattern: Pattern, data: Array,
        lift: Array,
    ) -> None:  # fmt: skip
        """Add Σ_c b_c g_cᵀ / W_c to the matrix. Collective.

        Args:
            left, right: b and g by cell and node, see `forces`.
            unknowns: Rows of the nodes.
            pattern: Where the matrix has entries.
            data: The matrix's entries.
            lift: Its columns of prescribed unknowns, times their values; shape
                (nodes, components).
        """
        start, nodes = self._merged()
        if self._exchange is not None:
            left, right = self._exchange.merge(left, right)
        _add_outer(
            start, nodes, self.means.volume, left, right, unknowns.row_of, pattern.indptr,
            pattern.indices, data, unknowns.prescribed, lift,
        )  # fmt: skip


def widen(basis: LatticeBasis | LinearBasis) -> None:
    """Let ranks know one more layer of the nodes that points of others see. Collective.

    Raises:
        ParameterError: The whole grid is known already.
    """
    if not isinstance(basis, LatticeBasis) or basis.halo.layers > max(basis.lattice.shape):
        raise ParameterError(
            "a prolongation ties nodes at a rank border differently on the two sides; make it a "
            "function of the nodes' positions alone"
        )
    basis.extend(basis.halo.layers + 1)


class _Exchange:
    """Brings what ranks have for the nodes of a cell to the rank that owns the cell. Collective.

    Args:
        cells, numbering: Numberings of cells and nodes.
        active: The solver's active nodes known here.
        start, nodes: Nodes of every local cell.

    Attributes:
        complete: Whether all nodes that came are known where they came, on all ranks.
        lists: Start and nodes of the owned cells, with those that came.
    """

    def __init__(self, cells, numbering, active, start, nodes):
        self._comm = comm = cells.comm
        self._cell_of = cell_of = np.repeat(np.arange(cells.size), np.diff(start))
        own = cell_of < cells.owned
        owner = cells.index_map.owners[cell_of[~own] - cells.owned]
        ranked = np.argsort(owner, kind="stable")
        self._send = np.flatnonzero(~own)[ranked]
        self._own = np.flatnonzero(own)
        self._counts = np.bincount(owner, minlength=comm.size)
        self._arriving = np.empty_like(self._counts)
        comm.Alltoall(self._counts, self._arriving)
        to_global = numbering.index_map.local_to_global(nodes[self._send])
        cell_global = cells.index_map.local_to_global(cell_of[self._send].astype(np.int32))
        came = self._swap(np.column_stack([cell_global, to_global]).astype(np.int64))
        cell = came[:, 0] - cells.index_map.local_range[0]
        node = numbering.index_map.global_to_local(np.ascontiguousarray(came[:, 1]))
        usable = np.zeros(numbering.size, bool)
        usable[active] = True
        known = bool(np.all(node >= 0)) and bool(np.all(usable[node]))
        self.complete = comm.allreduce(known, op=MPI.LAND)
        if not self.complete:
            return
        keys = np.concatenate([cell_of[own], cell]) * numbering.size
        keys += np.concatenate([nodes[own], node])
        merged, self._to = np.unique(keys, return_inverse=True)
        counts = np.bincount(merged // numbering.size, minlength=cells.owned)
        self.lists = running_sum(counts, np.int64), (merged % numbering.size).astype(np.int32)

    def _swap(self, rows):
        """Rows for other ranks, against those that came from them."""
        width = rows.shape[1]
        came = np.empty((self._arriving.sum(), width), rows.dtype)
        send = [np.ascontiguousarray(rows), self._counts * width]
        self._comm.Alltoallv(send, [came, self._arriving * width])
        return came

    def merge(self, left: Array, right: Array) -> tuple[Array, Array]:
        """Sums over ranks, on the entries of `lists`. Collective."""
        both = np.hstack([left, right])
        every = np.concatenate([both[self._own], self._swap(both[self._send])])
        out = np.zeros((self.lists[1].size, both.shape[1]))
        np.add.at(out, self._to, every)
        n = left.shape[1]
        return np.ascontiguousarray(out[:, :n]), np.ascontiguousarray(out[:, n:])
