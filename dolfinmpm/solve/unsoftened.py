"""The tangent without its terms of the tangent only, which then precondition it."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx.la import InsertMode
from petsc4py import PETSc

from dolfinmpm.assembly.points import multiply_blocks
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.grid.halo import Numbering

__all__ = ["Unsoftened"]


class Unsoftened:
    """Product of a stiffened tangent less its stiffening with a vector, for PETSc.

    Left in the linear systems the stiffening would leave the forces on functions that
    hardly feel the body almost as they were, iteration by iteration.

    Args:
        numbering: Numbering of the nodes.
        components: Unknowns a node.
    """

    def __init__(self, numbering: Numbering, components: int):
        self._u, self._r = numbering.vector(components), numbering.vector(components)
        self._shape = numbering.size, components

    def operator(self, stiffened: PETSc.Mat, blocks: Any, unknowns: Unknowns) -> PETSc.Mat:
        """The tangent as a PETSc matrix. Collective.

        Args:
            stiffened: The tangent with the terms of the tangent only.
            blocks: These: rows, columns and blocks between nodes.
            unknowns: Unknowns of the nodes.
        """
        self._matrix, self._blocks, self._unknowns = stiffened, blocks, unknowns
        size = stiffened.getSizes()
        shell = PETSc.Mat().createPython(size, self, comm=stiffened.comm)
        shell.setUp()
        return shell

    def renew(self, blocks: Any) -> None:
        """Take the terms of a new step."""
        self._blocks = blocks

    def mult(self, matrix, x, y) -> None:
        """PETSc calls this. Collective."""
        self._matrix.mult(x, y)
        unknowns = self._unknowns
        nodal, forces = self._u.array.reshape(self._shape), self._r.array.reshape(self._shape)
        nodal[:] = 0.0
        forces[:] = 0.0
        unknowns.scatter(x.getArray(readonly=True), nodal)
        nodal[unknowns.fixed] = 0.0
        parallel = unknowns.comm.size > 1
        if parallel:
            self._u.scatter_forward()
        multiply_blocks(*self._blocks, nodal, forces)
        if parallel:
            self._r.scatter_reverse(InsertMode.add)
        nodes = unknowns.owned_nodes
        y.getArray()[:] -= forces[nodes][~np.asarray(unknowns.fixed)[nodes]]
