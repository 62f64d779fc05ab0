"""The linear systems of Newton's method: factors or multigrid, by what the tangent is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.cut.activation import Activation
from dolfinmpm.grid.lattice import smallest_height
from dolfinmpm.solve import krylov, schur
from dolfinmpm.solve.method import Method, Tangent, as_used, crossover
from dolfinmpm.solve.mumps import WORKSPACE, Mumps
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.reuse import Reuse
from dolfinmpm.solve.solverchoice import MethodChoice
from dolfinmpm.solve.spectra import near_kernel
from dolfinmpm.solve.substructures import Substructures

__all__ = ["WORKSPACE", "LinearSolver"]

Array = npt.NDArray[np.float64]

# PETSc's numbers for an error in an external library and for zero pivots of LU and Cholesky
_FACTORISATION = (76, 71, 81)
# Share of a product's size that a symmetric matrix may be off by rounding
_SYMMETRIC = 1e-9
# Size of increments at which symmetry is looked at, in cells
_NEAR = 1e-4


class LinearSolver:
    """SNES with its matrix and factors, kept as long as the pattern is the same.

    Args:
        comm: Communicator of the problem.
        gdim: Dimension of space.
        tangent: What is known of the tangent.
        options: PETSc options.

    Attributes:
        snes: The solver.
        matrix: The matrix, or None before the first and after a failure.
        true: The matrix that products are taken with, as PETSc sees it.
        choice: Which method solves next.
        method: What solves, or None before the first matrix.
        stuck: Whether the last `solve` found nothing.
        reuse: When a preconditioner is kept for the next tangent; None of factors that never are.
    """

    def __init__(self, comm: MPI.Intracomm, gdim: int, tangent: Tangent, options: Options):
        self._comm, self._gdim, self._options = comm, gdim, options
        self.choice, self._checked = MethodChoice(comm, gdim, tangent, options), False
        self._mumps = Mumps(gdim, options)
        self.matrix: Matrix | None = None
        self.true: Any = None
        self.method: Method | None = None
        self.reuse: Reuse | None = None
        self.stuck = False
        # norm of the residual of the iteration before
        self._former: float | None = None
        self.snes: Any = None

    def in_blocks(self, count: int) -> bool:
        """Whether so many unknowns are solved for by a method that wants a node's in a block."""
        pc = self._options.get("pc_type")
        if pc is not None:
            return pc in ("gamg", "hypre", "ml")
        return count >= crossover(self.choice.tangent, self._gdim)

    @property
    def mumps(self) -> dict[int, int]:
        """Settings of MUMPS by their numbers."""
        return self._mumps.settings

    @property
    def _ksp(self) -> PETSc.KSP:
        return self.snes.getKSP()

    @property
    def used(self) -> Method | None:
        """What solves, as options have left it; None before the first matrix."""
        if self.method is None or self.snes is None:
            return self.method
        return as_used(self.method, self.snes.getKSP())

    @property
    def iterations(self) -> list[int]:
        """Iterations of each solution since last asked, none with factors."""
        if self.reuse is None:
            return []
        found, self.reuse.iterations = self.reuse.iterations, []
        return found

    @property
    def failed(self) -> bool:
        """Whether it failed since the last `attach`."""
        return self.matrix is None

    def attach(self, operator: Operator) -> None:
        """Take the matrix of an operator; that of the same pattern stays. Collective."""
        here = operator.here
        self._former = None
        self.choice.doubt.left = max(self.choice.doubt.left - 1, 0)
        self._choose(here.unknowns.total)
        self._take(here)
        if self.choice.tangent.symmetric and not self._checked:
            self._checked = True
            if not self._looks_symmetric(operator):
                self.choice.tangent = replace(self.choice.tangent, symmetric=False)
                self._choose(here.unknowns.total)
                self._take(here)
        assert self.matrix is not None
        self.true = operator.without_soft(self.matrix)

    def _choose(self, count: int) -> None:
        """Take the method for so many unknowns. Collective."""
        choice, options = self.choice, self._options
        if self.reuse is not None:
            choice.weigh(self.reuse)
        method, former = choice.method(count), self.method
        self.method = method
        if former is not None and method.like(former) and self.snes is not None:
            return
        self.matrix = self.true = None
        self.snes = krylov.create(self._comm, method, options, choice.tangent.softened)
        self.reuse = None
        if krylov.keeps(method, options):
            self.reuse = Reuse(self._comm)
            self.reuse.watch(self._ksp)

    def _take(self, here: Activation) -> None:
        """Take the matrix of an activation. Collective."""
        kept = self.matrix is not None and self.matrix.pattern is here.pattern
        # with its pattern a matrix keeps its symbolic factorisation; creating one is collective
        if self._comm.allreduce(kept, op=MPI.LAND):
            return
        # the old matrix and its factors go before the new ones come: they are the largest
        self.snes.reset()
        if self.matrix is not None:
            # that Python lets go of it frees nothing yet on several ranks
            self.matrix.petsc.destroy()
        self.matrix = self.true = None
        self.matrix = Matrix(here.pattern, here.unknowns)
        A = self.matrix.petsc
        A.setOption(PETSc.Mat.Option.SYMMETRIC, self.choice.tangent.symmetric)
        if self.choice.tangent.symmetric and self.choice.definite:
            A.setOption(PETSc.Mat.Option.SPD, True)
        if here.unknowns.block > 1:
            A.setNearNullSpace(near_kernel(here, A))
        pc = self._ksp.getPC()
        if pc.getType() == "fieldsplit":
            schur.split(pc, here, A)
        self._mumps.apply(self._ksp, A)
        if self.reuse is not None:
            self.reuse.renew()
        made = pc.getPythonContext() if pc.getType() == "python" else None
        if isinstance(made, Substructures) and not made.pays(A):
            self.choice.parts = "too many unknowns between the ranks"
            self._choose(here.unknowns.total)
            self._take(here)

    def _looks_symmetric(self, operator: Operator) -> bool:
        """Whether the tangent is symmetric near the present state: yᵀKx = xᵀKy. Collective."""
        assert self.matrix is not None
        random = np.random.default_rng(operator.here.unknowns.comm.rank)
        n, scale = operator.here.unknowns.owned, _NEAR * smallest_height(operator.form.points.grid)
        # a state that differs everywhere from one without strain, where more is symmetric
        operator.move(scale * random.uniform(-1, 1, n))
        operator.tangent(self.matrix)
        x, y, Kx, Ky = (self.vector() for _ in range(4))
        for v in (x, y):
            v.getArray()[:] = random.uniform(-1, 1, n)
        self.matrix.petsc.mult(x, Kx)
        self.matrix.petsc.mult(y, Ky)
        size = Kx.norm() * y.norm()
        return abs(y.dot(Kx) - x.dot(Ky)) <= _SYMMETRIC * size

    def relax(self) -> bool:
        """Ask less of a tangent after a failure; returns whether there was less to ask.

        A tangent that is not positive definite, as past a limit point, or on which multigrid
        does not converge, is no end: factors with pivots of both signs solve it. For a while
        nothing else is tried, longer each time.
        """
        method = self.method
        assert method is not None
        if self.reuse is not None and self.reuse.old:
            self.reuse.renew()
            return True
        if not self.choice.failed(method, self.reuse):
            return False
        self.forget()
        return True

    def assembled(self, norm: float, enough: float) -> None:
        """Make ready for a tangent that has been assembled. Collective.

        Args:
            norm: Norm of the residual to be reduced (N).
            enough: Norm of a residual that need not be reduced any further (N).
        """
        method = self.method
        if self.reuse is None or method is None:
            return
        ksp = self._ksp
        if not self._options.has("ksp_rtol"):
            ksp.setTolerances(rtol=krylov.share(method, norm, self._former))
        self._former = norm
        ksp.setTolerances(atol=max(enough, 1e-300))
        if method.factors:
            ksp.setTolerances(max_it=krylov.MOST_OF_FACTORS)
        if method.incomplete:
            # new ones cost about what iterations with old ones do, which may be many of a sudden
            self.reuse.renew()
        self._prepare()

    def _prepare(self) -> None:
        """Keep or renew the preconditioner for the matrix as it is. Collective."""
        assert self.matrix is not None
        ksp, A = self._ksp, self.matrix.petsc
        ksp.setOperators(self.true, A)
        if self.reuse is None:
            return
        blocks = ksp.getPC().getType() == "fieldsplit"
        self.reuse.prepare(
            ksp, (lambda: schur.prepare(ksp.getPC(), A, self._options)) if blocks else None
        )

    def vector(self) -> PETSc.Vec:
        """A vector of the unknowns. Collective."""
        assert self.matrix is not None
        return self.matrix.petsc.createVecRight()

    def solve(self, right: Array) -> Array:
        """Solve with the tangent that was assembled last. Collective.

        Args:
            right: Right-hand side, shape (owned,).
        """
        method, ksp = self.method, self._ksp
        b, y = self.vector(), self.vector()
        b.getArray()[:] = right
        if self.reuse is not None and method is not None:
            ksp.setTolerances(rtol=krylov.DIGITS, atol=1e-300)
            if method.factors or method.incomplete:
                # the next right-hand side is of the same matrix, and asks for all digits
                self.reuse.renew()
        self._prepare()
        ksp.solve(b, y)
        self.stuck = ksp.getConvergedReason() < 0
        return np.array(y.getArray(readonly=True))

    def forget(self) -> None:
        """Begin anew after a failure: what PETSc was in the middle of cannot be gone on with."""
        self.snes = self.matrix = self.true = None

    def warn_of_unread_options(self) -> None:
        """See `Options`; once a problem has been solved."""
        self._options.warn_of_unread(self._comm)

    def why(self, error: PETSc.Error) -> str:
        """Why it failed, if that is no fault of the program; else raises what it is."""
        self.forget()
        cause = error.__cause__
        if cause is not None and not isinstance(cause, PETSc.Error):
            raise cause from None
        if error.ierr not in _FACTORISATION:
            raise error
        return "the linear solver failed: the tangent is singular"

    def enlarge(self) -> bool:
        """Give MUMPS more workspace if it ended for want of it; returns whether. Collective."""
        assert self.matrix is not None
        return self._mumps.enlarge(self._ksp, self.matrix.petsc)
