"""Garbage: Python's collector of cycles, and PETSc's objects on several ranks."""

from __future__ import annotations

import contextlib
import gc
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpi4py import MPI

__all__ = ["free_petsc", "idle_collector"]


@contextlib.contextmanager
def idle_collector() -> Iterator[None]:
    """Load modules without collections, and leave their objects out of all later ones.

    Modules make several hundred thousand objects that stay to the end. Python would look through
    these objects again and again during the import, and once more at its end: a small problem
    (`demos/column_compaction.py`) would take 1.2 times the processor time. Later objects are
    collected as ever. An interactive session may hold much else: there only the import is without
    collections.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
        if not hasattr(sys, "ps1"):
            gc.freeze()
    finally:
        if enabled:
            gc.enable()


def free_petsc(comm: MPI.Intracomm) -> None:
    """Free PETSc's objects that Python has let go of on several ranks. Collective.

    Ranks let go of them at different times, and PETSc frees together: petsc4py keeps what belongs
    to several ranks until it is told that all of them are here. Alone it frees at once.
    """
    from petsc4py import PETSc

    PETSc.garbage_cleanup(comm)
