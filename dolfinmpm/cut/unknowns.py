"""The unknowns of a step: those components of active nodes that no condition prescribes."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode
from mpi4py import MPI

from dolfinmpm.cut.rows import EvenRows
from dolfinmpm.grid.halo import Numbering

__all__ = ["FieldUnknowns", "Nodal", "Unknowns"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FieldUnknowns:
    """The unknowns of one field.

    Attributes:
        numbering: Numbering of its nodes.
        components: Components a node.
        nodes: Active nodes known here that carry unknowns, increasing, shape (n,).
        fixed: Which components are prescribed, shape (nodes, components).
        row_of: Local row of each component, -1 where there is none, likewise.
        offset: What is added to a node's number where nodes of all fields stand in one list.
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
        """Where the owned unknowns, and prescribed components, are in flat nodal arrays."""
        flat = self.owned_nodes[:, None] * self.components + np.arange(self.components)
        held = self.fixed[self.owned_nodes]
        return flat[~held].astype(np.intp), flat[held].astype(np.intp)

    @functools.cached_property
    def size(self) -> int:
        """Owned rows, those of prescribed components included where they have some."""
        return self.owned_nodes.size * self.components if self.blocks else self.places[0].size

    @functools.cached_property
    def rows(self) -> npt.NDArray[np.intp] | slice:
        """Owned unknowns among the field's owned rows."""
        if not self.blocks:
            return slice(None)
        return np.flatnonzero(~self.fixed[self.owned_nodes].ravel())

    @functools.cached_property
    def still(self) -> npt.NDArray[np.int32]:
        """Local rows of prescribed components, shape (known nodes, components), -1 elsewhere."""
        count = self.nodes.size * self.components
        row = np.arange(count, dtype=np.int32).reshape(-1, self.components)
        return np.where(self.fixed[self.nodes] & self.blocks, row, np.int32(-1))


class Nodal:
    """Values at the nodes of all fields, and the one place where ranks exchange them.

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
        """Add what the ranks have for a node at its owner. Collective."""
        if self._parallel:
            for vector in self._vectors:
                vector.scatter_reverse(InsertMode.add)

    def spread(self) -> None:
        """Tell the owners' values to all ranks that know the nodes. Collective."""
        if self._parallel:
            for vector in self._vectors:
                vector.scatter_forward()


class Unknowns:
    """Numbering of the unknowns of all fields. Collective.

    Rows are numbered rank by rank as the ranks own nodes, one field after the other, and owned in
    shares of that order that are equal or next to it. Everything but this class sees nodes only,
    so that who owns a row is decided here.

    In blocks every active node has a row for each component, so that multigrid knows which
    belong together; those of prescribed components stand for x = 0.

    Args:
        numberings: Numbering of each field's nodes.
        nodes: Active nodes of each field that carry unknowns, increasing.
        fixed: Which components are prescribed, (nodes, components) for each field.
        blocks: Whether there is to be a row for each component; of one field only.

    Attributes:
        fields: One entry per field.
        owned, rows: Number of rows that this rank owns, and on all ranks.
        local, mine: Number of rows of nodes known here, and of nodes owned here.
        total: Number of unknowns on all ranks.
        block: Components that stand together, 1 if they do not.
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
        for numbering, active, held in zip(numberings, nodes, fixed):
            free = ~held[active]
            # those that have rows
            numbered = np.ones_like(free) if blocks else free
            rows = np.full(free.shape, -1, np.int32)
            count = int(np.count_nonzero(numbered))
            rows[numbered] = np.arange(self.local, self.local + count, dtype=np.int32)
            rows[~free] = -1
            row_of = np.full(held.shape, -1, np.int32)
            row_of[active] = rows
            components = held.shape[1]
            made.append(FieldUnknowns(numbering, components, active, held, row_of, offset, blocks))
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
        self._even = EvenRows(self.comm, self.mine, self.block)
        self.owned = self._even.owned
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
        """Whether these are the nodes and conditions of all fields, on all ranks. Collective."""
        here = (
            blocks == (self.block > 1)
            and len(nodes) == len(self.fields)
            and all(
                f.fixed is held and np.array_equal(f.nodes, active)
                for f, active, held in zip(self.fields, nodes, fixed)
            )
        )
        return self.comm.allreduce(here, op=MPI.LAND)

    @property
    def imbalance(self) -> float:
        """Largest number of rows on a rank over the mean."""
        return self._even.imbalance

    def nodal(self) -> Nodal:
        """Zeros at the nodes of all fields. Collective."""
        return Nodal([f.numbering for f in self.fields], [f.components for f in self.fields])

    def expand(self, x: Array, prescribed: Sequence[Array], out: Nodal) -> None:
        """Nodal values of the unknowns, on all ranks that know the nodes. Collective.

        Args:
            x: Owned unknowns, shape (owned,).
            prescribed: Values of prescribed components, (nodes, components) for each field.
            out: Written at active nodes.
        """
        x, at = self._even.given_back(x), 0
        for field, values, u in zip(self.fields, prescribed, out.arrays):
            free, held = field.places
            u.reshape(-1)[free] = x[at : at + field.size][field.rows]
            u.reshape(-1)[held] = values.reshape(-1)[held]
            at += field.size
        out.spread()

    def restrict(self, nodal: Sequence[Array]) -> Array:
        """The owned unknowns' entries of nodal values, 0 in rows of others. Collective.

        Args:
            nodal: Values, (nodes, components) for each field, at the nodes' owners.

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
        """What ranks have in rows of nodes they own, shape (mine,), as (owned,). Collective."""
        return self._even.shared_out(entries)

    def given_back(self, x: Array) -> Array:
        """Owned unknowns in rows of nodes owned here, shape (mine,). Collective."""
        return self._even.given_back(x)

    def squares(self, entries: Array) -> Array:
        """Sum of the squares of each field's entries on this rank, shape (fields,).

        Args:
            entries: As `entries` gives them, shape (mine,).
        """
        ends = np.cumsum([field.size for field in self.fields])[:-1]
        return np.array([float(part @ part) for part in np.split(entries, ends)])

    def only(self, k: int, x: Array) -> Array:
        """The owned unknowns with 0 in place of all fields but the k-th. Collective."""
        mine = np.zeros(self.mine)
        first = sum(field.size for field in self.fields[:k])
        chosen = slice(first, first + self.fields[k].size)
        mine[chosen] = self.given_back(x)[chosen]
        return self.shared_out(mine)

    def reactions(self, nodal: Sequence[Array]) -> Array:
        """Entries of nodal values where components of owned nodes are prescribed."""
        return _joined([r.reshape(-1)[f.places[1]] for f, r in zip(self.fields, nodal)])

    def clear(self, out: Nodal) -> None:
        """Set the values at active nodes to zero."""
        for field, values in zip(self.fields, out.arrays):
            values[field.nodes] = 0.0


def _joined(pieces: list[Array]) -> Array:
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
