"""Shared memory in which each process of a run shows its state to the processes of its node.

A waiting rank must know the state of other ranks without their help, because they may have ended.
Each process therefore writes its state into a slot. A slot is a file of some bytes in memory.
Writing takes less than a microsecond and no message. Processes find the files by the run's name.
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

# Layout of a slot, see `Slot`. `asked` means that another process asks for the script's line.
_TEXT = 448
_SLOT = np.dtype(
    [
        ("group", np.int64), ("calls", np.int64), ("waiting", bool), ("inside", bool),
        ("since", np.int64), ("failed", bool), ("ended", bool), ("asked", bool),
        ("text", f"S{_TEXT}"),
    ],
    align=True,
)  # fmt: skip
Memory = np.void
# Environment variables in which launchers name a run
_RUNS = "PMIX_NAMESPACE", "OMPI_MCA_ess_base_jobid", "PMI_JOBID", "SLURM_STEP_ID"


@dataclass(frozen=True)
class Slot:
    """State of a process.

    Attributes:
        rank: Number of the process in MPI's world.
        group: Number of the group of ranks of its last barrier.
        calls: Number of barriers of this group that the process has come to.
        waiting: Whether it waits at the last barrier.
        inside: Whether it is in a collective call of any group.
        since: Time at which it last came to a call, entered or left one (ns, monotonic clock).
        failed: Whether its last finished call ended in an error.
        ended: Whether its script has ended.
        text: Line of its script, if another process has asked for the line.
    """

    rank: int
    group: int = 0
    calls: int = 0
    waiting: bool = False
    inside: bool = False
    since: int = 0
    failed: bool = False
    ended: bool = False
    text: str = ""


def read(memory: Memory, rank: int) -> Slot:
    """State of the process of a rank."""
    values = dict(zip(_SLOT.names or (), memory.item()))
    del values["asked"]
    values["text"] = values["text"].decode(errors="ignore")
    return Slot(rank, **values)


def ask(memory: Memory) -> None:
    """Ask a process for the line of its script. Its watchdog thread answers, unless it is busy."""
    memory["text"], memory["asked"] = b"", True


def answer(memory: Memory, text: str) -> None:
    """Answer with the line of this process's script."""
    memory["text"], memory["asked"] = text.encode()[:_TEXT], False


def _folder() -> Path:
    """A folder in memory, or the folder for temporary files."""
    folder = Path("/dev/shm")
    return folder if os.access(folder, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())


def _run() -> str:
    """Beginning of file names of this user's run, from the launcher or the parent process."""
    names = [os.environ[name] for name in _RUNS if name in os.environ] or [str(os.getppid())]
    return f"dolfinmpm-{os.getuid()}-{zlib.crc32(' '.join(names).encode()):08x}"


def own_memory(rank: int) -> tuple[Memory, str]:
    """Slot of this process, and its file; "" if no file can be written.

    Args:
        rank: Number of the process in MPI's world.
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
    """Slot of another process of this run and node, or None.

    Args:
        rank: Number of the process in MPI's world.
        path: File of the slot, if it is known.
    """
    files = [Path(path)] if path else list(_folder().glob(f"{_run()}-{rank}-*"))
    return next((memory for memory in map(_opened, files) if memory is not None), None)


def _opened(file: Path) -> Memory | None:
    with contextlib.suppress(OSError, ValueError), file.open("r+b") as opened:
        if os.fstat(opened.fileno()).st_uid == os.getuid():
            return np.memmap(opened, _SLOT, "r+", shape=(1,))[0]
    return None


def remove_all(running: bool = False) -> None:
    """Remove the files of this run and node, if all processes have ended.

    Args:
        running: Whether to remove them also while processes run.
    """
    files = list(_folder().glob(f"{_run()}-*"))
    if running or all(m is None or m["ended"] for m in map(_opened, files)):
        for file in files:
            file.unlink(missing_ok=True)


def _remove_abandoned(folder: Path) -> None:
    """Remove the files of killed processes."""
    for file in folder.glob(f"dolfinmpm-{os.getuid()}-*"):
        try:
            os.kill(int(file.name.rpartition("-")[2]), 0)
        except ProcessLookupError:
            file.unlink(missing_ok=True)
        except (OSError, ValueError):
            continue
