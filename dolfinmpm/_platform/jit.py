"""Compilation through FFCx that waits for others, and gets over what an interrupted run left.

FFCx marks what it compiles by an empty file of the final name, and lets everybody
else wait for ten seconds. A run that was stopped in the middle leaves the mark
behind, and without help every later run with the same form would fail.
"""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from mpi4py import MPI

__all__ = ["patiently"]

Result = TypeVar("Result")

ABANDONED = 60.0  # seconds after which nobody is taken to be compiling any more
LONGEST = 900.0  # seconds to wait for others in all
_MARK = re.compile(r"JIT compilation timed out.*remove (\S+\.c)\b", re.DOTALL)


def patiently(comm: MPI.Comm, build: Callable[[], Result]) -> Result:
    """Compile; wait for others who compile the same; remove abandoned marks. Collective.

    Args:
        comm: Communicator of the grid.
        build: Calls FFCx through DOLFINx, which compiles on rank 0 and raises on
            all ranks.

    Raises:
        Exception: What `build` raises for other reasons, or if others are still
            compiling after 15 minutes.
    """
    end = time.monotonic() + LONGEST
    while True:
        try:
            return build()
        except (TimeoutError, RuntimeError) as error:
            again = None
            if comm.rank == 0:
                mark = _MARK.search(str(error))
                again = mark is not None and time.monotonic() < end
                if mark:
                    _remove_if_abandoned(Path(mark[1]))
            if not comm.bcast(again):
                raise


def _remove_if_abandoned(mark: Path) -> None:
    # gone already, or another process's: then that is whom to wait for
    with contextlib.suppress(OSError):
        if time.time() - mark.stat().st_mtime > ABANDONED:
            mark.unlink()
