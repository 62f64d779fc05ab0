"""The tangent without its terms of the tangent only, which then precondition it."""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

from dolfinmpm.assembly.stencilsums import add_product
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.cut.unknowns import Unknowns

__all__ = ["WithoutSoftStiffness"]


class WithoutSoftStiffness:
    """Product of a stiffened tangent less its stiffening with a vector, for PETSc. Collective.

    Left in the linear systems the stiffening would leave the forces on functions that
    hardly feel the body almost as they were, iteration by iteration.

    Args:
        unknowns: Numbering of the unknowns.
        blocks: The terms of the tangent only.
    """

    def __init__(self, unknowns: Unknowns, blocks: Sequence[Blocks]):
        self._unknowns, self._blocks = unknowns, blocks
        self._u, self._force = unknowns.nodal(), unknowns.nodal()
        self._still = [u.copy() for u in self._u.arrays]

    def operator(self, stiffened: PETSc.Mat) -> PETSc.Mat:
        """The tangent as a PETSc matrix. Collective.

        Args:
            stiffened: The tangent with the terms of the tangent only.
        """
        self._matrix = stiffened
        shell = PETSc.Mat().createPython(stiffened.getSizes(), self, comm=stiffened.comm)
        shell.setUp()
        return shell

    def mult(self, matrix, x, y) -> None:
        """PETSc calls this. Collective."""
        self._matrix.mult(x, y)
        self._unknowns.clear(self._force)
        self._unknowns.expand(x.getArray(readonly=True), self._still, self._u)
        for blocks in self._blocks:
            add_product(blocks, self._u.arrays, self._force.arrays)
        self._force.add_up()
        y.getArray()[:] -= self._unknowns.restrict(self._force.arrays)
