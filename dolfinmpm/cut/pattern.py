"""The sparsity pattern of a matrix: the nodes that are coupled, and blocks between nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.cut.unknowns import Unknowns

if TYPE_CHECKING:
    from dolfinmpm.cut.activation import Activation, ActiveRegion

__all__ = ["Blocks", "KeptCouplings", "Pattern", "lists_of", "pairs_of"]


@dataclass(frozen=True)
class Blocks:
    """Blocks of a matrix between nodes of two fields.

    Attributes:
        row_field, column_field: Numbers of the fields.
        rows, columns: Nodes, shape (n,).
        values: Shape (n, components of the row field, components of the column field).
    """

    row_field: int
    column_field: int
    rows: npt.NDArray[np.int32]
    columns: npt.NDArray[np.int32]
    values: npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def _distribute(rows, values, start, to):
    """Sort values by rows, in their given order. `start` has zeros, and is an output too."""
    n = start.size - 1
    for e in range(rows.size):
        start[rows[e] + 1] += 1
    for a in range(n):
        start[a + 1] += start[a]
    # the first position of each row moves to its end, where the next row begins
    for e in range(rows.size):
        a = rows[e]
        to[start[a]] = values[e]
        start[a] += 1
    for a in range(n, 0, -1):
        start[a] = start[a - 1]
    start[0] = 0


def _by_rows(n: int, rows, values):
    """Lists of the values of every row: first entries, shape (n + 1,), and values.

    Args:
        n: Number of rows.
        rows, values: Row of each value, and the values.
    """
    start, to = np.zeros(n + 1, np.int64), np.empty(len(rows), np.int32)
    _distribute(rows, values, start, to)
    return start, to


@numba.njit(cache=True, error_model="numpy")
def _couple(
    group_start, group_of, node_start, nodes, extra_start, extra_of, seen, start, neighbours
):
    """Neighbours of every active node, in any order. Only counts if `neighbours` is empty."""
    filling = neighbours.size > 0
    total = 0
    for a in range(start.size - 1):
        for at in range(group_start[a], group_start[a + 1]):
            g = group_of[at]
            for k in range(node_start[g], node_start[g + 1]):
                b = nodes[k]
                if seen[b] != a:
                    seen[b] = a
                    if filling:
                        neighbours[total] = b
                    total += 1
        for at in range(extra_start[a], extra_start[a + 1]):
            b = extra_of[at]
            if seen[b] != a:
                seen[b] = a
                if filling:
                    neighbours[total] = b
                total += 1
        start[a + 1] = total


def _graph(n: int, node_start, nodes, extra_rows, extra_columns):
    """Neighbours of n nodes, increasing: first entries, shape (n + 1,), and neighbours.

    Args:
        n: Number of nodes.
        node_start, nodes: Lists of nodes. All nodes of a list are coupled.
        extra_rows, extra_columns: Further nodes, and a neighbour of each.
    """
    groups = np.arange(len(node_start) - 1, dtype=np.int32)
    group_start, group_of = _by_rows(n, nodes, np.repeat(groups, np.diff(node_start)))
    extra_start, extra_of = _by_rows(n, extra_rows, extra_columns)
    start, neighbours = np.zeros(n + 1, np.int64), np.empty(0, np.int32)
    for _ in range(2):  # first count, then fill
        neighbours = np.empty(start[-1], np.int32)
        _couple(
            group_start, group_of, node_start, nodes, extra_start, extra_of,
            np.full(n, -1, np.int32), start, neighbours,
        )  # fmt: skip
    # transposing a graph sorts its neighbours; a second time gives the graph itself
    every = np.arange(n, dtype=np.int32)
    for _ in range(2):
        start, neighbours = _by_rows(n, neighbours, np.repeat(every, np.diff(start)))
    return start, neighbours


@numba.njit(cache=True, error_model="numpy")
def _covers(start, neighbours, new_start, new_neighbours):
    """Whether the first graph contains every coupling of the second graph."""
    for a in range(start.size - 1):
        at, end = start[a], start[a + 1]
        for k in range(new_start[a], new_start[a + 1]):
            while at < end and neighbours[at] < new_neighbours[k]:
                at += 1
            if at == end or neighbours[at] != new_neighbours[k]:
                return False
    return True


@numba.njit(cache=True, error_model="numpy")
def _expand(start, neighbours, rows, fixed, indptr, indices):
    """Pattern of unknowns from a graph of nodes.

    `rows` and `fixed`, shape (active nodes, components), are rows of unknowns and of prescribed
    components, or -1. Rows of prescribed components have an entry on the diagonal only.
    """
    nc = rows.shape[1]
    for a in range(start.size - 1):
        count = 0
        for at in range(start[a], start[a + 1]):
            for k in range(nc):
                if rows[neighbours[at], k] >= 0:
                    count += 1
        for i in range(nc):
            if rows[a, i] >= 0:
                indptr[rows[a, i] + 1] = count
            elif fixed[a, i] >= 0:
                indptr[fixed[a, i] + 1] = 1
    for row in range(indptr.size - 1):
        indptr[row + 1] += indptr[row]
    if indices.size == 0:
        return
    for a in range(start.size - 1):
        for i in range(nc):
            if rows[a, i] >= 0:
                put = indptr[rows[a, i]]
                for at in range(start[a], start[a + 1]):
                    for k in range(nc):
                        if rows[neighbours[at], k] >= 0:
                            indices[put] = rows[neighbours[at], k]
                            put += 1
            elif fixed[a, i] >= 0:
                indices[indptr[fixed[a, i]]] = fixed[a, i]


@dataclass(frozen=True)
class Pattern:
    """The sparsity pattern on this rank, with the rows of ghosts.

    Attributes:
        start, neighbours: Graph of the active nodes.
        indptr, indices: Rows and columns of the local unknowns.
        still: Positions of the diagonal entries in the rows of prescribed components.
    """

    start: npt.NDArray[np.int64]
    neighbours: npt.NDArray[np.int32]
    indptr: npt.NDArray[np.int32]
    indices: npt.NDArray[np.int32]
    still: npt.NDArray[np.int32]

    @staticmethod
    def build(
        lists: Sequence[tuple[npt.NDArray, npt.NDArray]],
        unknowns: Unknowns,
        pairs: Sequence[tuple[npt.NDArray, npt.NDArray]],
        old: Pattern | None,
    ) -> Pattern:
        """Pattern of couplings. Nodes are numbered with the offsets of their fields.

        Args:
            lists: First entries and nodes of lists. All nodes of a list are coupled.
            unknowns: The unknowns.
            pairs: Coupled active nodes, shape (n,) each.
            old: Pattern of the same unknowns, or None. If it contains all couplings, it is returned
                and all data of the pattern stay valid. Otherwise the new pattern contains its
                couplings too. So points that move in the same cells soon stop to change it.
        """
        fields = unknowns.fields
        active = np.concatenate([f.nodes + np.int32(f.offset) for f in fields])
        n = active.size
        compact = np.full(sum(f.numbering.size for f in fields), -1, np.int32)
        compact[active] = np.arange(n, dtype=np.int32)
        empty = [np.empty(0, np.int32)]
        extra_rows = np.concatenate(empty + [rows for rows, _ in pairs])
        extra_columns = np.concatenate(empty + [columns for _, columns in pairs])
        node_start, nodes = _one_after_the_other(lists)
        assert compact[nodes].min(initial=0) >= 0, "a coupled node is not active"
        start, neighbours = _graph(
            n, node_start, compact[nodes], compact[extra_rows], compact[extra_columns]
        )
        if old is not None and _covers(old.start, old.neighbours, start, neighbours):
            return old
        if old is not None:
            kept = np.repeat(active, np.diff(old.start)), active[old.neighbours]
            return Pattern.build(lists, unknowns, [*pairs, kept], None)
        rows, still = (np.full((n, max(f.components for f in fields)), -1, np.int32) for _ in "ab")
        at = 0
        for f in fields:
            rows[at : at + f.nodes.size, : f.components] = f.row_of[f.nodes]
            still[at : at + f.nodes.size, : f.components] = f.still
            at += f.nodes.size
        # only the owner sets the row of a prescribed component
        still[still >= unknowns.mine] = -1
        indptr = np.zeros(unknowns.local + 1, np.int32)
        _expand(start, neighbours, rows, still, indptr, np.empty(0, np.int32))
        indices = np.empty(indptr[-1], np.int32)
        indptr[:] = 0
        _expand(start, neighbours, rows, still, indptr, indices)
        return Pattern(start, neighbours, indptr, indices, indptr[still[still >= 0]])


def _one_after_the_other(lists):
    """Join several lists of lists."""
    if len(lists) == 1:
        return lists[0]
    node_start, total = [np.zeros(1, np.int64)], 0
    for start, _ in lists:
        node_start.append(total + start[1:].astype(np.int64))
        total += int(start[-1])
    nodes = [nodes for _, nodes in lists]
    return np.concatenate(node_start), np.concatenate([np.empty(0, np.int32), *nodes])


@dataclass(frozen=True)
class KeptCouplings:
    """Couplings of a former pattern, with numbers that are the same in another run.

    Attributes:
        active: Active nodes known on this rank, increasing, shape (n,).
        rows, columns: Pairs of coupled nodes, shape (m,) each.
    """

    active: npt.NDArray[np.int64]
    rows: npt.NDArray[np.int64]
    columns: npt.NDArray[np.int64]

    @staticmethod
    def of(here: Activation) -> KeptCouplings:
        """The couplings of an activation."""
        number, active = _numbers(here.unknowns)
        rows = np.repeat(active, np.diff(here.pattern.start))
        columns = active[here.pattern.neighbours]
        return KeptCouplings(np.sort(number[active]), number[rows], number[columns])

    def pairs(self, unknowns: Unknowns) -> list[tuple[npt.NDArray, npt.NDArray]]:
        """Coupled local nodes, if the active nodes are unchanged on all ranks. Collective."""
        number, active = _numbers(unknowns)
        same = np.array_equal(np.sort(number[active]), self.active)
        if not unknowns.comm.allreduce(same, op=MPI.LAND):
            return []
        order = np.argsort(number[active])
        there = active[order]
        at = [there[np.searchsorted(number[there], n)] for n in (self.rows, self.columns)]
        return [(at[0].astype(np.int32), at[1].astype(np.int32))]


def _numbers(unknowns: Unknowns) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Global numbers of the nodes of all fields, and the nodes that carry unknowns."""
    numbers, active, first = [], [], 0
    for field in unknowns.fields:
        index_map = field.numbering.index_map
        owned = np.arange(*index_map.local_range, dtype=np.int64)
        numbers.append(first + np.concatenate([owned, index_map.ghosts]))
        active.append(field.nodes.astype(np.int64) + field.offset)
        first += index_map.size_global
    return np.concatenate(numbers), np.concatenate(active)


