"""An exception that nobody catches ends all ranks, not only the one that raised it.

Without this the other ranks wait in their next collective call for ever, and so
does the launcher: PETSc's own shutdown is collective. Checks of dolfinmpm raise
on all ranks together and end in the ordinary way; what remains is an error in a
script or in another package on some of the ranks.
"""

from __future__ import annotations

import sys
import time
from types import TracebackType

from mpi4py import MPI

__all__ = ["end_all_ranks"]

GRACE = 2.0  # seconds in which all ranks may come to the same error
_TAG = 32_001


def end_all_ranks(comm: MPI.Comm) -> None:
    """Let exceptions that reach the interpreter end all ranks; nothing to do on one rank.

    The hook that was there before prints the exception first. Where all ranks fail
    each of them ends by itself; otherwise the run is aborted with exit code 1.

    Args:
        comm: Communicator whose ranks are ended.
    """
    if comm.size == 1:
        return
    before = sys.excepthook

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        before(kind, error, trace)
        sys.stdout.flush()
        sys.stderr.flush()
        if not _all_failed(comm):
            comm.Abort(1)

    sys.excepthook = hook


def _all_failed(comm: MPI.Comm) -> bool:
    """Whether every other rank comes here too before the time is over.

    Messages, because a rank that has not failed may be in any collective call.
    """
    others = [rank for rank in range(comm.size) if rank != comm.rank]
    nothing = bytearray()
    sent = [comm.Isend([nothing, MPI.BYTE], rank, _TAG) for rank in others]
    end = time.monotonic() + GRACE
    heard = 0
    while heard < len(others) and time.monotonic() < end:
        if comm.Iprobe(tag=_TAG):
            comm.Recv([bytearray(), MPI.BYTE], tag=_TAG)
            heard += 1
        else:
            time.sleep(0.01)
    if heard < len(others):
        return False
    MPI.Request.Waitall(sent)
    return True
