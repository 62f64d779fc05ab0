"""Couplings by averages over cells: the nodes of all points with a share in a cell.

Terms that depend on the averages of `dolfinmpm.cut.cellaverages` couple all nodes of points with a
share in the same cell. The tangent gains Σ_c b_c g_cᵀ / W_c. Here b_c is the derivative of the
forces by the average of cell c, summed over the points in the cell, and g_c is the derivative of
W_c M_c by the nodal increments.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.simd import axpy, load, store
from dolfinmpm.basis import Stencils
from dolfinmpm.basis.incidence import by_nodes
from dolfinmpm.basis.stencils import running_sum
from dolfinmpm.cut.cellaverages import CellAverages
from dolfinmpm.cut.pattern import Pattern
from dolfinmpm.cut.unknowns import FieldUnknowns

__all__ = ["CellCouplings", "add_outer"]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def _cell_nodes(
    node_start, nodes, group_of, first, of_cell, seen, place, start, out, entry_start, entry
):
    """Nodes of the points in every cell, in increasing order; only counts if `out` is empty.

    For each pair of group and cell, `entry` has the positions of the group's nodes in `out`.
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
                        if shares[share + k] != 0.0:
                            at_entry = entry[entry_start[cell_start[g] + k] + a]
                            out[at_entry, i] += shares[share + k] * f


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _add_outer(
    row_start, row_nodes, start, nodes, volume, left, right, row_of, column_of, indptr, indices,
    data, prescribed, lift,
):  # fmt: skip
    """Node by node: the node's rows are summed over its cells in the cache, then added once."""
    if row_nodes.size == 0:
        return
    low, first, lists, places = by_nodes(0, row_start.size - 1, row_start, row_nodes)
    height, width = left.shape[1], right.shape[1]
    slot, names = np.full(column_of.shape[0], -1, np.int32), np.empty(column_of.shape[0], np.int32)
    place, f = np.empty(indptr.size - 1, np.int32), np.empty(height)
    # a vector of four numbers for each component of a row
    sums, vectors = np.empty((64, 4 * height)), np.zeros((right.shape[0], 4))
    vectors[:, :width] = right
    vectors_at = vectors.ctypes.data
    for n in range(first.size - 1):
        node, known, count = low + n, -1, 0
        for i in range(height):
            known = max(known, row_of[node, i])
        if known < 0:
            continue
        for e in range(first[n], first[n + 1]):
            c = lists[e]
            if volume[c] == 0.0:
                # only domains of points that do not count reach into the cell
                continue
            for i in range(height):
                f[i] = left[row_start[c] + places[e], i] / volume[c]
            if count + start[c + 1] - start[c] > sums.shape[0]:
                larger = np.empty((2 * sums.shape[0] + start[c + 1] - start[c], 4 * height))
                larger[:count] = sums[:count]
                sums = larger
            sums_at = sums.ctypes.data
            for b in range(start[c], start[c + 1]):
                if slot[nodes[b]] < 0:
                    slot[nodes[b]], names[count] = count, nodes[b]
                    sums[count] = 0.0
                    count += 1
                to = sums_at + 32 * height * slot[nodes[b]]
                vector = load(vectors_at + 32 * b)
                for i in range(height):
                    store(to + 32 * i, axpy(f[i], vector, load(to + 32 * i)))
        # all components of a node have the same columns
        for at in range(indptr[known], indptr[known + 1]):
            place[indices[at]] = at - indptr[known]
        for s in range(count):
            other = names[s]
            slot[other] = -1
            for k in range(width):
                column = column_of[other, k]
                for i in range(height):
                    row = row_of[node, i]
                    if row < 0:
                        continue
                    if column >= 0:
                        data[indptr[row] + place[column]] += sums[s, 4 * i + k]
                    else:
                        lift[node, i] += sums[s, 4 * i + k] * prescribed[other, k]
    # an address does not keep an array alive: without this line Numba frees both early
    sums[0, 0] = vectors[0, 0]


class CellCouplings:
    """The nodes of one field that the cells couple. Collective.

    All nodes of points with a share in the same cell are coupled. A cell at a rank border has
    points of several ranks. Their contributions go to the rank that owns the cell, and this rank
    adds the products to the matrix.

    Args:
        averages: Averages over the cells.
        stencils: Stencils on the solver's nodes.
        numbering: Numbering of the nodes.
        nodes: The solver's active nodes known on this rank.

    Attributes:
        averages: The argument.
        complete: Whether every rank knows all nodes of its cells. Otherwise the couplings cannot
            be used.
    """

    def __init__(self, averages: CellAverages, stencils: Stencils, numbering, nodes):
        self.averages = averages
        self._stencils = s = stencils
        cells, of = averages.shares.cells, averages.shares.of
        pairs = np.diff(averages.shares.cell_start)
        group_of = np.repeat(np.arange(pairs.size), pairs)
        shared = averages.shares.pairs(s.groups)
        first = running_sum(np.bincount(of[shared], minlength=cells.size), np.int64)
        of_cell = shared[np.argsort(of[shared], kind="stable")]
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
        # if every cell has one group, the stencils contain all couplings
        self._simple = not averages.exchanges and bool(np.all(np.diff(first) <= 1))
        self.complete = True
        self._exchange: _Exchange | None = None
        if averages.exchanges:
            self._exchange = _Exchange(cells, numbering, nodes, self._start, self._nodes)
            self.complete = self._exchange.complete

    def lists(self) -> tuple[npt.NDArray, npt.NDArray] | None:
        """Lists of coupled nodes, or None if the stencils contain all couplings."""
        return None if self._simple else self.matrix_lists()

    def matrix_lists(self) -> tuple[npt.NDArray, npt.NDArray]:
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
        s, shares = self._stencils, self.averages.shares
        _add_forces(
            first, last, s.groups, s.node_start, s.value_start, s.N, s.dN, shares.cell_start,
            shares.start, shares.values, self._entry_start, self._entry, flux, column, out,
        )  # fmt: skip

    def summed(self, values: Array) -> Array:
        """Sums over all ranks by cell and node, on the entries of `matrix_lists`. Collective."""
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
        *rows.matrix_lists(), *columns.matrix_lists(), rows.averages.volume, rows.summed(left),
        columns.summed(right), unknowns[0].row_of, unknowns[1].row_of, pattern.indptr,
        pattern.indices, data, prescribed, lift,
    )  # fmt: skip


class _Exchange:
    """Exchange of values by cell and node with the ranks that own the cells. Collective.

    Args:
        cells, numbering: Numberings of cells and nodes.
        active: The solver's active nodes known on this rank.
        start, nodes: Nodes of every local cell.

    Attributes:
        complete: Whether all ranks know all nodes that they received.
        lists: Start and nodes of the owned cells, with received nodes.
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
        """Send rows to other ranks, and return the received rows."""
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
