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

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode
from mpi4py import MPI

from dolfinmpm.basis import LatticeBasis, LinearBasis, Placement, Stencils
from dolfinmpm.basis.space import lattice_basis
from dolfinmpm.basis.stencils import add_weighted, running_sum
from dolfinmpm.cut.fractions import domain_shares
from dolfinmpm.cut.pattern import Pattern
from dolfinmpm.cut.unknowns import FieldUnknowns
from dolfinmpm.grid.halo import Numbering
from dolfinmpm.grid.lattice import once_per_grid

__all__ = [
    "CellCouplings",
    "CellMeans",
    "Shares",
    "add_outer",
    "layers_needed",
    "numbering",
    "sharing",
]

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
def _lower_splines(grid, degree: int, averaged: bool, coarsen: int) -> LatticeBasis:
    """Splines for means alone: their overlap of ranks follows that of the basis above. Collective.

    The basis of a field on them would not do, for its numbering must not change when
    that of another one does.
    """
    return lattice_basis(grid, degree, averaged, coarsen)


def _over_splines(basis: LatticeBasis | LinearBasis) -> bool:
    """Whether means are taken over splines one degree lower, and not over cells."""
    return basis.degree > 1


def sharing(where: Placement, seen: Stencils, basis: LatticeBasis | LinearBasis) -> Stencils:
    """Stencils that tell which cells, or splines one degree lower, points share in. Collective.

    Args:
        where: The points as the stencils see them.
        seen: Their stencils.
        basis: The basis that these belong to.
    """
    if not _over_splines(basis):
        return seen
    return _lower(basis).stencils(where)


def _lower(basis: LatticeBasis | LinearBasis) -> LatticeBasis:
    """Splines one degree lower, with the same overlap of ranks. Collective."""
    assert isinstance(basis, LatticeBasis)
    lower = _lower_splines(basis.grid, basis.degree - 1, basis.averaged, basis.coarsen)
    return lower.grown(basis.halo.layers, basis.partition)


def shares_of(where: Placement, stencils: Stencils, basis: LatticeBasis | LinearBasis) -> Shares:
    """The points' shares in cells or, for splines, in those one degree lower. Collective.

    Args:
        where: The points as the stencils see them.
        stencils: What `sharing` gives, in any groups.
        basis: The basis of the field.
    """
    s = stencils
    if _over_splines(basis):
        return Shares(_lower(basis).nodes, s.node_start, s.nodes, s.value_start, s.N)
    start, values = domain_shares(where, s, basis)
    return Shares(basis.cells, s.cell_start, s.cells, start, values)


def numbering(basis: LatticeBasis) -> tuple[Numbering, npt.NDArray[np.int32]]:
    """What means are taken over: cells, or splines one degree lower. Collective.

    Args:
        basis: The basis of the field, with the overlap that is needed.

    Returns:
        Their numbering, and their lattice positions, shape (size, gdim).
    """
    if not _over_splines(basis):
        return basis.cells, basis.halo.cell_ijk
    lower = _lower(basis)
    return lower.nodes, lower.halo.node_ijk


def layers_needed(span: int, basis: LatticeBasis | LinearBasis) -> int:
    """Layers of cells beyond a rank's own that couplings of means need.

    The rank that owns a cell, or a lower spline, has to know all nodes that points in
    it see: their domains reach as far as they span cells, and the support of a spline of
    degree 1 or 2 to the neighbours of the cell that it is numbered with. Nodes that
    a prolongation puts in the place of others lie further off by as far as roots do.

    Args:
        span: Cells that a point's domain spans in one direction, at most.
        basis: The basis of the field.
    """
    return span - 1 + int(_over_splines(basis))


class CellMeans:
    """Means over cells, weighted with the points' volumes as they are now. Collective.

    Args:
        volume: Volumes of the points as they are now (m^d), shape (points,).
        where: The points as the stencils see them.
        stencils: What `sharing` gives, in any groups.
        basis: The basis of the field.

    Attributes:
        shares: Shares of the points in the cells.
        volume: W_c, the volume of the points in every local cell (m^d), shape (cells,).
        weight: V, the volumes of the points (m^d), shape (points,).
        exchanges: Whether points of some rank are in cells of another.
    """

    def __init__(
        self,
        volume: Array,
        where: Placement,
        stencils: Stencils,
        basis: LatticeBasis | LinearBasis,
    ):
        self.shares = shares = shares_of(where, stencils, basis)
        cells, of = shares.cells, shares.of
        self._graph = (
            stencils.order, stencils.groups, shares.cell_start, of, shares.start, shares.values
        )  # fmt: skip
        self._shared = cells.vector()
        # points of linear functions are in cells of their own rank only
        beyond = cells.comm.size > 1 and of.size > 0 and int(of.max()) >= cells.owned
        self.exchanges = cells.comm.size > 1 and cells.comm.allreduce(bool(beyond), op=MPI.LOR)
        self.weight = volume.copy()
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
        # points that do not share in it have none
        out = np.zeros(len(values))
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
    entry_start, entry, flux, column, out,
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
                    q = column + i * (1 + gdim)
                    f = N[at + a] * flux[p, q]
                    for j in range(gdim):
                        f += dN[at + a, j] * flux[p, q + 1 + j]
                    for k in range(number):
                        out[entry[entry_start[cell_start[g] + k] + a], i] += shares[share + k] * f


