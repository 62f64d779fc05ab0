"""The linear systems of Newton's method: LU factors by MUMPS, unless PETSc options say else."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.assembly.points import Matrix
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.options import Options

__all__ = ["WORKSPACE", "LinearSolver"]

Array = npt.NDArray[np.float64]

# PETSc's numbers for an error in an external library and for a zero pivot
_FACTORISATION = (76, 71)
# MUMPS's numbers for settings, and for ends for want of integer, real and send workspace
_ORDERING, WORKSPACE = 7, 14
_SHORT_OF_WORKSPACE = (-8, -9, -17)


class LinearSolver:
    """SNES with its matrix and factors, kept as long as the pattern is the same.

    Args:
        comm: Communicator of the problem.
        gdim: Dimension of space.
        softened: Whether the factors are those of a softened matrix, which
            precondition GMRES for the true one.
        options: PETSc options.

    Attributes:
        snes: The solver.
        matrix: The matrix, or None before the first and after a failure.
        true: The matrix that products are taken with, as PETSc sees it.
        mumps: Settings of MUMPS by their numbers.
    """

    def __init__(self, comm: MPI.Intracomm, gdim: int, softened: bool, options: Options):
        self._comm, self._softened, self._options = comm, softened, options
        # minimum fill: a tenth less time and memory than with the ordering that MUMPS chooses
        self.mumps = {_ORDERING: 2} if gdim < 3 else {}
        self.matrix: Matrix | None = None
        self.true: Any = None
        self.snes = self._create()

    def _create(self) -> PETSc.SNES:
        database, prefix = PETSc.Options(), self._options.prefix
        if self._softened and not self._options.has("ksp_converged_maxits"):
            # Newton's method corrects what is left
            database[prefix + "ksp_converged_maxits"] = True
        snes = PETSc.SNES().create(self._comm)
        snes.setOptionsPrefix(prefix)
        snes.setType("newtonls")
        ksp = snes.getKSP()
        ksp.setType("preonly")
        if self._softened:
            ksp.setType("gmres")
            ksp.setTolerances(rtol=1e-11, max_it=60)
            ksp.setGMRESRestart(60)
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
        snes.setFromOptions()
        return snes

    @property
    def failed(self) -> bool:
        """Whether it failed since the last `attach`."""
        return self.matrix is None

    def attach(self, operator: Operator) -> None:
        """Take the matrix of an operator; that of the same pattern stays. Collective."""
        here = operator.here
        kept = self.matrix is not None and self.matrix.pattern is here.pattern
        # with its pattern a matrix keeps its symbolic factorisation; creating one is collective
        if not self._comm.allreduce(kept, op=MPI.LAND):
            # the old matrix and its factors go before the new ones come: they are the largest
            self.snes.reset()
            self.matrix = None
            self.matrix = Matrix(here.pattern, here.unknowns)
            self._use_mumps()
        assert self.matrix is not None
        self.true = operator.unsoftened(self.matrix)

    def vector(self) -> PETSc.Vec:
        """A vector of the unknowns. Collective."""
        assert self.matrix is not None
        return self.matrix.petsc.createVecRight()

    def solve(self, right: Array) -> Array:
        """Solve with the tangent that was assembled last. Collective.

        Args:
            right: Right-hand side, shape (owned,).
        """
        assert self.matrix is not None
        b, y = self.vector(), self.vector()
        b.getArray()[:] = right
        ksp = self.snes.getKSP()
        ksp.setOperators(self.true, self.matrix.petsc)
        ksp.solve(b, y)
        return np.array(y.getArray(readonly=True))

    def forget(self) -> None:
        """Begin anew after a failure: what PETSc was in the middle of cannot be gone on with."""
        self.snes = self._create()
        self.matrix = self.true = None

    def why(self, error: PETSc.Error) -> str:
        """Why it failed, if that is no fault of the program; else raises what it is."""
        self.forget()
        cause = error.__cause__
        if cause is not None and not isinstance(cause, PETSc.Error):
            raise cause from None
        if error.ierr not in _FACTORISATION:
            raise error
        return "the linear solver failed: the tangent is singular"

    # -- MUMPS ----------------------------------------------------------------

    @property
    def _uses_mumps(self) -> bool:
        pc = self.snes.getKSP().getPC()
        return pc.getType() == "lu" and pc.getFactorSolverType() == "mumps"

    def _given(self, number: int) -> bool:
        return self._options.has(f"mat_mumps_icntl_{number}")

    def _use_mumps(self) -> None:
        """Create MUMPS's factors with the settings that no option sets. Collective."""
        settings = {k: v for k, v in self.mumps.items() if not self._given(k)}
        assert self.matrix is not None
        if self._uses_mumps and settings and self.matrix.petsc.getSize()[0]:
            ksp = self.snes.getKSP()
            ksp.setOperators(self.matrix.petsc)
            ksp.getPC().setFactorSetUpSolverType()
            for number, value in settings.items():
                ksp.getPC().getFactorMatrix().setMumpsIcntl(number, value)

    def enlarge(self) -> bool:
        """Double MUMPS's workspace if the last factorisation ended for want of it. Collective.

        Returns whether it did, with new factors, because those that failed fail again. A
        plastic tangent near a limit load needs pivots off the diagonal, and more room for
        what they fill in than the 20 % beyond its forecast that MUMPS takes.
        """
        if not self._uses_mumps or self._given(WORKSPACE):
            return False
        factors = self.snes.getKSP().getPC().getFactorMatrix()
        if factors.getMumpsInfog(1) not in _SHORT_OF_WORKSPACE:
            return False
        share = 2 * self.mumps.get(WORKSPACE, 50)
        if share > 1000:
            return False
        self.mumps[WORKSPACE] = share
        self.snes.getKSP().getPC().reset()
        self._use_mumps()
        return True
