"""An uncaught exception ends all ranks, and its message is printed once.

Checks of dolfinmpm raise on all ranks together. An error in a script or in another package may be
on some ranks only. The other ranks would wait in their next collective call for ever, and the
launcher too. `python3 -m mpi4py` does not help: it aborts at the end of the interpreter, and the
collective shutdown of PETSc comes before.

The first collective call of dolfinmpm sets the hook; the import does not.
"""

from __future__ import annotations

import sys
import time
import traceback
from pathlib import Path
from types import TracebackType

from mpi4py import MPI

from dolfinmpm._platform.errors import DolfinMPMError, common_text

__all__ = ["end_all_ranks"]

GRACE = 2.0  # seconds in which all ranks may raise an error
_TAG = 32_001
_PACKAGE = Path(__file__).parents[1]


def end_all_ranks(comm: MPI.Comm) -> None:
    """Let uncaught exceptions end all ranks; nothing to do on one rank.

    If all ranks fail, rank 0 prints each text once, and every rank ends with exit code 1. The text
    for an error of dolfinmpm is its message with the line of the script; for another error it is
    the traceback. If some ranks fail, each of them prints its traceback and its number, and the
    run is aborted with exit code 1.

    Args:
        comm: Communicator of the ranks.
    """
    if comm.size == 1:
        return

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        sys.stdout.flush()
        own = "".join(traceback.format_exception(kind, error, trace))
        text = _sentence(error, trace) if isinstance(error, DolfinMPMError) else own
        texts = _texts_of_all(comm, text)
        if texts is None:
            print(f"rank {comm.rank} of {comm.size}:\n{own}", end="", file=sys.stderr, flush=True)
            comm.Abort(1)
        elif comm.rank == 0:
            print(_report(texts), end="", file=sys.stderr, flush=True)

    sys.excepthook = hook


def _sentence(error: DolfinMPMError, trace: TracebackType | None) -> str:
    """The message, and the last line outside dolfinmpm."""
    message = common_text(error) or f"{type(error).__name__}: {error}"
    where = ""
    for frame in traceback.extract_tb(trace):
        if Path(frame.filename).is_relative_to(_PACKAGE):
            break
        where = f'  in "{frame.filename}", line {frame.lineno}: {frame.line}\n'
    return f"dolfinmpm.errors.{message}\n{where}"


def _report(texts: list[str]) -> str:
    """Each text once, with the numbers of its ranks if the texts differ."""
    if len(set(texts)) == 1:
        return texts[0]
    ranks: dict[str, list[str]] = {}
    for rank, text in enumerate(texts):
        ranks.setdefault(text, []).append(str(rank))
    return "".join(f"rank {', '.join(own)}:\n{text}" for text, own in ranks.items())


def _texts_of_all(comm: MPI.Comm, text: str) -> list[str] | None:
    """Texts of all ranks, or None if a rank does not fail in time.

    Ranks send messages, because a rank without an error may be in any collective call.
    """
    others = [rank for rank in range(comm.size) if rank != comm.rank]
    sent = [comm.isend(text, rank, _TAG) for rank in others]
    texts = {comm.rank: text}
    end = time.monotonic() + GRACE
    while len(texts) < comm.size and time.monotonic() < end:
        status = MPI.Status()
        if comm.iprobe(tag=_TAG, status=status):
            source = status.Get_source()
            texts[source] = comm.recv(source=source, tag=_TAG)
        else:
            time.sleep(0.01)
    if len(texts) < comm.size:
        return None
    MPI.Request.Waitall(sent)
    return [texts[rank] for rank in range(comm.size)]