@numba.njit(cache=True, error_model="numpy")
def _add_outer(
    row_start, row_nodes, start, nodes, volume, left, right, row_of, column_of, indptr, indices,
    data, prescribed, lift,
):  # fmt: skip
    for c in range(start.size - 1):
        if volume[c] == 0.0:
            # domains reach into it, but no centre that counts
            continue
        # nodes and columns both increase: one walk along each row of the matrix
        for a in range(row_start[c], row_start[c + 1]):
            for i in range(left.shape[1]):
                row = row_of[row_nodes[a], i]
                if row < 0:
                    continue
                f = left[a, i] / volume[c]
                at = indptr[row]
                for b in range(start[c], start[c + 1]):
                    for k in range(right.shape[1]):
                        column = column_of[nodes[b], k]
                        if column >= 0:
                            while indices[at] != column:
                                at += 1
                            data[at] += f * right[b, k]
                        else:
                            lift[row_nodes[a], i] += f * right[b, k] * prescribed[nodes[b], k]


class CellCouplings:
    """The nodes of one field that points sharing a cell see: all are coupled. Collective.

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

    def lists(self) -> tuple[npt.NDArray, npt.NDArray] | None:
        """Lists of nodes that are coupled beyond those of the stencils; None if none are."""
        return None if self._simple else self.merged()

    def merged(self) -> tuple[npt.NDArray, npt.NDArray]:
        """Start and nodes of the cells that this rank adds to the matrix."""
        return (self._start, self._nodes) if self._exchange is None else self._exchange.lists

    def forces(self, components: int) -> Array:
        """Zeros, for every cell and each of its nodes, shape (entries, components)."""
        return np.zeros((self._nodes.size, components))

    def add_forces(self, first: int, last: int, flux: Array, column: int, out: Array) -> None:
        """Add Σ_p s_pc (N_a f_p + ∇N_a · q_p) over the points of some groups.

        Args:
            first: The first of the groups.
            last: The group behind the last.
            flux: f and q of every component, as `add_vector` takes them.
            column: First column of the field in the flux.
            out: Forces by cell and node, see `forces`.
        """
        s, shares = self._stencils, self.means.shares
        _add_forces(
            first, last, s.groups, s.node_start, s.value_start, s.N, s.dN, shares.cell_start,
            shares.start, shares.values, self._entry_start, self._entry, flux, column, out,
        )  # fmt: skip

    def summed(self, values: Array) -> Array:
        """What all ranks have by cell and node, on the entries of `merged`. Collective."""
        return values if self._exchange is None else self._exchange.merge(values)


def add_outer(
    rows: CellCouplings,
    columns: CellCouplings,
    left: Array,
    right: Array,
    unknowns: tuple[FieldUnknowns, FieldUnknowns],
    pattern: Pattern,
    data: Array,
    prescribed: Array,
    lift: Array,
) -> None:
    """Add Σ_c b_c g_cᵀ / W_c to the matrix. Collective.

    Args:
        rows, columns: Couplings of the row and the column field.
        left, right: b and g by cell and node, see `CellCouplings.forces`.
        unknowns: Unknowns of the two fields.
        pattern: Where the matrix has entries.
        data: The matrix's entries.
        prescribed: Values of the column field's prescribed components, (nodes, components).
        lift: The matrix's columns of prescribed unknowns, times their values; (nodes,
            components) of the row field.
    """
    _add_outer(
        *rows.merged(), *columns.merged(), rows.means.volume, rows.summed(left),
        columns.summed(right), unknowns[0].row_of, unknowns[1].row_of, pattern.indptr,
        pattern.indices, data, prescribed, lift,
    )  # fmt: skip


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

    def merge(self, values: Array) -> Array:
        """Sums over ranks, on the entries of `lists`. Collective."""
        every = np.concatenate([values[self._own], self._swap(values[self._send])])
        out = np.zeros((self.lists[1].size, values.shape[1]))
        np.add.at(out, self._to, every)
        return out
