"""What PETSc has to free on several ranks together."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["free"]


def free(comm: MPI.Intracomm) -> None:
    """Free PETSc's objects that Python has let go of. Collective.

    Ranks let go of them at different times, and PETSc frees together: petsc4py keeps what belongs
    to several ranks until it is told that all of them are here. Alone it frees at once.
    """
    if comm.size > 1:
        PETSc.garbage_cleanup(comm)