def lists_of(regions: Sequence[ActiveRegion], fields, unknowns: Unknowns):
    """Lists of coupled nodes, numbered with their fields' offsets."""
    lists = []
    for region in regions:
        lists.append(_stacked([(s.node_start, s.nodes) for s in region.stencils], unknowns))
        if region.couplings is not None:
            own = [c.lists() for c in region.couplings]
            if any(o is not None for o in own):
                lists.append(_stacked([c.matrix_lists() for c in region.couplings], unknowns))
    if not lists:
        lists.append(
            _stacked([(f.stencils.node_start, f.stencils.nodes) for f in fields], unknowns)
        )
    return lists


def _stacked(parts, unknowns: Unknowns):
    """Lists of nodes of each field, joined list by list."""
    if len(parts) == 1:
        return parts[0]
    number = len(parts[0][0]) - 1
    lengths = [np.diff(start) for start, _ in parts]
    start = np.zeros(number + 1, np.int64)
    np.cumsum(sum(lengths), out=start[1:])
    nodes = np.empty(start[-1], np.int32)
    at = start[:-1].copy()
    for (first, values), count, field in zip(parts, lengths, unknowns.fields):
        place = np.repeat(at - first[:-1], count) + np.arange(count.sum())
        nodes[place] = values[: count.sum()] + np.int32(field.offset)
        at += count
    return start, nodes


def pairs_of(blocks: Sequence[Blocks], unknowns: Unknowns):
    """Pairs of active nodes that blocks couple, numbered with their fields' offsets."""
    active = []
    for field in unknowns.fields:
        flags = np.zeros(field.numbering.size, bool)
        flags[field.nodes] = True
        active.append(flags)
    pairs = []
    for b in blocks:
        keep = active[b.row_field][b.rows] & active[b.column_field][b.columns]
        offsets = (unknowns.fields[k].offset for k in (b.row_field, b.column_field))
        pairs.append(tuple(n[keep] + np.int32(o) for n, o in zip((b.rows, b.columns), offsets)))
    return pairs
