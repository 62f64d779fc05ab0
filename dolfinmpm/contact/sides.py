"""How a body moves the places on its boundary that face another body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from dolfinmpm.contact.motions import Seen

__all__ = ["Side", "side_of"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Side:
    """How a body moves the places that face the other one.

    Attributes:
        field: Number of its field.
        nodes: Nodes that any place sees, shape (k,).
        N: What they see of these, shape (places, k).
    """

    field: int
    nodes: npt.NDArray[np.int32]
    N: scipy.sparse.csr_matrix

    def displacement(self, u: Sequence[Array]) -> Array:
        """Displacements of the places (m), shape (places, d), from nodal ones of all fields."""
        return np.asarray(self.N @ u[self.field][self.nodes])

    def entries(self) -> Seen:
        """What each place sees of which node."""
        return self.N.indptr, self.nodes[self.N.indices], self.N.data

    def add(self, forces: Array, out: Sequence[Array]) -> None:
        """Add forces at the places (N), shape (places, d), to nodal ones of all fields."""
        out[self.field][self.nodes] += self.N.T @ forces


def side_of(field: int, N: scipy.sparse.csr_matrix) -> Side:
    """How a body moves places by what they see of the nodes of its field, shape (places, nodes)."""
    N.eliminate_zeros()
    nodes = np.unique(N.indices).astype(np.int32)
    local = np.searchsorted(nodes, N.indices)
    return Side(
        field, nodes, scipy.sparse.csr_matrix((N.data, local, N.indptr), (N.shape[0], nodes.size))
    )
