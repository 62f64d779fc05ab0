"""Compiled loops of earlier versions of the sources are not used again.

Numba compiles a loop again when its own file has changed, but not when a function
of another file that it calls has: after an update of the package it would go on
with the old one without a word.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from pathlib import Path

__all__ = ["forget_outdated"]

STAMP = f"kernels-{sys.implementation.cache_tag}.sha256"
# Numba's indices of this Python; those of another are its own affair
INDICES = f"__pycache__/*.py{sys.version_info.major}{sys.version_info.minor}*.nbi"


def forget_outdated(package: Path, also: str = "") -> bool:
    """Remove Numba's indices in a package if any source with a loop is not what it was.

    Several processes may do so at once: what one of them misses it compiles again.
    Where the folder cannot be written to, as in a system's installation, nothing changes
    but by a new installation.

    Args:
        package: Folder of the package.
        also: What else the loops are compiled for.

    Returns:
        Whether the sources had changed.
    """
    state = hashlib.sha256(also.encode())
    for source in sorted(package.rglob("*.py")):
        content = source.read_bytes()
        if b"numba" in content:
            state.update(source.relative_to(package).as_posix().encode() + b"\0" + content)
    stamp = package / "__pycache__" / STAMP
    with contextlib.suppress(OSError):
        if stamp.read_text() == state.hexdigest():
            return False
    with contextlib.suppress(OSError):
        for index in package.rglob(INDICES):
            index.unlink(missing_ok=True)
        stamp.parent.mkdir(exist_ok=True)
        own = stamp.with_suffix(f".{os.getpid()}")
        own.write_text(state.hexdigest())
        own.replace(stamp)
    return True
