"""Block solution of a displacement and a pressure, with the pressure's Schur complement."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from petsc4py import PETSc

from dolfinmpm.cut.activation import Activation
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.spectra import near_kernel_within

__all__ = ["prepare", "schur_matrix", "split"]

# Factor between −Σ_j B_ij diag(A)_j⁻¹ B̄_ji and the pressure's lumped mass over λ + 2μ. It is
# 64 (λ + 4μ)/(27 (λ + 2μ)) for trilinear functions, 3.7 at ν = 0.3; 3.4 for bilinear functions; 2.9
# for quadratic splines in 3D. A wrong factor of 2 costs an iteration or two.
_MASS = 3.0


def split(pc: PETSc.PC, here: Activation, A: PETSc.Mat) -> None:
    """Set the rows of both fields, and the rigid modes of the first, in PETSc. Collective."""
    unknowns = here.unknowns
    first = A.getOwnershipRange()[0]
    parts = []
    for k in range(len(unknowns.fields)):
        rows = np.flatnonzero(unknowns.only(k, np.ones(unknowns.owned))).astype(np.int32)
        parts.append(PETSc.IS().createGeneral(first + rows, comm=unknowns.comm))
    parts[0].compose("nearnullspace", near_kernel_within(here, A, parts[0]))
    pc.setFieldSplitIS(("u", parts[0]), ("p", parts[1]))
    # the matrix keeps the rows for `prepare`
    A.compose("rows of u", parts[0])
    A.compose("rows of p", parts[1])


def prepare(pc: PETSc.PC, A: PETSc.Mat, options: Options) -> None:
    """Set the Schur complement of a new preconditioner, unless options do. Collective."""
    if "pc_fieldsplit_schur_precondition" in options.names:
        return
    S = schur_matrix(A, A.query("rows of u"), A.query("rows of p"))
    pc.setFieldSplitSchurPreType(PETSc.PC.FieldSplitSchurPreType.USER, S)


def schur_matrix(A: PETSc.Mat, of_u: PETSc.IS, of_p: PETSc.IS) -> PETSc.Mat:
    """C + D for the Schur complement C − B A⁻¹ B̄ of a tangent (A, B̄; B, C). Collective.

    −B A⁻¹ B̄ is, for any wave number, a mass of the pressure over the modulus of the soil. A
    diagonal D can represent it; C represents storage and flow. D follows from the tangent, so that
    it has the stiffness of the soil where the soil yields, in layers and in cut cells. The usual
    −B diag(A)⁻¹ B̄ is h² times a Laplacian instead. It underestimates smooth pressures, more so on
    finer grids.

    Args:
        A: The tangent.
        of_u, of_p: Rows of the displacement and of the pressure.
    """
    B, back = A.createSubMatrix(of_p, of_u), A.createSubMatrix(of_u, of_p)
    turned = back.transpose()
    start, columns, values = B.getValuesCSR()
    other = turned.getValuesCSR()
    if np.array_equal(start, other[0]) and np.array_equal(columns, other[1]):
        both: Any = (start, columns, values * other[2])
    else:
        shape = start.size - 1, B.getSize()[1]
        found = scipy.sparse.csr_matrix((values, columns, start), shape)
        found = found.multiply(
            scipy.sparse.csr_matrix((other[2], other[1], other[0]), shape)
        ).tocsr()
        both = found.indptr, found.indices, found.data
    products = PETSc.Mat().createAIJ(B.getSizes(), csr=both, comm=A.comm)
    diagonal, inverse = A.getDiagonal(), B.createVecRight()
    part = diagonal.getSubVector(of_u).getArray(readonly=True)
    inverse.getArray()[:] = 1.0 / np.where(part == 0.0, np.inf, part)
    S = A.createSubMatrix(of_p, of_p)
    more, whole = S.createVecLeft(), S.getDiagonal()
    products.mult(inverse, more)
    whole.axpy(-_MASS, more)
    S.setDiagonal(whole)
    for used in (B, back, turned, products):
        used.destroy()
    return S
