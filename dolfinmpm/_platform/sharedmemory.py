"""What each process of a run does, in memory that the others of its node see.

A rank that waits must know of others without their help, for they may have ended. So each process
writes into a slot of its own, a file of some bytes that lies in memory: to write takes less than a
microsecond and no message, and from the start the others find it by the name of the run.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["Memory", "Slot", "answer", "ask", "find", "own_memory", "read", "remove_all"]

# A slot, as `Slot` tells it; `asked` tells that somebody wants to know where the process is
_TEXT = 448
_SLOT = np.dtype(
    [
        ("group", np.int64), ("doors", np.int64), ("at_door", bool), ("inside", bool),
        ("since", np.int64), ("failed", bool), ("ended", bool), ("asked", bool),
        ("text", f"S{_TEXT}"),
    ],
    align=True,
)  # fmt: skip
Memory = np.void
# Names by which launchers tell one run from another
_RUNS = "PMIX_NAMESPACE", "OMPI_MCA_ess_base_jobid", "PMI_JOBID", "SLURM_STEP_ID"


@dataclass(frozen=True)
class Slot:
    """What a process does.

    Attributes:
        rank: Its rank of all.
        group: Which ranks it met last, or waits for, as a number.
        doors: To how many collective calls of theirs it has come.
        at_door: Whether it waits for them to come to the last one.
        inside: Whether it is in a call, of these ranks or of others.
        since: When it last came to a call, entered or left one (ns of the monotonic clock).
        failed: Whether the last call that it left ended in an error.
        ended: Whether its script has come to its end.
        text: Where it is, if it was asked and has answered.
    """

    rank: int
    group: int = 0
    doors: int = 0
    at_door: bool = False
    inside: bool = False
    since: int = 0
    failed: bool = False
    ended: bool = False
    text: str = ""


def read(memory: Memory, rank: int) -> Slot:
    """What a slot says of the process of a rank."""
    values = dict(zip(_SLOT.names or (), memory.item()))
    del values["asked"]
    values["text"] = values["text"].decode(errors="ignore")
    return Slot(rank, **values)


def ask(memory: Memory) -> None:
    """Ask a process where it is; if its watch is not held up it answers."""
    memory["text"], memory["asked"] = b"", True


def answer(memory: Memory, text: str) -> None:
    """Tell where this process is."""
    memory["text"], memory["asked"] = text.encode()[:_TEXT], False


def _folder() -> Path:
    """A folder in memory, or the one for temporary files."""
    folder = Path("/dev/shm")
    return folder if os.access(folder, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())


def _run() -> str:
    """The name of files of this user's run; without a launcher's name that of who started all."""
    names = [os.environ[name] for name in _RUNS if name in os.environ] or [str(os.getppid())]
    return f"dolfinmpm-{os.getuid()}-{zlib.crc32(' '.join(names).encode()):08x}"


def own_memory(rank: int) -> tuple[Memory, str]:
    """The slot of this process, and its file; without one where none can be written.

    Args:
        rank: Its rank of all.
    """
    folder, run = _folder(), _run()
    _remove_abandoned(folder)
    path = folder / f"{run}-{rank}-{os.getpid()}"
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError:
        return np.zeros(1, _SLOT)[0], ""
    with os.fdopen(handle, "r+b") as file:
        return np.memmap(file, _SLOT, "r+", shape=(1,))[0], str(path)


def find(rank: int, path: str = "") -> Memory | None:
    """The slot of another process of this run and node, or None.

    Args:
        rank: Its rank of all.
        path: Its file, if that is known.
    """
    files = [Path(path)] if path else list(_folder().glob(f"{_run()}-{rank}-*"))
    return next((memory for memory in map(_opened, files) if memory is not None), None)


def _opened(file: Path) -> Memory | None:
    with contextlib.suppress(OSError, ValueError), file.open("r+b") as opened:
        if os.fstat(opened.fileno()).st_uid == os.getuid():
            return np.memmap(opened, _SLOT, "r+", shape=(1,))[0]
    return None


def remove_all(even: bool = False) -> None:
    """Remove the files of this run and node.

    Args:
        even: Whether even those of processes that have not ended; else the last one removes them.
    """
    files = list(_folder().glob(f"{_run()}-*"))
    if even or all(m is None or m["ended"] for m in map(_opened, files)):
        for file in files:
            file.unlink(missing_ok=True)


def _remove_abandoned(folder: Path) -> None:
    """Remove the files of processes that were killed."""
    for file in folder.glob(f"dolfinmpm-{os.getuid()}-*"):
        try:
            os.kill(int(file.name.rpartition("-")[2]), 0)
        except ProcessLookupError:
            file.unlink(missing_ok=True)
        except (OSError, ValueError):
            continue
