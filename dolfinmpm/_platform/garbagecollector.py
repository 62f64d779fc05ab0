"""Python's collector of cycles does nothing while libraries are loaded, nor with them later."""

from __future__ import annotations

import contextlib
import gc
import sys
from collections.abc import Iterator

__all__ = ["idle_collector"]


@contextlib.contextmanager
def idle_collector() -> Iterator[None]:
    """Load modules without collections, and leave their objects out of all later ones.

    Modules make several hundred thousand objects that stay to the end. Python would look through
    these objects again and again during the import, and once more at its end: a small problem
    (`demos/column_compaction.py`) would take 1.2 times the processor time. Later objects are
    collected as ever. An interactive session may hold much else: there only the import is without
    collections.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
        if not hasattr(sys, "ps1"):
            gc.freeze()
    finally:
        if enabled:
            gc.enable()
