"""PETSc's solvers for a method, and the accuracy of their iterations."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.assembly.stencilsums import add_product
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.solve.method import LATTICE, SUBSTRUCTURES, Method
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.substructures import Substructures

__all__ = [
    "DIGITS",
    "MOST",
    "MOST_OF_FACTORS",
    "WithoutSoftStiffness",
    "create",
    "keeps",
    "relative_tolerance",
]

# Relative residual at the end of iterations: of a solution without later correction, and the
# largest one in an iteration of Newton's method
DIGITS, _FIRST = 1e-10, 1e-3
# Incomplete factors: with 1e-3, Newton's method may not converge where points start and stop to
# yield. More iterations than the second number are a failure.
_FIRST_OF_INCOMPLETE, _MOST_OF_INCOMPLETE = 1e-5, 200
# Factors of a former tangent: digits are cheap, and iterations of Newton's method are expensive.
# New factors cost less than more iterations than the second number.
_FIRST_OF_FACTORS, MOST_OF_FACTORS = 1e-6, 30
# More iterations with multigrid are a failure
MOST = 500


def keeps(method: Method, options: Options) -> bool:
    """Whether a preconditioner may be kept for a later tangent."""
    return method.keeps and options.get("ksp_type") != "preonly"


def create(comm: MPI.Intracomm, method: Method, options: Options, softened: bool) -> PETSc.SNES:
    """PETSc's solver for a method, changed by the options of the problem. Collective.

    Args:
        comm: Communicator of the problem.
        method: The method.
        options: PETSc options of the problem.
        softened: Whether the matrix has soft stiffness.
    """
    options.suggest(_suggestions(method, options))
    snes = PETSc.SNES().create(comm)
    snes.setOptionsPrefix(options.prefix)
    snes.setType("newtonls")
    ksp = snes.getKSP()
    ksp.setType(method.ksp)
    if keeps(method, options):
        ksp.setTolerances(rtol=DIGITS, max_it=_MOST_OF_INCOMPLETE if method.incomplete else MOST)
        # Newton's method needs the norm of the true residual
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        if method.ksp == "gmres":
            ksp.setPCSide(PETSc.PC.Side.RIGHT)
            ksp.setGMRESRestart(100)
    elif softened:
        ksp.setTolerances(rtol=1e-11, max_it=60)
        ksp.setGMRESRestart(60)
    pc = ksp.getPC()
    if method.package == SUBSTRUCTURES:
        pc.setType("python")
        pc.setPythonContext(Substructures())
    else:
        pc.setType(method.pc)
        if method.package:
            pc.setFactorSolverType(method.package)
    snes.setFromOptions()
    return snes


def _suggestions(method: Method, options: Options) -> dict[str, object]:
    """Options of a method, besides the user's options."""
    pc, package = options.get("pc_type"), options.get("pc_factor_mat_solver_type")
    own = {**(LATTICE if pc == "mg" else method.options)}
    if method.package == "cholmod":
        # an indefinite tangent needs no message on the terminal
        own["mat_cholmod_print"] = 0
    if keeps(method, options):
        # `PreconditionerReuse` decides when SNES makes a new preconditioner
        own["snes_lag_preconditioner"] = -2
    if method.ksp == "gmres":
        # classical Gram–Schmidt loses orthogonality where vectors are nearly parallel, and
        # iterations then end without a solution
        own["ksp_gmres_cgs_refinement_type"] = "refine_ifneeded"
    if pc in ("lu", "cholesky") and package is None:
        own["pc_factor_mat_solver_type"] = "mumps"
    if pc is None and package not in (None, "cholmod"):
        # not every package has a Cholesky factorisation
        own["pc_type"] = "lu"
    if method.factors and method.ksp != "preonly":
        # Newton's method corrects the remaining error
        own["ksp_converged_maxits"] = True
    return own


def relative_tolerance(method: Method, norm: float, former: float | None, enough: float) -> float:
    """Relative residual at which the iterations of a linear solution may end.

    More digits would not help Newton's method. This is the second choice of Eisenstat & Walker
    (1996, doi 10.1137/0917003). The first value is smaller, because small increments are nearly
    linear. If the next residual is small enough for the end, by the quadratic convergence so far,
    a solution with all digits saves one more iteration of Newton's method.

    Args:
        method: The method.
        norm: Norm of the residual (N).
        former: Norm of the residual one Newton iteration before (N), or None.
        enough: Norm of the residual at which Newton's method may end (N).
    """
    if former is not None and norm**3 <= enough * former**2:
        return DIGITS
    found = _FIRST_OF_FACTORS if method.factors else _FIRST
    if method.incomplete:
        found = _FIRST_OF_INCOMPLETE
    if former is not None and former > 0.0:
        found = min(found, 0.9 * (norm / former) ** (0.5 * (1 + math.sqrt(5.0))))
    return max(found, DIGITS)


class WithoutSoftStiffness:
    """Product of the tangent without soft stiffness, for PETSc. Collective.

    The matrix with soft stiffness then only preconditions. Newton's method with soft stiffness in
    its linear systems would hardly reduce the forces on functions with little support by points.

    Args:
        unknowns: Numbering of the unknowns.
        blocks: The soft stiffness.
    """

    def __init__(self, unknowns: Unknowns, blocks: Sequence[Blocks]):
        self._unknowns, self._blocks = unknowns, blocks
        self._u, self._force = unknowns.nodal(), unknowns.nodal()
        self._still = [u.copy() for u in self._u.arrays]

    def operator(self, stiffened: PETSc.Mat) -> PETSc.Mat:
        """The tangent without soft stiffness, as a PETSc matrix. Collective.

        Args:
            stiffened: The tangent with soft stiffness.
        """
        self._matrix = stiffened
        shell = PETSc.Mat().createPython(stiffened.getSizes(), self, comm=stiffened.comm)
        shell.setUp()
        return shell

    def mult(self, matrix, x, y) -> None:
        """Set y to the product with x; called by PETSc. Collective."""
        self._matrix.mult(x, y)
        self._unknowns.clear(self._force)
        self._unknowns.expand(x.getArray(readonly=True), self._still, self._u)
        for blocks in self._blocks:
            add_product(blocks, self._u.arrays, self._force.arrays)
        self._force.add_up()
        y.getArray()[:] -= self._unknowns.restrict(self._force.arrays)
