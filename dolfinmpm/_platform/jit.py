"""Compilation through FFCx that waits for others, and gets over what an interrupted run left.

FFCx marks what it compiles by an empty file of the final name, and lets everybody
else wait for ten seconds. A run that was stopped in the middle leaves the mark
behind, and without help every later run with the same form would fail. While it
compiles, a process therefore also holds a locked file in the same folder; the system
lets go of it however the process ends, and a mark that is older than all held locks is
nobody's.
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
from typing import TypeVar

from dolfinx import jit
from mpi4py import MPI

__all__ = ["patiently"]

Result = TypeVar("Result")

ABANDONED = 60.0  # seconds after which nobody without a lock is taken to be compiling any more
LONGEST = 9000.0  # seconds to wait for others in all
_MARK = re.compile(r"JIT compilation timed out.*remove (\S+\.c)\b", re.DOTALL)
_READY = re.compile(r"File exists: '([^']+\.c)\.cached'")
_LOCKS = "dolfinmpm-*.lock"


def patiently(comm: MPI.Comm, build: Callable[[], Result]) -> Result:
    """Compile; wait for others who compile the same; remove abandoned marks. Collective.

    Args:
        comm: Communicator of the grid.
        build: Calls FFCx through DOLFINx, which compiles on rank 0 and raises on
            all ranks.

    Raises:
        Exception: What `build` raises for other reasons, or if others are still
            compiling after 2.5 hours.
    """
    end = time.monotonic() + LONGEST
    while True:
        try:
            # a lock of this try only: who waits for a mark did not make it
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
    """Hold a file that says that this process may be compiling, and since when."""
    folder = Path(jit.get_options()["cache_dir"])
    name = _LOCKS.replace("*", f"{socket.gethostname()}-{os.getpid()}")
    with contextlib.ExitStack() as stack:
        # without locks, as on some network's file systems, age alone decides
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            lock = stack.enter_context((folder / name).open("w"))
            stack.callback((folder / name).unlink, missing_ok=True)
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield


def _clear(message: str) -> bool:
    """Whether to try again after an error; removes what nobody will finish."""
    if mark := _MARK.search(message):
        _remove_if_abandoned(Path(mark[1]))
    elif ready := _READY.search(message):
        # two have compiled the same, and FFCx takes away the second's source
        if not Path(ready[1]).exists():
            Path(f"{ready[1]}.cached").unlink(missing_ok=True)
    else:
        return False
    return True


def _remove_if_abandoned(mark: Path) -> None:
    # gone already, or another process's: then that is whom to wait for
    with contextlib.suppress(OSError):
        begun = mark.stat().st_mtime
        if time.time() - begun > ABANDONED and not _compiles_since(mark.parent, begun):
            mark.unlink()


def _compiles_since(folder: Path, begun: float) -> bool:
    """Whether anybody who holds a lock may have made a mark of that time."""
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
