"""Which object writes a file: two that wrote one path in turns would leave a mixture of both."""

from __future__ import annotations

import gc
import os
import weakref
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dolfinmpm._platform.errors import ParameterError

__all__ = ["refuse_other", "take_paths"]

_owners: weakref.WeakValueDictionary[str, Any] = weakref.WeakValueDictionary()


def _key(path: Path) -> str:
    return os.path.abspath(path)


def _other(owner: Any, path: Path) -> bool:
    return _owners.get(_key(path), owner) is not owner


def take_paths(owner: Any, paths: Iterable[Path]) -> None:
    """Make an object the one that writes some files, whoever did so before."""
    for path in paths:
        _owners[_key(path)] = owner


def refuse_other(owner: Any, path: Path, what: str) -> None:
    """Raise where another object writes a file.

    Args:
        owner: What is about to write it.
        path: The file.
        what: What writes it, for the message.

    Raises:
        ParameterError: Another one does.
    """
    if _other(owner, path):
        # a script that ended, as in a notebook, may have left one that nothing can reach any more
        gc.collect()
    if _other(owner, path):
        raise ParameterError(
            f"another {what} writes '{path}', and of both there would be a mixture: give each a "
            "path of its own"
        )
