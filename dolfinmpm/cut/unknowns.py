"""The unknowns of a step: all components of active nodes that no condition prescribes."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode
from mpi4py import MPI

from dolfinmpm.grid.halo import Numbering

__all__ = ["FieldUnknowns", "Nodal", "Unknowns"]

Array = npt.NDArray[np.float64]


# Ranks own the nodes of a compact region. Rows that change ranks may lie anywhere in a region, and
# couple more rows of different ranks. So rows stay while the largest share is at most this multiple
# of the mean.
_EVEN = 1.1


@dataclass(frozen=True)
class FieldUnknowns:
    """The unknowns of one field.

    Attributes:
        numbering: Numbering of its nodes.
        components: Components per node.
        nodes: Active nodes known here that carry unknowns, increasing, shape (n,).
        fixed: Mask of the prescribed components, shape (nodes, components).
        row_of: Local row of each component, or -1, shape (nodes, components).
        offset: Number to add to a node in lists with nodes of all fields.
        blocks: Whether prescribed components have rows too, see `Unknowns`.
    """

    numbering: Numbering
    components: int
    nodes: npt.NDArray[np.int32]
    fixed: npt.NDArray[np.bool_]
    row_of: npt.NDArray[np.int32]
    offset: int
    blocks: bool = False

    @functools.cached_property
    def owned_nodes(self) -> npt.NDArray[np.int32]:
        """Active nodes that this rank owns."""
        return self.nodes[: np.searchsorted(self.nodes, self.numbering.owned)]

    @functools.cached_property
    def places(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Positions of owned unknowns, and of prescribed components, in flat nodal arrays."""
        flat = self.owned_nodes[:, None] * self.components + np.arange(self.components)
        fixed = self.fixed[self.owned_nodes]
        return flat[~fixed].astype(np.intp), flat[fixed].astype(np.intp)

    @functools.cached_property
    def size(self) -> int:
        """Number of owned rows, with the rows of prescribed components if there are any."""
        return self.owned_nodes.size * self.components if self.blocks else self.places[0].size

    @functools.cached_property
    def rows(self) -> npt.NDArray[np.intp] | slice:
        """Owned unknowns in the field's owned rows."""
        if not self.blocks:
            return slice(None)
        return np.flatnonzero(~self.fixed[self.owned_nodes].ravel())

    @functools.cached_property
    def still(self) -> npt.NDArray[np.int32]:
        """Local rows of prescribed components or -1, shape (known nodes, components)."""
        count = self.nodes.size * self.components
        row = np.arange(count, dtype=np.int32).reshape(-1, self.components)
        return np.where(self.fixed[self.nodes] & self.blocks, row, np.int32(-1))


class Nodal:
    """Values at the nodes of all fields, with their exchange between ranks.

    Args:
        numberings: Numbering of each field's nodes.
        components: Components of each field.

    Attributes:
        arrays: One array per field, shape (nodes, components).
    """

    def __init__(self, numberings: Sequence[Numbering], components: Sequence[int]):
        self._vectors = [n.vector(c) for n, c in zip(numberings, components)]
        self.arrays = [v.array.reshape(-1, c) for v, c in zip(self._vectors, components)]
        self._parallel = numberings[0].comm.size > 1

    def add_up(self) -> None:
        """Add the values of all ranks at the owner of each node. Collective."""
        if self._parallel:
            for vector in self._vectors:
                vector.scatter_reverse(InsertMode.add)

    def spread(self) -> None:
        """Send the owners' values to all ranks that know the nodes. Collective."""
        if self._parallel:
            for vector in self._vectors:
                vector.scatter_forward()


