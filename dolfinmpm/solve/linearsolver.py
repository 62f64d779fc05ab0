"""The linear systems of Newton's method: factors or multigrid, by what the tangent is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.cut.participants import Activation
from dolfinmpm.grid.lattice import smallest_height
from dolfinmpm.solve.method import SUBSTRUCTURES, Method, Tangent, as_used, choose, crossover
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.reuse import Reuse
from dolfinmpm.solve.schur import schur_matrix
from dolfinmpm.solve.solverchoice import SolverChoice
from dolfinmpm.solve.spectra import near_kernel, near_kernel_within
from dolfinmpm.solve.substructures import Substructures, why_not

__all__ = ["WORKSPACE", "LinearSolver"]

Array = npt.NDArray[np.float64]

# PETSc's numbers for an error in an external library and for zero pivots of LU and Cholesky
_FACTORISATION = (76, 71, 81)
# MUMPS's numbers for settings, and for ends for want of integer, real and send workspace
_ORDERING, WORKSPACE = 7, 14
_SHORT_OF_WORKSPACE = (-8, -9, -17)
# Options by which a user chooses a method
_OF_METHOD = ("ksp_type", "pc_type", "pc_factor_mat_solver_type")
# Share of a product's size that a symmetric matrix may be off by rounding
_SYMMETRIC = 1e-9
# Size of increments at which it is looked at, in cells
_NEAR = 1e-4
# Share to which iterations reduce the residual: of a solution that nothing corrects, and at most
# in an iteration of Newton's method
_DIGITS, _FIRST = 1e-10, 1e-3
# With incomplete factors, too, a step that is less exact costs more than digits: where points begin
# and cease to yield Newton's method may not come to its end with 1e-3. More iterations fail.
_FIRST_OF_INCOMPLETE, _MOST_OF_INCOMPLETE = 1e-5, 200
# With factors of a former tangent digits are cheap, and iterations of Newton's method dear; more
# than so many iterations are not worth the wait for new ones
_FIRST_OF_FACTORS, _MOST_OF_FACTORS = 1e-6, 30


@dataclass
class Doubt:
    """For how long a tangent that was not positive definite is not taken to be.

    Attributes:
        left: Attachments of a matrix that are left of it.
        next: How many there will be the next time.
    """

    left: int = 0
    next: int = 4

    def grow(self) -> None:
        """Begin to doubt, for longer each time."""
        self.left, self.next = self.next, min(2 * self.next, 64)


@dataclass
class Excluded:
    """Which methods are not tried, or not any more.

    Attributes:
        iterations: Whether only factors are left, because iterations have failed.
        parts: Why several ranks do not factorise a substructure each; empty if they may.
        choice: Whether incomplete factors are tried.
    """

    iterations: bool = False
    parts: str = ""
    choice: SolverChoice = field(default_factory=SolverChoice)


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
        mumps: Settings of MUMPS by their numbers.
        method: What solves, or None before the first matrix.
        stuck: Whether the last `solve` found nothing.
        reuse: When a preconditioner is kept for the next tangent; None of factors that never are.
    """

    def __init__(self, comm: MPI.Intracomm, gdim: int, tangent: Tangent, options: Options):
        self._comm, self._gdim, self._options = comm, gdim, options
        self._tangent, self._checked = tangent, False
        self._doubt, self._excluded = Doubt(), Excluded(parts=why_not(comm))
        if options.mentions("mat_mumps_"):
            self._excluded.parts = "MUMPS has been given settings"
        # minimum fill: a tenth less time and memory than with the ordering that MUMPS chooses
        self.mumps = {_ORDERING: 2} if gdim < 3 else {}
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
        return count >= crossover(self._tangent, self._gdim)

    def _create(self) -> None:
        """Make PETSc's solver for the method. Collective."""
        method, options = self.method, self._options
        assert method is not None
        own = {**method.options}
        if method.package == "cholmod":
            # that a tangent is not definite is no news for the terminal
            own["mat_cholmod_print"] = 0
        keeps = method.keeps and options.get("ksp_type") != "preonly"
        if keeps:
            # but for the first SNES is not to make any preconditioner, see `Reuse`
            own["snes_lag_preconditioner"] = -2
        pc, package = options.get("pc_type"), options.get("pc_factor_mat_solver_type")
        if pc in ("lu", "cholesky") and package is None:
            own["pc_factor_mat_solver_type"] = "mumps"
        if pc is None and package not in (None, "cholmod"):
            # not every package has a Cholesky factorisation
            own["pc_type"] = "lu"
        if method.factors and method.ksp != "preonly":
            # Newton's method corrects what is left
            own["ksp_converged_maxits"] = True
        options.suggest(own)
        snes = PETSc.SNES().create(self._comm)
        snes.setOptionsPrefix(options.prefix)
        snes.setType("newtonls")
        ksp = snes.getKSP()
        ksp.setType(method.ksp)
        if keeps:
            most = _MOST_OF_INCOMPLETE if method.incomplete else 500
            ksp.setTolerances(rtol=_DIGITS, max_it=most)
            # the residual itself, as Newton's method measures it
            ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
            if method.ksp == "gmres":
                ksp.setPCSide(PETSc.PC.Side.RIGHT)
                ksp.setGMRESRestart(100)
        elif self._tangent.softened:
            ksp.setTolerances(rtol=1e-11, max_it=60)
            ksp.setGMRESRestart(60)
        ksp.getPC().setType(method.pc)
        if method.package == SUBSTRUCTURES:
            ksp.getPC().setType("python")
            ksp.getPC().setPythonContext(Substructures())
        elif method.package:
            ksp.getPC().setFactorSolverType(method.package)
        snes.setFromOptions()
        self.snes, self.reuse = snes, None
        if keeps:
            self.reuse = Reuse(self._comm)
            self.reuse.watch(ksp)

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
    def _keeps_factors(self) -> bool:
        return self.reuse is not None and self.method is not None and self.method.factors

    @property
    def _incomplete(self) -> bool:
        return self.reuse is not None and self.method is not None and self.method.incomplete

    @property
    def failed(self) -> bool:
        """Whether it failed since the last `attach`."""
        return self.matrix is None

    def attach(self, operator: Operator) -> None:
        """Take the matrix of an operator; that of the same pattern stays. Collective."""
        here = operator.here
        self._former = None
        self._doubt.left = max(self._doubt.left - 1, 0)
        self._choose(here.unknowns.total)
        self._take(here)
        if self._tangent.symmetric and not self._checked:
            self._checked = True
            if not self._looks_symmetric(operator):
                self._tangent = replace(self._tangent, symmetric=False)
                self._choose(here.unknowns.total)
                self._take(here)
        assert self.matrix is not None
        self.true = operator.without_soft(self.matrix)

    def _choose(self, count: int) -> None:
        """Take the method for so many unknowns. Collective."""
        definite = self._tangent.definite and self._doubt.left == 0
        tangent = replace(self._tangent, definite=definite)
        # what a user has chosen has no rival
        free = not any(self._options.has(name) for name in _OF_METHOD)
        self._weigh()
        ranks, excluded = self._comm.size, self._excluded
        whole = excluded.parts
        method = choose(
            tangent, count, self._gdim, ranks, excluded.iterations,
            free and self._excluded.choice.incomplete, not whole,
        )  # fmt: skip
        if ranks > 1 and whole and definite and method.pc == "cholesky":
            method = replace(method, why=f"{method.why}, not in substructures: {whole}")
        changed = self.method is None or not method.like(self.method)
        self.method = method
        if changed or self.snes is None:
            self.snes = self.matrix = self.true = None
            self._create()

    def _weigh(self) -> None:
        """Let what solutions have cost decide on incomplete factors. Collective."""
        if self.reuse is None or self._tangent.symmetric or self._tangent.softened:
            return
        cost, solutions, iterations = self.reuse.taken()
        if solutions:
            self._excluded.choice.weigh(cost / solutions, iterations / solutions)

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
        A.setOption(PETSc.Mat.Option.SYMMETRIC, self._tangent.symmetric)
        if self._tangent.symmetric and self._tangent.definite and self._doubt.left == 0:
            A.setOption(PETSc.Mat.Option.SPD, True)
        if here.unknowns.block > 1:
            A.setNearNullSpace(near_kernel(here, A))
        if self.snes.getKSP().getPC().getType() == "fieldsplit":
            self._split(here, A)
        self._use_mumps()
        if self.reuse is not None:
            self.reuse.renew()
        pc = self.snes.getKSP().getPC()
        made = pc.getPythonContext() if pc.getType() == "python" else None
        if isinstance(made, Substructures) and not made.pays(A):
            self._excluded.parts = "too many unknowns between the ranks"
            self._choose(here.unknowns.total)
            self._take(here)

    def _split(self, here: Activation, A: PETSc.Mat) -> None:
        """Tell PETSc which rows are of which field, and rigid modes of the first. Collective."""
        unknowns = here.unknowns
        first = A.getOwnershipRange()[0]
        parts = []
        for k in range(len(unknowns.fields)):
            rows = np.flatnonzero(unknowns.only(k, np.ones(unknowns.owned))).astype(np.int32)
            parts.append(PETSc.IS().createGeneral(first + rows, comm=self._comm))
        parts[0].compose("nearnullspace", near_kernel_within(here, A, parts[0]))
        self.snes.getKSP().getPC().setFieldSplitIS(("u", parts[0]), ("p", parts[1]))
        # they go with the matrix
        A.compose("rows of u", parts[0])
        A.compose("rows of p", parts[1])

    def _renewed(self) -> None:
        """Make what a new preconditioner is made of, besides the matrix. Collective."""
        pc = self.snes.getKSP().getPC()
        if pc.getType() == "fieldsplit" and not self._options.has(
            "pc_fieldsplit_schur_precondition"
        ):
            assert self.matrix is not None
            A = self.matrix.petsc
            S = schur_matrix(A, A.query("rows of u"), A.query("rows of p"))
            pc.setFieldSplitSchurPreType(PETSc.PC.FieldSplitSchurPreType.USER, S)

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
        tangent = self._tangent
        if tangent.symmetric and tangent.definite and self._doubt.left == 0:
            self._doubt.grow()
        elif method.incomplete:
            self._excluded.choice.failed()
            if self.reuse is not None:
                # what they cost is not what the other method does
                self.reuse.taken()
        elif not method.factors:
            self._excluded.iterations = True
        else:
            return False
        self.forget()
        return True

    def assembled(self, norm: float, enough: float) -> None:
        """Make ready for a tangent that has been assembled. Collective.

        Iterations end where Newton's method can use no more digits: the second choice of
        Eisenstat & Walker (1996, doi 10.1137/0917003), with a smaller first share, since small
        increments are nearly linear.

        Args:
            norm: Norm of the residual to be reduced (N).
            enough: Norm of a residual that need not be reduced any further (N).
        """
        if self.reuse is None:
            return
        assert self.matrix is not None
        ksp = self.snes.getKSP()
        if not self._options.has("ksp_rtol"):
            share = _FIRST_OF_FACTORS if self._keeps_factors else _FIRST
            if self._incomplete:
                share = _FIRST_OF_INCOMPLETE
            if self._former is not None and self._former > 0.0:
                share = min(share, 0.9 * (norm / self._former) ** (0.5 * (1 + math.sqrt(5.0))))
            ksp.setTolerances(rtol=max(share, _DIGITS))
        self._former = norm
        ksp.setTolerances(atol=max(enough, 1e-300))
        if self._keeps_factors:
            ksp.setTolerances(max_it=_MOST_OF_FACTORS)
        if self._incomplete:
            # new ones cost about what iterations with old ones do, which may be many of a sudden
            self.reuse.renew()
        ksp.setOperators(self.true, self.matrix.petsc)
        self.reuse.prepare(ksp, self._renewed)

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
        if self.reuse is not None:
            ksp.setTolerances(rtol=_DIGITS, atol=1e-300)
            if self._keeps_factors or self._incomplete:
                # the next right-hand side is of the same matrix, and asks for all digits
                self.reuse.renew()
            self.reuse.prepare(ksp, self._renewed)
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

        # -- MUMPS ----------------------------------------------------------------

    @property
    def _uses_mumps(self) -> bool:
        pc = self.snes.getKSP().getPC()
        return pc.getType() in ("lu", "cholesky") and pc.getFactorSolverType() == "mumps"

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
