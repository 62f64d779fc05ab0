"""An exception that nobody catches ends all ranks, not only the one that raised it.

Without this the other ranks wait in their next collective call for ever, and so
does the launcher: PETSc's own shutdown is collective. Checks of dolfinmpm raise
on all ranks together and end in the ordinary way; what remains is an error in a
script or in another package on some of the ranks.
"""

from __future__ import annotations

import sys
from types import TracebackType

from mpi4py import MPI

from dolfinmpm.errors import is_together

__all__ = ["end_all_ranks"]


def end_all_ranks(comm: MPI.Comm) -> None:
    """Let exceptions that reach the interpreter end all ranks; nothing to do on one rank.

    The hook that was there before still prints the exception first. Errors that
    all ranks raise together (:func:`dolfinmpm.errors.raise_together`) are left
    to end each rank by itself.

    Args:
        comm: Communicator whose ranks are ended.
    """
    if comm.size == 1:
        return
    before = sys.excepthook

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        before(kind, error, trace)
        if is_together(error):
            return
        sys.stdout.flush()
        sys.stderr.flush()
        comm.Abort(1)

    sys.excepthook = hook
