"""Compiled loops are compiled again after the sources have changed.

Numba compiles a loop again if the file of the loop has changed. It does not if a called function in
another file has changed: after an update of the package it would use the old function.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from pathlib import Path

__all__ = ["forget_outdated"]

STAMP = f"kernels-{sys.implementation.cache_tag}.sha256"
# Numba's indices for this version of Python
INDICES = f"__pycache__/*.py{sys.version_info.major}{sys.version_info.minor}*.nbi"


def forget_outdated(package: Path, also: str = "") -> bool:
    """Remove Numba's indices in a package if a source with a loop has changed.

    Several processes may do it at the same time. If the folder is read-only, as in a system's
    installation, nothing is removed.

    Args:
        package: Folder of the package.
        also: Further text that the compiled loops depend on.

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