class RowPartition:
    """Consecutive rows of ranks, divided evenly if their shares differ much. Collective.

    Args:
        comm: Communicator.
        count: Number of rows of the nodes that this rank owns.
        block: Number of rows that stay together.

    Attributes:
        owned: Number of rows in the share of this rank.
        imbalance: Largest share divided by the mean.
    """

    def __init__(self, comm: MPI.Intracomm, count: int, block: int):
        self._comm, size = comm, comm.size
        had = np.concatenate([[0], np.cumsum(comm.allgather(count))])
        units = had[-1] // block
        gets = block * (np.arange(size + 1) * units // size)
        if np.diff(had).max() * size <= _EVEN * had[-1]:
            gets = had
        self._same = np.array_equal(had, gets)

        def overlaps(begin, end, parts):
            return np.maximum(np.minimum(end, parts[1:]) - np.maximum(begin, parts[:-1]), 0)

        rank = comm.rank
        self._out = overlaps(had[rank], had[rank + 1], gets)
        self._in = overlaps(gets[rank], gets[rank + 1], had)
        self.imbalance = float(np.diff(gets).max() * size / max(gets[-1], 1)) or 1.0
        self.owned = int(gets[rank + 1] - gets[rank])

    def shared_out(self, values: Array) -> Array:
        """Values in rows of own nodes, sent to the shares of the ranks. Collective."""
        return self._send(values, self._out, self._in)

    def given_back(self, values: Array) -> Array:
        """The inverse of `shared_out`. Collective."""
        return self._send(values, self._in, self._out)

    def _send(self, values: Array, out, into) -> Array:
        if self._same:
            return values
        result = np.empty(into.sum())
        self._comm.Alltoallv([np.ascontiguousarray(values), out], [result, into])
        return result


class Unknowns:
    """Numbering of the unknowns of all fields. Collective.

    Rows are numbered rank by rank in the order of the owned nodes, one field after the other. Each
    rank owns an equal or nearly equal share of the rows in this order. Only this class decides
    about the ownership of rows. All other classes use nodes.

    With blocks, each active node has a row per component, so that multigrid knows the components
    of a node. Rows of prescribed components have the equation x = 0.

    Args:
        numberings: Numbering of each field's nodes.
        nodes: Active nodes of each field that carry unknowns, increasing.
        fixed: Masks of the prescribed components, (nodes, components) per field.
        blocks: Whether each component has a row; for one field only.

    Attributes:
        fields: One entry per field.
        owned, rows: Number of rows owned by this rank, and of all rows.
        local, mine: Number of rows of nodes known on this rank, and of nodes that it owns.
        total: Number of unknowns on all ranks.
        block: Number of components per block, 1 without blocks.
        to_global: Global row of every local row.
    """

    def __init__(
        self,
        numberings: Sequence[Numbering],
        nodes: Sequence[npt.NDArray[np.int32]],
        fixed: Sequence[npt.NDArray[np.bool_]],
        blocks: bool = False,
    ):
        assert not blocks or len(numberings) == 1
        self.comm: MPI.Intracomm = numberings[0].comm
        made, self.local, self.mine, offset = [], 0, 0, 0
        free_of = []
        for numbering, active, mask in zip(numberings, nodes, fixed):
            free = ~mask[active]
            numbered = np.ones_like(free) if blocks else free
            rows = np.full(free.shape, -1, np.int32)
            count = int(np.count_nonzero(numbered))
            rows[numbered] = np.arange(self.local, self.local + count, dtype=np.int32)
            rows[~free] = -1
            row_of = np.full(mask.shape, -1, np.int32)
            row_of[active] = rows
            components = mask.shape[1]
            made.append(FieldUnknowns(numbering, components, active, mask, row_of, offset, blocks))
            self.local += count
            self.mine += made[-1].size
            offset += numbering.size
            free_of.append(numbered)
        self.fields = tuple(made)
        self.block = made[0].components if blocks else 1
        free_here = sum(f.places[0].size for f in made)
        self.rows, self.total = (
            int(n) for n in self.comm.allreduce(np.array([self.mine, free_here]), op=MPI.SUM)
        )
        self._partition = RowPartition(self.comm, self.mine, self.block)
        self.owned = self._partition.owned
        self.to_global: npt.NDArray[np.int32] = np.arange(self.local, dtype=np.int32)
        if self.comm.size > 1:
            self.to_global = self._number(free_of)

    def _number(self, numbered) -> npt.NDArray[np.int32]:
        first = self.comm.exscan(self.mine) or 0
        pieces = []
        for field, free in zip(self.fields, numbered):
            shared = field.numbering.vector(field.components, np.int64)
            mine = shared.array.reshape(-1, field.components)
            own = free[: field.owned_nodes.size]
            rows = np.zeros(own.shape, np.int64)
            count = int(np.count_nonzero(own))
            rows[own] = first + np.arange(count)
            first += count
            mine[field.owned_nodes] = rows
            shared.scatter_forward()
            pieces.append(mine[field.nodes][free].astype(np.int32))
        return np.concatenate(pieces)

    def same(
        self, nodes: Sequence[npt.NDArray[np.int32]], fixed: Sequence, blocks: bool = False
    ) -> bool:
        """Whether nodes and conditions of all fields are unchanged on all ranks. Collective."""
        here = (
            blocks == (self.block > 1)
            and len(nodes) == len(self.fields)
            and all(
                f.fixed is mask and np.array_equal(f.nodes, active)
                for f, active, mask in zip(self.fields, nodes, fixed)
            )
        )
        return self.comm.allreduce(here, op=MPI.LAND)

    @property
    def imbalance(self) -> float:
        """Largest number of rows on a rank over the mean."""
        return self._partition.imbalance

    def nodal(self) -> Nodal:
        """Zeros at the nodes of all fields. Collective."""
        return Nodal([f.numbering for f in self.fields], [f.components for f in self.fields])

    def expand(self, x: Array, prescribed: Sequence[Array], out: Nodal) -> None:
        """Nodal values of the unknowns, on all ranks that know the nodes. Collective.

        Args:
            x: Owned unknowns, shape (owned,).
            prescribed: Values of prescribed components, (nodes, components) per field.
            out: Output: values at active nodes.
        """
        x, at = self._partition.given_back(x), 0
        for field, values, u in zip(self.fields, prescribed, out.arrays):
            free, fixed = field.places
            u.reshape(-1)[free] = x[at : at + field.size][field.rows]
            u.reshape(-1)[fixed] = values.reshape(-1)[fixed]
            at += field.size
        out.spread()

    def restrict(self, nodal: Sequence[Array]) -> Array:
        """Entries of nodal values in the owned rows, 0 in rows without unknown. Collective.

        Args:
            nodal: Values, (nodes, components) per field, at the nodes' owners.

        Returns:
            Shape (owned,).
        """
        return self.shared_out(self.entries(nodal))

    def entries(self, nodal: Sequence[Array]) -> Array:
        """Entries of nodal values in rows of nodes owned here, shape (mine,); see `restrict`."""
        pieces = [r.reshape(-1)[f.places[0]] for f, r in zip(self.fields, nodal)]
        if self.block == 1:
            return _joined(pieces)
        result = np.zeros(self.mine)
        result[self.fields[0].rows] = pieces[0]
        return result

    def shared_out(self, entries: Array) -> Array:
        """Values in rows of own nodes, shape (mine,), sent to owned rows, (owned,). Collective."""
        return self._partition.shared_out(entries)

    def given_back(self, x: Array) -> Array:
        """The inverse of `shared_out`, shape (mine,). Collective."""
        return self._partition.given_back(x)

    def squares(self, entries: Array) -> Array:
        """Sum of the squares of each field's entries on this rank, shape (fields,).

        Args:
            entries: As `entries` gives them, shape (mine,).
        """
        ends = np.cumsum([field.size for field in self.fields])[:-1]
        return np.array([float(part @ part) for part in np.split(entries, ends)])

    def only(self, k: int, x: Array) -> Array:
        """The owned unknowns of the k-th field, and 0 for all other fields. Collective."""
        mine = np.zeros(self.mine)
        first = sum(field.size for field in self.fields[:k])
        chosen = slice(first, first + self.fields[k].size)
        mine[chosen] = self.given_back(x)[chosen]
        return self.shared_out(mine)

    def reactions(self, nodal: Sequence[Array]) -> Array:
        """Entries of nodal values at prescribed components of owned nodes."""
        return _joined([r.reshape(-1)[f.places[1]] for f, r in zip(self.fields, nodal)])

    def clear(self, out: Nodal) -> None:
        """Set the values at active nodes to zero."""
        for field, values in zip(self.fields, out.arrays):
            values[field.nodes] = 0.0


def _joined(pieces: list[Array]) -> Array:
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
