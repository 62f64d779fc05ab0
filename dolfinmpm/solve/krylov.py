"""PETSc's solver for a method, and how far its iterations go."""

from __future__ import annotations

import math

from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.solve.method import SUBSTRUCTURES, Method
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.substructures import Substructures

__all__ = ["DIGITS", "MOST_OF_FACTORS", "create", "keeps", "share"]

# Share to which iterations reduce the residual: of a solution that nothing corrects, and at most
# in an iteration of Newton's method
DIGITS, _FIRST = 1e-10, 1e-3
# With incomplete factors, too, a step that is less exact costs more than digits: where points begin
# and cease to yield Newton's method may not come to its end with 1e-3. More iterations fail.
_FIRST_OF_INCOMPLETE, _MOST_OF_INCOMPLETE = 1e-5, 200
# With factors of a former tangent digits are cheap, and iterations of Newton's method dear; more
# than so many iterations are not worth the wait for new ones
_FIRST_OF_FACTORS, MOST_OF_FACTORS = 1e-6, 30


def keeps(method: Method, options: Options) -> bool:
    """Whether a preconditioner may serve a later tangent."""
    return method.keeps and options.get("ksp_type") != "preonly"


def create(comm: MPI.Intracomm, method: Method, options: Options, softened: bool) -> PETSc.SNES:
    """PETSc's solver for a method, as options leave it. Collective.

    Args:
        comm: Communicator of the problem.
        method: The method.
        options: PETSc options of the problem.
        softened: Whether the matrix has terms more than the tangent.
    """
    options.suggest(_suggestions(method, options))
    snes = PETSc.SNES().create(comm)
    snes.setOptionsPrefix(options.prefix)
    snes.setType("newtonls")
    ksp = snes.getKSP()
    ksp.setType(method.ksp)
    if keeps(method, options):
        ksp.setTolerances(rtol=DIGITS, max_it=_MOST_OF_INCOMPLETE if method.incomplete else 500)
        # the residual itself, as Newton's method measures it
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
    """Options of a method beside those that a user has set."""
    own = {**method.options}
    if method.package == "cholmod":
        # that a tangent is not definite is no news for the terminal
        own["mat_cholmod_print"] = 0
    if keeps(method, options):
        # only the first SNES makes a preconditioner by itself, see `Reuse`
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
    return own


def share(method: Method, norm: float, former: float | None) -> float:
    """Share to which a solution is to reduce the residual.

    Iterations end where Newton's method can use no more digits: the second choice of
    Eisenstat & Walker (1996, doi 10.1137/0917003), with a smaller first share, since small
    increments are nearly linear.

    Args:
        method: The method.
        norm: Norm of the residual (N).
        former: Norm of the residual of the iteration before (N), or None.
    """
    found = _FIRST_OF_FACTORS if method.factors else _FIRST
    if method.incomplete:
        found = _FIRST_OF_INCOMPLETE
    if former is not None and former > 0.0:
        found = min(found, 0.9 * (norm / former) ** (0.5 * (1 + math.sqrt(5.0))))
    return max(found, DIGITS)
