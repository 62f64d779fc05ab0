"""Compiled loops are loaded without what Numba needs to compile others.

Before Numba takes a function from its cache it imports and registers everything that it can
compile, a sixth of all the time that a small scene takes. What is in the cache is machine code: it
needs Numba's runtime, and of those modules the few that it names, which are imported with it. A
function that is not in the cache is compiled as ever, and Numba gets ready for that by itself.
"""

from __future__ import annotations

from typing import Any

from numba.core import caching
from numba.core.runtime import rtsys

__all__ = ["load_at_once"]

# What Numba's own function does, in versions that have been looked at: nothing else is left out
_KNOWN = ("refresh", "_guard_against_spurious_io_errors", "_load_overload")


def load_at_once(package: str) -> bool:
    """Let functions of a package be loaded without what their compilation needs.

    Args:
        package: Its name.

    Returns:
        Whether they are; not where Numba's loading is another than the one that is known.
    """
    as_ever = caching.Cache.load_overload
    if as_ever.__code__.co_names != _KNOWN:
        return False

    def load_overload(self: Any, sig: Any, target_context: Any) -> Any:
        if not self._py_func.__module__.startswith(f"{package}."):
            return as_ever(self, sig, target_context)
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)
        return None  # an error of the file system: it is compiled

    caching.Cache.load_overload = load_overload
    return True
