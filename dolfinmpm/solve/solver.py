"""The PETSc solver of a step: SNES with an LU factorisation by MUMPS, unless options say else."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["Mumps", "create_snes"]

# MUMPS's numbers for settings, and for ends for want of integer, real and send workspace
ORDERING, WORKSPACE = 7, 14
SHORT_OF_WORKSPACE = (-8, -9, -17)


def create_snes(comm: MPI.Intracomm, prefix: str, softened: bool) -> PETSc.SNES:
    """Newton's method with a direct solver, before options are read. Collective.

    Args:
        comm: Communicator of the matrices.
        prefix: Prefix of the PETSc options.
        softened: Whether the factors are those of a softened matrix, which
            precondition GMRES for the true one.
    """
    database = PETSc.Options()
    if softened and not database.hasName(prefix + "ksp_converged_maxits"):
        # Newton's method corrects what is left
        database[prefix + "ksp_converged_maxits"] = True
    snes = PETSc.SNES().create(comm)
    snes.setOptionsPrefix(prefix)
    snes.setType("newtonls")
    ksp = snes.getKSP()
    ksp.setType("preonly")
    if softened:
        ksp.setType("gmres")
        ksp.setTolerances(rtol=1e-11, max_it=60)
        ksp.setGMRESRestart(60)
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    return snes


class Mumps:
    """Settings of MUMPS for the matrices of a run, where it is the solver and no option sets them.

    Args:
        snes: Solver.
        gdim: Dimension of space.
    """

    def __init__(self, snes: PETSc.SNES, gdim: int):
        self._snes = snes
        pc = snes.getKSP().getPC()
        self._used = pc.getType() == "lu" and pc.getFactorSolverType() == "mumps"
        # minimum fill: a tenth less time and memory than with the ordering that MUMPS chooses
        self._settings = {ORDERING: 2} if gdim < 3 else {}

    def attach(self, matrix: PETSc.Mat) -> None:
        """Create the factors of a matrix of at least one unknown. Collective."""
        ksp = self._snes.getKSP()
        settings = {k: v for k, v in self._settings.items() if not self._given(k)}
        if self._used and settings:
            ksp.setOperators(matrix)
            ksp.getPC().setFactorSetUpSolverType()
            for number, value in settings.items():
                ksp.getPC().getFactorMatrix().setMumpsIcntl(number, value)

    def enlarge(self, matrix: PETSc.Mat) -> bool:
        """Double the workspace if the last factorisation ended for want of it. Collective.

        Returns whether it did, with new factors for the matrix, because those that
        failed fail again. A plastic tangent near a limit load needs pivots off the
        diagonal, and more room for what they fill in than the 20 % beyond its forecast
        that MUMPS takes.
        """
        if not self._used or self._given(WORKSPACE):
            return False
        factors = self._snes.getKSP().getPC().getFactorMatrix()
        if factors.getMumpsInfog(1) not in SHORT_OF_WORKSPACE:
            return False
        share = 2 * self._settings.get(WORKSPACE, 50)
        if share > 1000:
            return False
        self._settings[WORKSPACE] = share
        self._snes.getKSP().getPC().reset()
        self.attach(matrix)
        return True

    def _given(self, number: int) -> bool:
        prefix = self._snes.getOptionsPrefix() or ""
        return PETSc.Options().hasName(f"{prefix}mat_mumps_icntl_{number}")
