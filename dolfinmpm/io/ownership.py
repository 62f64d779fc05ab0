"""Owners of output files: two objects that write to one path would mix their files."""

from __future__ import annotations

import gc
import os
import weakref
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dolfinmpm._platform.errors import ParameterError

__all__ = ["refuse_other", "refuse_part", "take_paths"]

_owners: weakref.WeakValueDictionary[str, Any] = weakref.WeakValueDictionary()


def _key(path: Path) -> str:
    return os.path.abspath(path)


def _other(owner: Any, path: Path) -> bool:
    return _owners.get(_key(path), owner) is not owner


def take_paths(owner: Any, paths: Iterable[Path]) -> None:
    """Make an object the owner of some files, in place of an earlier owner."""
    for path in paths:
        _owners[_key(path)] = owner


def refuse_part(paths: Iterable[Path], first: Path) -> None:
    """Raise if files belong to a ParaView series that is not of the same first file.

    A series of the same first file replaces the other one as a whole; any other would overwrite a
    part of it.

    Args:
        paths: The files.
        first: The first of them, which names the series.

    Raises:
        ParameterError: Another object owns some of the files.
    """
    for attempt in (0, 1):
        owned = [(path, _owners.get(_key(path))) for path in paths]
        others = [path for path, by in owned if by is not None and _key(by.path) != _key(first)]
        if not others:
            return
        if not attempt:
            # of an earlier script, as in `refuse_other`
            del owned
            gc.collect()
    raise ParameterError(
        f"another ParaView series writes '{others[0]}', which belongs to '{first}' too: give one "
        "of them another name"
    )


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
