"""Tables of studies on disk, as CSV or JSON."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, call_on_root, call_together
from dolfinmpm._platform.filepaths import file_path

__all__ = [
    "check_suffix",
    "read_table",
    "rows_of",
    "write_table",
]

Row = Mapping[str, Any]
PathLike = str | os.PathLike[str]


@collective(local=("rows",))
def write_table(rows: Iterable[Row], path: PathLike, *, comm: MPI.Comm = MPI.COMM_WORLD) -> None:
    """Write rows as CSV or as JSON; rank 0 writes them. Collective.

    The columns of a CSV file are all names in the rows, in the order of their first occurrence. A
    missing value or None is an empty cell. A pair or a list is written in JSON's brackets.

    Args:
        rows: Dictionaries of numbers, words, None, and lists of them.
        path: File to write, ending in .csv or .json. Parent folders are created.
        comm: Ranks that make this call.

    Raises:
        ParameterError: The path has another ending, or a row is not a dictionary.
        OSError: The file cannot be written; on all ranks.

    >>> import dolfinmpm as mpm
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> file = Path(mkdtemp(), "table.csv")
    >>> mpm.study.write_table([{"h": 0.5, "error": 0.1}, {"h": 0.25, "error": None}], file)
    >>> print(file.read_text().strip())
    h,error
    0.5,0.1
    0.25,
    """
    check_kind("comm", comm, MPI.Comm, "MPI.COMM_WORLD by default")
    path, rows = file_path("path", path), call_together(comm, lambda: rows_of(rows))
    check_suffix(path)

    def write() -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".json":
            path.write_text(
                json.dumps([dict(row) for row in rows], indent=1, default=_plain) + "\n"
            )
            return
        names = list(dict.fromkeys(name for row in rows for name in row))
        with path.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(names)
            table.writerows([_cell(row.get(name)) for name in names] for row in rows)

    call_on_root(comm, write)


@collective
def read_table(path: PathLike, *, comm: MPI.Comm = MPI.COMM_WORLD) -> list[dict[str, Any]]:
    """Read what `write_table` wrote; rank 0 reads, all ranks get the rows. Collective.

    Pairs come back as lists.

    Args:
        path: File to read, ending in .csv or .json.
        comm: Ranks that make this call.

    Raises:
        ParameterError: The path has another ending, or there is no table in the file.
        OSError: The file cannot be read; on all ranks.

    >>> import dolfinmpm as mpm
    >>> from tempfile import mkdtemp
    >>> file = f"{mkdtemp()}/table.json"
    >>> mpm.study.write_table([{"place": [0.1, 0.2], "error": 0.5}], file)
    >>> mpm.study.read_table(file)
    [{'place': [0.1, 0.2], 'error': 0.5}]
    """
    path = file_path("path", path)
    check_kind("comm", comm, MPI.Comm, "MPI.COMM_WORLD by default")
    check_suffix(path)

    def read() -> list[dict[str, Any]]:
        if path.suffix == ".json":
            try:
                return [dict(row) for row in rows_of(json.loads(path.read_text()))]
            except (json.JSONDecodeError, UnicodeDecodeError) as error:
                raise ParameterError(f"'{path}' is no table in JSON: {error}") from error
        with path.open(newline="", encoding="utf-8") as file:
            table = csv.DictReader(file)
            names = list(table.fieldnames or ())
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ParameterError(
                    f"'{path}' has the column '{twice[0]}' twice, and a row has one figure by each "
                    "name: rename one"
                )
            return [{k: _value(v) for k, v in row.items()} for row in table]

    return call_on_root(comm, read)


def rows_of(given: Any, *names: str) -> list[Row]:
    """Rows of a table.

    Args:
        given: Argument of the user.
        names: Figures that at least one row must have.

    Raises:
        ParameterError: The rows are not dictionaries, or no row has one of the figures.
    """
    listed = [] if isinstance(given, (str, Mapping)) or not isinstance(given, Iterable) else given
    rows = list(listed)
    if (listed is not given) or not all(isinstance(row, Mapping) for row in rows):
        raise ParameterError(
            f"rows = {shown(given)} must be a list of dictionaries, a figure by each name"
        )
    for name in names:
        if not any(name in row for row in rows):
            there = list(dict.fromkeys(key for row in rows for key in row))
            raise ParameterError(
                f"no row has a figure '{name}'; there are {', '.join(map(str, there)) or 'no rows'}"
            )
    return rows


def check_suffix(path: Path) -> None:
    """Raise ParameterError unless a table can be written to such a path."""
    if path.suffix not in (".csv", ".json"):
        raise ParameterError(f"a table is written to a path in .csv or .json, got '{path}'")


def _plain(value: Any) -> Any:
    """What JSON knows for NumPy's numbers and arrays."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written to a table")


def _cell(value: Any) -> str:
    if value is None:
        return ""
    # a word that would be read as a number, or as nothing, is put in quotes of its own
    if isinstance(value, str) and value and _value(value) == value:
        return value
    return json.dumps(value, default=_plain, ensure_ascii=False)


def _value(cell: str) -> Any:
    if not cell:
        return None
    try:
        return json.loads(cell)
    except json.JSONDecodeError:
        return cell
