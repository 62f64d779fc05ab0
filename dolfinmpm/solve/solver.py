"""The PETSc solver of a step: SNES with an LU factorisation by MUMPS, unless options say else."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["create_snes", "set_mumps"]

# MUMPS's own settings: what it chooses by default is not the best for these matrices
ORDERING, WORKSPACE = 7, 14


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


def set_mumps(snes: PETSc.SNES, matrix: PETSc.Mat, gdim: int) -> None:
    """Settings of MUMPS for a matrix, where it is the solver and no option sets them. Collective.

    Args:
        snes: Solver.
        matrix: What will be factorised; at least one unknown.
        gdim: Dimension of space.
    """
    ksp = snes.getKSP()
    pc = ksp.getPC()
    if pc.getType() != "lu" or pc.getFactorSolverType() != "mumps":
        return
    # a plastic tangent near a limit load needs pivots off the diagonal, and room for what
    # they fill in: with MUMPS's 20 % the factorisation of a regular matrix may end for want of it
    wanted = {WORKSPACE: 100}
    if gdim < 3:
        # minimum fill: a tenth less time and memory than with the ordering that MUMPS chooses
        wanted[ORDERING] = 2
    database, prefix = PETSc.Options(), snes.getOptionsPrefix() or ""
    wanted = {
        number: value
        for number, value in wanted.items()
        if not database.hasName(f"{prefix}mat_mumps_icntl_{number}")
    }
    if wanted:
        ksp.setOperators(matrix)
        pc.setFactorSetUpSolverType()
        for number, value in wanted.items():
            pc.getFactorMatrix().setMumpsIcntl(number, value)
