"""Compilation through FFCx: once per process, with waiting for others, and without abandoned marks.

FFCx marks a compilation by an empty file with the final name. Other processes wait for ten seconds.
A stopped run leaves its mark, and every later run with the same form would fail. While a process
compiles, it therefore also holds a locked file in the same folder. The system releases the lock
when the process ends. A mark that is older than all held locks is abandoned.

For each compiled function, FFCx lists the folder, which takes 5 ms with 10 000 files. A function is
therefore loaded once, and kept for later problems with the same forms.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from dolfinx import jit
from mpi4py import MPI

__all__ = ["compiled_once", "patiently"]

Result = TypeVar("Result")

ABANDONED = 60.0  # seconds after which a mark without a lock is abandoned
LONGEST = 9000.0  # seconds of waiting for other processes in total
_MARK = re.compile(r"JIT compilation timed out.*remove (\S+\.c)\b", re.DOTALL)
_READY = re.compile(r"File exists: '([^']+\.c)\.cached'")
_LOCKS = "dolfinmpm-*.lock"
# signature → what was compiled
_compiled: dict[str, Any] = {}


def compiled_once(comm: MPI.Comm, signature: str, build: Callable[[], Result]) -> Result:
    """What was compiled before under the same signature on all ranks; else compile. Collective.

    Args:
        comm: Communicator of the grid.
        signature: What tells one function from another.
        build, and errors: See `patiently`.
    """
    known = signature in _compiled
    # a function that one rank compiled alone is compiled once more by all ranks
    if comm.size > 1:
        known = comm.allreduce(known, op=MPI.LAND)
    if not known:
        _compiled[signature] = patiently(comm, build)
    return _compiled[signature]


def patiently(comm: MPI.Comm, build: Callable[[], Result]) -> Result:
    """Compile; wait for processes that compile the same form; remove abandoned marks. Collective.

    Args:
        comm: Communicator of the grid.
        build: Function that calls FFCx through DOLFINx, which compiles on rank 0 and raises on all
            ranks.

    Raises:
        Exception: `build` raises for another reason, or other processes still compile after 2.5
            hours.
    """
    end = time.monotonic() + LONGEST
    while True:
        try:
            # the lock is for this try only: a process that waits for a mark did not make the mark
            with _compiling() if comm.rank == 0 else contextlib.nullcontext():
                return build()
        except (OSError, RuntimeError) as error:
            again = None
            if comm.rank == 0:
                again = time.monotonic() < end and _clear(str(error))
            if not comm.bcast(again):
                raise


@contextlib.contextmanager
def _compiling() -> Iterator[None]:
    """Hold a locked file that shows since when this process may be compiling."""
    folder = Path(jit.get_options()["cache_dir"])
    name = _LOCKS.replace("*", f"{socket.gethostname()}-{os.getpid()}")
    with contextlib.ExitStack() as stack:
        # some network file systems have no locks: then only the age of a mark decides
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            lock = stack.enter_context((folder / name).open("w"))
            stack.callback((folder / name).unlink, missing_ok=True)
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield


def _clear(message: str) -> bool:
    """Whether to try again after an error; removes abandoned marks."""
    if mark := _MARK.search(message):
        _remove_if_abandoned(Path(mark[1]))
    elif ready := _READY.search(message):
        # two processes have compiled the same form, and FFCx removes the second source
        if not Path(ready[1]).exists():
            Path(f"{ready[1]}.cached").unlink(missing_ok=True)
    else:
        return False
    return True


def _remove_if_abandoned(mark: Path) -> None:
    # the mark may be removed already, or belong to a running process
    with contextlib.suppress(OSError):
        begun = mark.stat().st_mtime
        if time.time() - begun > ABANDONED and not _compiles_since(mark.parent, begun):
            mark.unlink()


def _compiles_since(folder: Path, begun: float) -> bool:
    """Whether a process with a lock may have made a mark at this time."""
    for path in folder.glob(_LOCKS):
        with contextlib.suppress(OSError), path.open() as lock:
            since = os.fstat(lock.fileno()).st_mtime
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                if since <= begun:
                    return True
            else:
                path.unlink()
    return False
