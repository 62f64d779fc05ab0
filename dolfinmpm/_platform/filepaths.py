"""Paths of files that users give."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError

__all__ = ["existing_file", "file_path", "text_of"]


def file_path(what: str, value: Any) -> Path:
    """An argument as a path.

    Raises:
        ParameterError: The argument is neither text nor a path.
    """
    if not isinstance(value, (str, os.PathLike)) or not os.fspath(value):
        raise ParameterError(f"{what} = {shown(value)} must be a path, such as 'output/name'")
    return Path(value)


def existing_file(what: str, value: Any) -> Path:
    """An argument as the path of a file that is there.

    Raises:
        ParameterError: The argument is neither text nor a path.
        FileNotFoundError: There is no such file.
    """
    file = file_path(what, value)
    if not file.is_file():
        raise FileNotFoundError(f"there is no file {file}, seen from {Path.cwd()}")
    return file


def text_of(what: str, value: Any) -> str:
    """Text of an `existing_file` in UTF-8, without a byte order mark. Other bytes become "�"."""
    return existing_file(what, value).read_text(encoding="utf-8-sig", errors="replace")
