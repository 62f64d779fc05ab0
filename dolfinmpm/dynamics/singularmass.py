"""Solutions of M a = f where a consistent mass is singular to rounding.

A field with fewer points than free nodes has vectors n with M n = 0, and motion along them moves no
point. Neither the momenta of the points nor M a depend on the part of a along them, so it is left
out. Forces along n have no mass to accelerate. They are balanced by the stiffness in the step.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

__all__ = ["solution_without_null_vectors"]

Array = npt.NDArray[np.float64]

# ε: vectors whose mass is below this share of their nodes' own count as without mass
_SHARE = 1e-8
# residuals that CG reaches with forces along vectors without mass: rounding over ε
_TOLERANCE, _MOST = 1e-7, 4000
# the error of vectors that have mass is about ε to the power of the number of passes
_PASSES = 3


def solution_without_null_vectors(M: PETSc.Mat, f: PETSc.Vec) -> Array | None:
    """The solution of M a = f in the least squares, without parts along null vectors. Collective.

    With D the diagonal of M and S = M + ε D, the product S⁻¹ M S⁻¹ is 1/λ (λ/(λ + ε))² on vectors
    of eigenvalue λ (of M beside D), and zero on null vectors. The rest f − M a is solved likewise.

    Args:
        M: The mass, symmetric, without negative eigenvalues but by rounding.
        f: The right-hand side.

    Returns:
        This rank's values, or None if CG does not converge.
    """
    shifted = M.copy()
    diagonal = M.getDiagonal()
    diagonal.scale(1.0 + _SHARE)
    shifted.setDiagonal(diagonal)
    ksp = PETSc.KSP().create(M.getComm())
    ksp.setType("cg")
    ksp.getPC().setType("jacobi")
    ksp.setTolerances(rtol=_TOLERANCE, atol=0.0, divtol=1e300, max_it=_MOST)
    ksp.setOperators(shifted)
    a, rest, once, part = (f.duplicate() for _ in range(4))
    a.set(0.0)
    for _ in range(_PASSES):
        M.mult(a, rest)
        rest.aypx(-1.0, f)
        ksp.solve(rest, once)
        found = ksp.getConvergedReason() > 0
        M.mult(once, rest)
        ksp.solve(rest, part)
        if not (found and ksp.getConvergedReason() > 0):
            return None
        a.axpy(1.0, part)
    return np.array(a.getArray(readonly=True))
