"""What the pressure's block of a field split is preconditioned by."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

__all__ = ["Complement"]

# B diag(A)⁻¹ Bᵀ has the scale of the mass that B A⁻¹ Bᵀ is near to. With shares of 1, 3, 8 it
# takes 10, 8, 8 iterations where nothing drains
_SHARE = 3.0
_SMALLEST = 1e-12


class Complement:
    """The Schur complement of a displacement and a pressure, S = C − B₂ A⁻¹ B₁, approximately.

    A displacement that gives way to a pressure stores volume as a mass of the pressure does,
    divided by a modulus (Verfürth 1984; Silvester & Wathen 1994, doi 10.1137/0731070). So S is
    taken for C, which is what flows, and a diagonal matrix in place of the mass, three times the
    diagonal of −B₂ diag(A)⁻¹ B₁. That product itself has the mass's scale, but does next to nothing
    to pressures that are even, and multigrid, which needs those, fails on it.

    Args:
        rows: Rows of the displacement and of the pressure.
    """

    def __init__(self, rows: tuple[PETSc.IS, PETSc.IS]):
        self._rows = rows
        # C, B₂ and B₁, once there is a tangent
        self._blocks: list[Any] = [None, None, None]

    def update(self, matrix: PETSc.Mat) -> PETSc.Mat:
        """S of a tangent of both fields, whose pattern stays. Collective."""
        u, p = self._rows
        places = (p, p), (p, u), (u, p)
        C, B2, B1 = self._blocks = [
            matrix.createSubMatrix(*rows, block) for rows, block in zip(places, self._blocks)
        ]
        whole = matrix.getDiagonal()
        part = whole.getSubVector(u)
        d = part.copy()
        whole.restoreSubVector(u, part)
        d.abs()
        d.shift(_SMALLEST * d.max()[1])
        d.reciprocal()
        squares, size = _squares(B2)
        T = B1.transpose(PETSc.Mat())
        copy, other = _squares(T)
        stored = squares.createVecLeft()
        squares.mult(d, stored)
        # equations may have another scale than forces
        scale = np.divide(other, size, out=np.zeros_like(size), where=size > 0)
        stored.getArray()[:] *= _SHARE * scale * _sign(B2, d, B1)
        diagonal = C.getDiagonal()
        diagonal.axpy(1.0, stored)
        C.setDiagonal(diagonal)
        for item in (squares, copy, T):
            item.destroy()
        return C


def _sign(B2: PETSc.Mat, d: PETSc.Vec, B1: PETSc.Mat) -> float:
    """Of −B₂ diag(d) B₁, which the form decides. Collective."""
    x, inner = B1.createVecs()
    x.setRandom()
    B1.mult(x, inner)
    inner.pointwiseMult(inner, d)
    y = B2.createVecLeft()
    B2.mult(inner, y)
    return -1.0 if x.dot(y) > 0 else 1.0


def _squares(B: PETSc.Mat) -> tuple[PETSc.Mat, npt.NDArray[np.float64]]:
    """A matrix of squared entries, and the norms of the rows of this rank."""
    starts, columns, values = B.getValuesCSR()
    squares = PETSc.Mat().createAIJ(B.getSizes(), csr=(starts, columns, values**2), comm=B.comm)
    sums = np.zeros(len(starts) - 1)
    filled = np.diff(starts) > 0
    sums[filled] = np.add.reduceat(values**2, starts[:-1][filled]) if len(values) else 0.0
    return squares, np.sqrt(sums)
