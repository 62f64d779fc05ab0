"""How corners move with the nodes, and what forces on them are at the nodes.

In steps in time force and motion of what touches must be conjugate, or contact makes energy. A
corner is where its point's state puts it, at x + F R or at x ± l(F), so it moves with the point and
with the point's gradient: by u + ∇u·F R, or by u ± ∂l/∂F : (∇u F). Forces reach the nodes by the
transpose of the same.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

__all__ = ["Mixed", "Plain", "Seen", "growth_by_gradient"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int32]


# Row starts and nodes of what places see, and N, shape (n,), or ∂x_i/∂u_j, shape (n, d, d)
Seen = tuple[Rows, Rows, Array]


class Plain:
    """Corners that see the same of each component.

    Args:
        start, nodes, N: The rows of a sparse matrix of what they see of nodes.
        count: Number of the nodes.
    """

    def __init__(self, start: Rows, nodes: Rows, N: Array, count: int):
        self._N = scipy.sparse.csr_matrix((N, nodes, start), shape=(start.size - 1, count))

    def displacement(self, u: Array) -> Array:
        """Displacements of the corners (m), shape (m, d), from nodal ones."""
        return np.asarray(self._N @ u)

    def nodal(self, values: Array) -> Array:
        """Nodal sums of values by the corners' components, shape (m, d, ...)."""
        flat = values.reshape(len(values), -1)
        return np.asarray(self._N.T @ flat).reshape(-1, *values.shape[1:])

    def entries(self) -> Seen:
        """What each corner sees of which node."""
        return self._N.indptr, self._N.indices, self._N.data


class Mixed:
    """Corners whose components follow several of the nodes'.

    Args:
        start, nodes, W: The rows of a sparse matrix of ∂x_i/∂u_j, in blocks, shape (n, d, d).
        count: Number of the nodes.
    """

    def __init__(self, start: Rows, nodes: Rows, W: Array, count: int):
        d = W.shape[1]
        shape = d * (start.size - 1), d * count
        self._W = scipy.sparse.bsr_matrix((W, nodes, start), shape=shape, blocksize=(d, d))

    def displacement(self, u: Array) -> Array:
        """Displacements of the corners (m), shape (m, d), from nodal ones."""
        return np.asarray(self._W @ u.reshape(-1)).reshape(-1, u.shape[1])

    def nodal(self, values: Array) -> Array:
        """Nodal sums of values by the corners' components, shape (m, d, ...)."""
        flat = values.reshape(self._W.shape[0], -1)
        return np.asarray(self._W.T @ flat).reshape(-1, *values.shape[1:])

    def entries(self) -> Seen:
        """What each corner sees of which node."""
        return self._W.indptr, self._W.indices, self._W.data


def growth_by_gradient(F: Array, l0: Array, growth: str) -> Array:
    """∂l_i/∂(∇u)_jk of half-lengths l(F) as F becomes (I + ∇u) F (m), shape (points, d, d, d).

    Args:
        F: Deformation gradients, shape (points, d, d).
        l0: First half-lengths (m), shape (points, d).
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
