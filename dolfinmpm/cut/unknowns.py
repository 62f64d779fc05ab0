"""The unknowns of a step: those components of active nodes that no condition prescribes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.grid.halo import Numbering

__all__ = ["Unknowns"]


class Unknowns:
    """Numbering of the unknowns, and the values of those that are prescribed.

    All fields of a problem stand at the same nodes, so that a node carries their
    components one after the other.

    Args:
        numbering: Numbering of the nodes.
        components: Components a node.

    Attributes:
        nodes: Active nodes known here, increasing, shape (n,).
        row_of: Local row of each node's components, -1 where there is none,
            shape (nodes, components). The rows of owned nodes come first.
        owned, local, total: Number of rows here, with those of ghosts, on all ranks.
        to_global: Global row of every local row.
        fixed: Which components are prescribed, shape (nodes, components).
        prescribed: Their values in this step, likewise.
        compact: Scratch space, one entry a node.
    """

    def __init__(self, numbering: Numbering, components: int):
        self.comm: MPI.Intracomm = numbering.comm
        self.numbering = numbering
        self.components = components
        shape = (numbering.size, components)
        self.row_of = np.full(shape, -1, np.int32)
        self.fixed = np.zeros(shape, bool)
        self.prescribed = np.zeros(shape)
        self.compact = np.zeros(numbering.size, np.int32)
        self.nodes: npt.NDArray[np.int32] = np.empty(0, np.int32)
        self.owned = self.local = self.total = 0
        self.to_global: npt.NDArray[np.int32] = np.empty(0, np.int32)

    def activate(self, nodes: npt.NDArray[np.int32]) -> bool:
        """Number the unknowns of these nodes; returns whether they changed anywhere. Collective.

        Args:
            nodes: Active nodes known here, increasing.
        """
        changed = self.comm.allreduce(not np.array_equal(nodes, self.nodes), op=MPI.LOR)
        if not changed and self.total:
            return False
        self.row_of[self.nodes] = -1
        self.nodes = nodes
        free = ~self.fixed[nodes]
        rows = np.full(free.shape, -1, np.int32)
        self.local = int(np.count_nonzero(free))
        rows[free] = np.arange(self.local, dtype=np.int32)
        self.row_of[nodes] = rows
        self.owned = int(np.count_nonzero(free[nodes < self.numbering.owned]))
        self.total = self.comm.allreduce(self.owned, op=MPI.SUM)
        if self.comm.size == 1:
            self.to_global = np.arange(self.local, dtype=np.int32)
            return True
        first = self.comm.exscan(self.owned) or 0
        shared = self.numbering.vector(self.components, np.int64)
        mine = shared.array.reshape(-1, self.components)
        mine[nodes] = first + rows
        shared.scatter_forward()
        self.to_global = mine[nodes][free].astype(np.int32)
        return True

    def scatter(self, x: npt.NDArray[np.float64], u: npt.NDArray[np.float64]) -> None:
        """Write the owned unknowns, and the prescribed values, into nodal values.

        Args:
            x: Owned unknowns, shape (owned,).
            u: Nodal values, shape (nodes, components); ghosts are left alone.
        """
        nodes = self.owned_nodes
        values = self.prescribed[nodes]
        values[~self.fixed[nodes]] = x
        u[nodes] = values

    @property
    def owned_nodes(self) -> npt.NDArray[np.int32]:
        """Active nodes that this rank owns."""
        return self.nodes[: np.searchsorted(self.nodes, self.numbering.owned)]
