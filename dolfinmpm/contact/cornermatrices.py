"""Matrices that move contact points with the state of their material points."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from dolfinmpm.basis.stencils import stencil_matrix
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.contactstencils import growth_by_gradient, mixed
from dolfinmpm.contact.displacementbasis import DisplacementBasis

__all__ = ["CornerMatrices"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.integer]


class CornerMatrices:
    """Matrices from the nodes of a field to places at its material points.

    Args:
        points: Material points.
        displacement: The basis functions of the displacement.
        F: Deformation gradients in the section, shape (points, gdim, gdim).
    """

    def __init__(self, points: MaterialPoints, displacement: DisplacementBasis, F: Array):
        self._points, self._displacement, self._F = points, displacement, F

    def by_gradient(self, each: Rows, along: Array, value: bool = True) -> scipy.sparse.csr_matrix:
        """Places that move by value and gradient at their points.

        Args:
            each: Point of each place, shape (m,).
            along: Offset of each place from its point (m), shape (m, gdim).
            value: False for the parts of the gradients alone.
        """
        N, *dN = self._stencils(each)[2:]
        data = N.data.copy() if value else np.zeros_like(N.data)
        for k, part in enumerate(dN):
            data += np.repeat(along[:, k], np.diff(N.indptr)) * part
        return self._prolonged(N, data)

    def of_growth(self, each: Rows, at: Array) -> scipy.sparse.bsr_matrix:
        """Places in domains that grow with their points' gradients.

        Args:
            each: Point of each place, shape (m,).
            at: Offset of each place from its point, by half-lengths of the domain, shape (m, gdim).
        """
        d, points, growth = self._points.gdim, self._points, self._displacement.growth
        assert growth is not None
        rows, own, N, *dN = self._stencils(each)
        T = growth_by_gradient(self._F[rows], points["l0"][rows], growth)
        T = at[:, :, None, None] * T[own]
        length = np.diff(N.indptr)
        W = N.data[:, None, None] * np.eye(d)
        for k, part in enumerate(dN):
            W += np.repeat(T[:, :, :, k], length, axis=0) * part[:, None, None]
        return self._prolonged(N, W)

    def with_domains(
        self, M: scipy.sparse.csr_matrix, each: Rows, x: Array, share: Array
    ) -> scipy.sparse.bsr_matrix:
        """Places that move with their domains by a share, and else by a matrix M.

        Args:
            M: The matrix, shape (m, nodes).
            each: Point of each place, shape (m,).
            x: The places (m), shape (m, gdim).
            share: The shares, shape (m,).
        """
        points, moved = self._points, np.flatnonzero(share)
        rows = each[moved]
        at = (x[moved] - points["x"][rows]) / points["l"][rows]
        return mixed(M, self.of_growth(rows, at), moved, share)

    def _stencils(self, each: Rows) -> list[Any]:
        """The distinct points, the point of each place, N, and ∂N/∂x_k as its data."""
        rows, own = np.unique(each, return_inverse=True)
        s = self._displacement.stencils(rows)
        shape = rows.size, self._displacement.basis.nodes.size
        # numbers of the entries, so that one matrix serves value and gradient
        N = stencil_matrix(s, np.arange(s.N.size, dtype=np.float64), shape)[own]
        entry = N.data.astype(np.intp)
        N.data = s.N[entry]
        return [rows, own, N, *s.dN[entry].T]

    def _prolonged(self, N: scipy.sparse.csr_matrix, data: Array) -> Any:
        """A matrix of N's pattern on the independent nodes, with numbers or blocks."""
        C, d = self._displacement.C, self._points.gdim
        if data.ndim == 1:
            M = scipy.sparse.csr_matrix((data, N.indices, N.indptr), shape=N.shape)
            return M if C is None else scipy.sparse.csr_matrix(M @ C)
        shape = N.shape[0] * d, N.shape[1] * d
        B = scipy.sparse.bsr_matrix((data, N.indices, N.indptr), shape=shape)
        if C is None:
            return B
        blocks = C.data[:, None, None] * np.eye(d)
        shape = C.shape[0] * d, C.shape[1] * d
        return B @ scipy.sparse.bsr_matrix((blocks, C.indices, C.indptr), shape=shape)
