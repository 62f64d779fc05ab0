"""Python's collector of cycles does nothing while libraries are loaded, nor with them later."""

from __future__ import annotations

import contextlib
import gc
import sys
from collections.abc import Iterator

__all__ = ["idle_collector"]


@contextlib.contextmanager
def idle_collector() -> Iterator[None]:
    """Load modules without collections, and leave what is there then out of all later ones.

    Modules make several hundred thousand objects that stay to the end. To look through them costs
    a tenth of a second again and again while they are loaded, and once more when Python ends. What
    is made afterwards is collected as ever. In an interactive session, where much else may be there
    before, only the loading is without collections.
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
