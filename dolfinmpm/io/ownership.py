"""Owners of output files: two objects that write to one path would mix their files."""

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
    """Make an object the owner of some files, in place of an earlier owner."""
    for path in paths:
        _owners[_key(path)] = owner


def refuse_other(owner: Any, path: Path, what: str) -> None:
    """Raise if another object owns a file.

    Args:
        owner: Object that is about to write the file.
        path: The file.
        what: Kind of object, for the message.

    Raises:
        ParameterError: Another object owns the file.
    """
    if _other(owner, path):
        # an earlier script, such as in a notebook, may have left an unreachable object
        gc.collect()
    if _other(owner, path):
        raise ParameterError(
            f"another {what} writes '{path}', and of both there would be a mixture: give each a "
            "path of its own"
        )
