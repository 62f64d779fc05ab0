"""The linear systems of Newton's method, by factors or by iterations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.cut.activation import Activation
from dolfinmpm.solve import krylov, latticelevels, schur
from dolfinmpm.solve.method import Method, Tangent, as_used
from dolfinmpm.solve.mumps import WORKSPACE, Mumps
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.preconditionerreuse import PreconditionerReuse
from dolfinmpm.solve.solverchoice import MethodChoice
from dolfinmpm.solve.spectra import near_kernel
from dolfinmpm.solve.substructures import Substructures
from dolfinmpm.solve.symmetrytest import looks_symmetric

__all__ = ["FACTORISATION", "WORKSPACE", "LinearSolver"]

Array = npt.NDArray[np.float64]

# PETSc's error codes of an external library and of zero pivots in LU and Cholesky
FACTORISATION = (76, 71, 81)
# Factor of the residual that is expected after an iteration with a former tangent
_SAFE = 4.0
# Iterations of one more solution with the same tangent
MOST_AGAIN = 500


class LinearSolver:
    """SNES with its matrix and its factors. Both are kept as long as the pattern stays.

    Args:
        comm: Communicator of the problem.
        gdim: Dimension of space.
        tangent: Known properties of the tangent.
        options: PETSc options.

    Attributes:
        comm: The argument.
        snes: The solver.
        matrix: The matrix, or None before the first one and after a failure.
        true: The tangent without soft stiffness, as a PETSc matrix.
        choice: Choice of the method.
        method: The method, or None before the first matrix.
        stuck: Whether the last `solve` or `again` failed.
        version: Number of the last tangent or preparation.
        has_tangent: Whether a tangent was assembled since the last `attach`.
        reuse: Decision to keep a preconditioner, or None if the method never keeps one.
    """

    def __init__(self, comm: MPI.Intracomm, gdim: int, tangent: Tangent, options: Options):
        self.comm, self._gdim, self._options = comm, gdim, options
        self.choice, self._checked = MethodChoice(comm, gdim, tangent, options), False
        self._mumps = Mumps(gdim, options)
        self.matrix: Matrix | None = None
        self.true: Any = None
        self.method: Method | None = None
        self.reuse: PreconditionerReuse | None = None
        self.stuck = self.has_tangent = False
        self.version = 0
        # norm of the residual one Newton iteration before
        self._former: float | None = None
        self.snes: Any = None

    def twin(self, complete: bool) -> LinearSolver:
        """A solver with the same choices so far, and with a matrix and factors of its own.

        Args:
            complete: Whether factors must be complete, which are cheaper than several solutions
                with incomplete factors.
        """
        other = LinearSolver(self.comm, self._gdim, self.choice.tangent, self._options)
        other._checked = self._checked
        other.choice.no_incomplete = complete
        return other

    @property
    def mumps(self) -> dict[int, int]:
        """Settings of MUMPS by their numbers."""
        return self._mumps.settings

    @property
    def _ksp(self) -> PETSc.KSP:
        return self.snes.getKSP()

    @property
    def used(self) -> Method | None:
        """The method with the changes by options; None before the first matrix."""
        if self.method is None or self.snes is None:
            return self.method
        return as_used(self.method, self.snes.getKSP())

    @property
    def iterations(self) -> list[int]:
        """Iterations of each solution since the last call; empty with factors."""
        if self.reuse is None:
            return []
        found, self.reuse.iterations = self.reuse.iterations, []
        return found

    @property
    def failed(self) -> bool:
        """Whether it failed since the last `attach`."""
        return self.matrix is None

    def attach(self, operator: Operator) -> None:
        """Prepare the matrix for an operator; a matrix of the same pattern stays. Collective."""
        here = operator.here
        self._former, self.has_tangent = None, False
        self.version += 1
        self.choice.attached()
        self._choose(here.unknowns.total)
        self._take_matrix(here)
        if self.choice.tangent.symmetric and not self._checked:
            self._checked = True
            assert self.matrix is not None
            if not looks_symmetric(operator, self.matrix):
                self.choice.tangent = replace(self.choice.tangent, symmetric=False)
                self._choose(here.unknowns.total)
                self._take_matrix(here)
        assert self.matrix is not None
        self.true = self.matrix.petsc
        if operator.soft:
            product = krylov.WithoutSoftStiffness(here.unknowns, operator.soft)
            self.true = product.operator(self.matrix.petsc)

    def _choose(self, count: int) -> None:
        """Choose the method for a number of unknowns. Collective."""
        choice, options = self.choice, self._options
        if self.reuse is not None:
            choice.weigh(self.reuse)
        method, former = choice.method(count), self.method
        self.method = method
        if former is not None and method.like(former) and self.snes is not None:
            return
        self.matrix = self.true = None
        self.snes = krylov.create(self.comm, method, options, choice.tangent.softened)
        self.reuse = None
        if krylov.keeps(method, options):
            self.reuse = PreconditionerReuse(self.comm)
            self.reuse.watch(self._ksp)

    def _take_matrix(self, here: Activation) -> None:
        """Take the matrix for an activation: the present one, or a new one. Collective."""
        kept = self.matrix is not None and self.matrix.pattern is here.pattern
        # a matrix of the same pattern keeps its symbolic factorisation; its creation is collective
        if self.comm.allreduce(kept, op=MPI.LAND):
            return
        # old matrix and factors are freed first, because they need the most memory
        self.snes.reset()
        if self.matrix is not None:
            # on several ranks, Python's garbage collection frees no PETSc object
            self.matrix.petsc.destroy()
        self.matrix = self.true = None
        self.matrix = Matrix(here.pattern, here.unknowns)
        A = self.matrix.petsc
        A.setOption(PETSc.Mat.Option.SYMMETRIC, self.choice.tangent.symmetric)
        if self.choice.tangent.symmetric and self.choice.definite:
            A.setOption(PETSc.Mat.Option.SPD, True)
        pc = self._ksp.getPC()
        kind = pc.getType()
        if kind == "mg":
            latticelevels.set_levels(pc, here)
        elif here.unknowns.block > 1:
            A.setNearNullSpace(near_kernel(here, A))
        if kind == "fieldsplit":
            schur.split(pc, here, A)
        self._mumps.apply(self._ksp, A)
        if self.reuse is not None:
            self.reuse.renew()
        made = pc.getPythonContext() if kind == "python" else None
        if isinstance(made, Substructures) and not made.pays(A):
            self.choice.no_substructures = "too many unknowns between the ranks"
            self._choose(here.unknowns.total)
            self._take_matrix(here)

    def relax(self) -> bool:
        """Choose a more robust method after a failure; returns whether there is one.

        A tangent may be indefinite, such as beyond a limit point, or multigrid may not converge.
        Factors with pivots of both signs then solve the system. Other methods are left out for
        some time, longer each time.
        """
        method = self.method
        assert method is not None
        if self.reuse is not None and self.reuse.old:
            self.reuse.distrust()
            return True
        if not self.choice.failed(method, self.reuse):
            return False
        self.forget()
        return True

    def assembled(self, norm: float, enough: float) -> None:
        """Prepare the solution with a new tangent. Collective.

        Args:
            norm: Norm of the residual (N).
            enough: Norm of the residual at which the solution may end (N).
        """
        method, self.has_tangent = self.method, True
        self.version += 1
        self._aim(norm, enough)
        if self.reuse is None or method is None:
            return
        if method.factors:
            self._ksp.setTolerances(max_it=krylov.MOST_OF_FACTORS)
        if method.incomplete:
            # new incomplete factors are cheap; old ones may suddenly need many iterations
            self.reuse.renew()
        self._prepare()
        if not method.factors and not method.incomplete and "ksp_max_it" not in self._options.names:
            most = self.reuse.most(self._ksp.getTolerances()[0], krylov.MOST)
            self._ksp.setTolerances(max_it=most)

    def serves(self, norm: float, enough: float) -> bool:
        """Prepare another solution with the last tangent, if it is good enough for the iteration.

        A tangent reduces the residual by a share that grows with the distance of its increments
        from the solution. In the next iteration, a former tangent is about as far away as it was
        in the last one, and the residual falls by about the same share once more. With the PETSc
        option `snes_lag_jacobian`, each iteration has a tangent of its own.

        Args:
            norm, enough: See `assembled`.

        Returns:
            Whether it is: the iteration probably is the last one.
        """
        former = self._former
        if former is None or not self.has_tangent or "snes_lag_jacobian" in self._options.names:
            return False
        if _SAFE * norm**2 > enough * former:
            return False
        self._aim(norm, enough)
        return True

    def _aim(self, norm: float, enough: float) -> None:
        """Set the accuracy of the next solution; see `assembled`."""
        if self.reuse is not None and self.method is not None:
            if "ksp_rtol" not in self._options.names:
                rtol = krylov.relative_tolerance(self.method, norm, self._former, enough)
                self._ksp.setTolerances(rtol=rtol)
            self._ksp.setTolerances(atol=max(enough, 1e-300))
        self._former = norm

    def _prepare(self) -> None:
        """Keep or renew the preconditioner for the present matrix. Collective."""
        assert self.matrix is not None
        ksp, A = self._ksp, self.matrix.petsc
        ksp.setOperators(self.true, A)
        if self.reuse is None:
            return
        blocks = ksp.getPC().getType() == "fieldsplit"
        self.reuse.prepare(
            ksp, (lambda: schur.prepare(ksp.getPC(), A, self._options)) if blocks else None
        )

    def take_tangent(self, operator: Operator) -> None:
        """Assemble the tangent of an operator that is attached. Collective."""
        assert self.matrix is not None
        operator.tangent(self.matrix)

    def vector(self) -> PETSc.Vec:
        """A vector of the unknowns. Collective."""
        assert self.matrix is not None
        return self.matrix.petsc.createVecRight()

    def solve(self, right: Array, guess: Array | None = None) -> Array:
        """Solve with the last assembled tangent. Collective.

        Args:
            right: Right-hand side, shape (owned,).
            guess: First guess of the solution for iterations, likewise, or None.
        """
        method, ksp = self.method, self._ksp
        b, y = self.vector(), self.vector()
        b.getArray()[:] = right
        guessed = guess is not None and ksp.getType() != "preonly"
        if guessed:
            y.getArray()[:] = guess
        ksp.setInitialGuessNonzero(guessed)
        if self.reuse is not None and method is not None:
            ksp.setTolerances(rtol=krylov.DIGITS, atol=1e-300)
            if method.factors or method.incomplete:
                # later right-hand sides of the same matrix need all digits, too
                self.reuse.renew()
            elif "ksp_max_it" not in self._options.names:
                ksp.setTolerances(max_it=krylov.MOST)
        self._prepare()
        ksp.solve(b, y)
        ksp.setInitialGuessNonzero(False)
        self.stuck = ksp.getConvergedReason() < 0
        return np.array(y.getArray(readonly=True))

    @property
    def direct(self) -> bool:
        """Whether complete factors solve, so that a first guess is of no use."""
        return self.method is not None and self.method.factors and not self.method.incomplete

    def product(self, x: Array) -> Array:
        """Product of the last tangent with a vector, shape (owned,). Collective."""
        a, b = self.vector(), self.vector()
        a.getArray()[:] = x
        self.true.mult(a, b)
        return np.array(b.getArray(readonly=True))

    def again(self, right: Array, digits: float = krylov.DIGITS) -> Array:
        """Solve once more with the last tangent and preconditioner, which stay. Collective.

        Args:
            right: See `solve`.
            digits: Residual that may remain, relative to the right-hand side.
        """
        A, b, y = self.true, self.vector(), self.vector()
        b.getArray()[:] = right
        self.stuck = False
        if self.direct:
            self._ksp.getPC().apply(b, y)
            # Krylov's method repairs what factors of another matrix, or with too small pivots,
            # leave
            rest = A.createVecLeft()
            A.mult(y, rest)
            rest.axpy(-1.0, b)
            if rest.norm() <= digits * b.norm():
                return np.array(y.getArray(readonly=True))
        if self._ksp.getType() == "preonly":
            return self.solve(right, y.getArray(readonly=True))
        self._iterate(b, y, digits)
        return np.array(y.getArray(readonly=True))

    def _iterate(self, b: PETSc.Vec, y: PETSc.Vec, digits: float) -> None:
        """Iterate with the last preconditioner; settings and counts stay. Collective.

        Args:
            b: Right-hand side.
            y: Output; with complete factors also the first guess.
            digits: See `again`.
        """
        ksp, kept = self._ksp, self._ksp.getTolerances()
        ksp.setTolerances(rtol=digits, atol=1e-300, max_it=MOST_AGAIN)
        ksp.setInitialGuessNonzero(self.direct)
        if self.reuse is not None:
            self.reuse.rests = True
        ksp.solve(b, y)
        self.stuck = ksp.getConvergedReason() < 0
        if self.reuse is not None:
            self.reuse.rests = False
        ksp.setInitialGuessNonzero(False)
        ksp.setTolerances(*kept)

    def forget(self) -> None:
        """Discard the solver after a failure, because PETSc cannot continue with it."""
        self.snes = self.matrix = self.true = None

    def warn_of_unread_options(self) -> None:
        """Warn of options that PETSc has not read, see `Options`."""
        if self._options.unread:
            self._options.warn_of_unread(self.comm)

    def why(self, error: PETSc.Error) -> str:
        """Reason of a failed factorisation; other errors are raised again."""
        self.forget()
        cause = error.__cause__
        if cause is not None and not isinstance(cause, PETSc.Error):
            raise cause from None
        if error.ierr not in FACTORISATION:
            raise error
        return "the linear solver failed: the tangent is singular"

    def enlarge(self) -> bool:
        """Give MUMPS more workspace if it had too little; returns whether it did. Collective."""
        assert self.matrix is not None
        return self._mumps.enlarge(self._ksp, self.matrix.petsc)
