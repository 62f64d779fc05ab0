"""Stencils of contact points: the motion of the points with the nodes, and nodal forces.

In steps in time, force and motion of contact points must be conjugate, or contact makes energy. So
forces reach the nodes by the transpose of the matrix that moves the points. A corner of a domain
that grows with its point moves by u ± ∂l/∂F : (∇u F). Then the components of its displacement
depend on several components of the nodal ones, and the matrix has blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

__all__ = ["ContactStencils", "StencilRows", "growth_by_gradient"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int32]

# Row starts, nodes, and values: N, shape (n,), or blocks ∂x_i/∂u_j, shape (n, d, d)
StencilRows = tuple[Rows, Rows, Array]


@dataclass(frozen=True)
class ContactStencils:
    """Stencils of contact points of one body.

    Attributes:
        nodes: Nodes in the stencils, shape (k,).
        matrix: Values N, shape (points, k), if all components move alike. Otherwise blocks
            ∂x_i/∂u_j in a block matrix of shape (points d, k d).
    """

    nodes: npt.NDArray[np.int32]
    matrix: scipy.sparse.csr_matrix | scipy.sparse.bsr_matrix

    @staticmethod
    def of(matrix: scipy.sparse.csr_matrix | scipy.sparse.bsr_matrix, count: int):
        """Stencils from a matrix of all nodes of a field.

        Args:
            matrix: Values, or blocks, in the columns of all nodes.
            count: Number of the nodes.
        """
        # a table of all nodes is cheaper than sorting the nodes of all points
        column = np.zeros(count, np.int32)
        column[matrix.indices] = 1
        nodes: npt.NDArray[np.int32] = np.flatnonzero(column).astype(np.int32)
        column[nodes] = np.arange(nodes.size)
        parts = matrix.data, column[matrix.indices], matrix.indptr
        rows = matrix.indptr.size - 1
        if matrix.data.ndim == 1:
            return ContactStencils(nodes, scipy.sparse.csr_matrix(parts, shape=(rows, nodes.size)))
        d = matrix.data.shape[1]
        shape = d * rows, d * nodes.size
        blocks = scipy.sparse.bsr_matrix(parts, shape=shape, blocksize=(d, d))
        return ContactStencils(nodes, blocks)

    def displacement(self, u: Array) -> Array:
        """Displacements of the points (m), shape (points, d), from those of the field's nodes."""
        return self.of_nodes(u[self.nodes])

    def of_nodes(self, u: Array) -> Array:
        """Displacements of the points (m), shape (points, d), from those of `nodes`."""
        blocks = self.matrix.data.ndim == 3
        moved = self.matrix @ (u.ravel() if blocks else u)
        return np.asarray(moved).reshape(-1, u.shape[1])

    def add(self, forces: Array, out: Array) -> None:
        """Add forces at the points, shape (points, d, ...), to those of the field's nodes."""
        flat = forces.reshape(self.matrix.shape[0], -1)
        out[self.nodes] += np.asarray(self.matrix.T @ flat).reshape(-1, *forces.shape[1:])

    def rows(self) -> StencilRows:
        """The stencils as rows of a sparse matrix, with the field's numbers of the nodes."""
        return self.matrix.indptr, self.nodes[self.matrix.indices], self.matrix.data


def growth_by_gradient(F: Array, l0: Array, growth: str) -> Array:
    """∂l_i/∂(∇u)_jk of half-lengths l(F) as F becomes (I + ∇u) F (m), shape (points, d, d, d).

    Args:
        F: Deformation gradients, shape (points, d, d).
        l0: Initial half-lengths (m), shape (points, d).
        growth: The rule, see `dolfinmpm.body.gimpdomains.update_domains`.
    """
    n, d = l0.shape
    if growth == "fixed":
        return np.zeros((n, d, d, d))
    if growth == "volume":
        lengths = l0 * (np.linalg.det(F) ** (1.0 / d))[:, None]
        return np.asarray(lengths[:, :, None, None] / d * np.eye(d))
    values, Q = np.linalg.eigh(np.einsum("pki,pkj->pij", F, F))
    stretch = np.sqrt(values)
    # U dU + dU U = dC = Fᵀ (∇u + ∇uᵀ) F, in the frame of the eigenvectors
    G = F @ Q
    weight = 2.0 / (stretch[:, :, None] + stretch[:, None, :])
    T = np.einsum("pia,pib,pab,pja,pkb->pijk", Q, Q, weight, G, G, optimize=True)
    return np.asarray(l0[:, :, None, None] * T)
