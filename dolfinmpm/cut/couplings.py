"""Nodes that an activation couples, for its sparsity pattern and for checkpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.cut.unknowns import Unknowns

if TYPE_CHECKING:
    from dolfinmpm.cut.activation import Activation, ActiveRegion

__all__ = ["KeptCouplings", "lists_of", "pairs_of"]


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
                lists.append(_stacked([c.merged() for c in region.couplings], unknowns))
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
