"""NumPy archives of arrays with rows distributed over ranks: complete, or not written at all.

`numpy.load` opens such an archive, too. It is a zip file of arrays, each with a checksum, without
compression. Rank 0 writes and reads for all ranks, some megabytes at a time. So the ranks need no
common folder. (HDF5 is no alternative: 1.14 still ends the process when the disk is full.)
"""

from __future__ import annotations

import contextlib
import glob
import json
import os
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import CheckpointError, raise_together

__all__ = ["RowReader", "RowWriter", "plain", "restored"]

Rows = npt.NDArray[Any]

# Bytes sent through rank 0 at a time
_PIECE = 1 << 22
_HEADER = "header.json"


class _RowFile:
    """Common part of writer and reader: the file on rank 0, and its first error.

    An error is raised only when the ranks meet next. Otherwise ranks that send or receive rows
    would wait for rank 0 for ever.
    """

    # message of an error on rank 0, with fields for the path and the error
    _failure = ""

    def __init__(self, comm: MPI.Intracomm, path: str | os.PathLike[str]):
        self._comm = comm
        # links are followed, and not replaced; the path on rank 0 counts
        self.path = Path(comm.bcast(os.path.realpath(path)))
        self._file: Any = None
        self._member: Any = None
        self._error: Exception | None = None
        self._index: dict[str, Any] = {}

    def _do(self, action: Callable[..., Any], *arguments: Any) -> Any:
        """Call an action on rank 0, unless an earlier action failed there."""
        if self._comm.rank == 0 and self._error is None:
            try:
                return action(*arguments)
            except Exception as caught:
                self._error = caught
        return None

    def _meet(self) -> None:
        """Raise an error of rank 0 on all ranks, with the file closed. Collective."""
        error = self._error
        if error is not None:
            self._close_after_error()
            if not isinstance(error, CheckpointError):
                told = CheckpointError(self._failure.format(path=self.path, error=error))
                told.__cause__ = error
                error = told
        raise_together(self._comm, error)

    def _close_after_error(self) -> None:
        # the first error is reported, not errors that follow from it
        for one in (self._member, self._file):
            if one is not None:
                with contextlib.suppress(Exception):
                    one.close()

    def _pieces(self, name: str, counts: Sequence[int]) -> Iterator[tuple[int, slice, Any]]:
        """Rank, rows and data type, piece by piece in the order of the file."""
        dtype, shape = np.dtype(self._index[name]["dtype"]), tuple(self._index[name]["shape"])
        step = max(1, _PIECE // max(1, dtype.itemsize * int(np.prod(shape, dtype=int))))
        for rank, count in enumerate(counts):
            for begin in range(0, count, step):
                end = min(begin + step, count)
                yield rank, slice(begin, end), np.empty((end - begin, *shape), dtype)


class RowWriter(_RowFile):
    """Writes a new file, and then replaces the target by the complete file. Collective.

    It is a context manager. The file gets the target's name at the end of the context. Before, and
    after any error or kill, the target is unchanged. The next writer removes files of killed
    writers.

    Args:
        comm: Ranks that write.
        path: Target file, in an existing folder.
        format: Name of the format, for readers.
        version: Version of the format.

    Raises:
        CheckpointError: The file cannot be written.
    """

    _failure = (
        "cannot write {path}: {error}; is its folder there and writable, and the disk not full? "
        "A file that had this name before is as it was"
    )

    def __init__(
        self, comm: MPI.Intracomm, path: str | os.PathLike[str], format: str, version: int
    ):
        super().__init__(comm, path)
        self._part = self.path.with_name(f"{self.path.name}.part-{os.getpid()}")
        self._header: dict[str, Any] = {"format": format, "version": version}

    def __enter__(self) -> RowWriter:
        """The writer itself."""
        self._do(self._open)
        self._meet()
        return self

    def __exit__(self, kind, *exception: object) -> None:
        """Give the file its name, or remove it."""
        if kind is not None:
            self._close_after_error()
            return
        self._do(self._complete)
        self._meet()

    def _open(self) -> None:
        for left in self.path.parent.glob(glob.escape(self.path.name) + ".part-*"):
            with contextlib.suppress(OSError):
                left.unlink()
        self._file = zipfile.ZipFile(self._part, "w")

    def _close_after_error(self) -> None:
        super()._close_after_error()
        if self._comm.rank == 0:
            with contextlib.suppress(OSError):
                self._part.unlink(missing_ok=True)

    def _complete(self) -> None:
        # a file without its header is not complete
        self._file.writestr(
            _HEADER, json.dumps({**self._header, "rows": self._index}, default=plain)
        )
        self._file.close()
        _sync(self._part)
        os.replace(self._part, self.path)
        with contextlib.suppress(OSError):  # some file systems cannot sync a folder
            _sync(self.path.parent)

    def _begin(self, name: str, dtype: np.dtype, shape: tuple[int, ...]) -> None:
        self._member = self._file.open(f"{name}.npy", "w", force_zip64=True)
        np.lib.format.write_array_header_1_0(
            self._member, {"descr": dtype.str, "fortran_order": False, "shape": shape}
        )

    def _put(self, piece: Rows) -> None:
        self._member.write(_bytes(piece))

    def _end(self) -> None:
        self._member.close()

    def rows(self, name: str, values: Rows) -> None:
        """Write an array, with the rows of all ranks in the order of ranks. Collective.

        Args:
            name: Its name in the file.
            values: Rows of this rank, of one shape and type on all ranks.
        """
        comm = self._comm
        values = np.ascontiguousarray(values)
        dtype, shape = values.dtype, values.shape[1:]
        counts = comm.allgather(len(values))
        self._index[name] = {"counts": counts, "dtype": dtype.str, "shape": shape}
        self._do(self._begin, name, dtype, (sum(counts), *shape))
        for rank, rows, piece in self._pieces(name, counts):
            if rank == comm.rank:
                piece = values[rows]
                if rank:
                    comm.Send(_bytes(piece), 0)
            elif comm.rank == 0:
                comm.Recv(_bytes(piece), rank)
            self._do(self._put, piece)
        self._do(self._end)

    def header(self, values: dict[str, Any]) -> None:
        """Write the header: values that JSON and `plain` can hold. The values on rank 0 count."""
        self._header |= values


class RowReader(_RowFile):
    """Reads a file of a `RowWriter`. Collective.

    Args:
        comm: Ranks that read; any number.
        path: The file.
        format: Required name of the format.
        version: The supported version.

    Attributes:
        header: The writer's header.

    Raises:
        CheckpointError: The file is missing, cut short or damaged, or has another format or
            another version.
    """

    _failure = (
        "cannot read {path}: it is no archive of NumPy, cut short or damaged ({error}); take an "
        "earlier file"
    )

    def __init__(
        self, comm: MPI.Intracomm, path: str | os.PathLike[str], format: str, version: int
    ):
        super().__init__(comm, path)
        self._format, self._version = format, version
        self.header: dict[str, Any] = {}

    def __enter__(self) -> RowReader:
        """The reader itself."""
        found = self._do(self._open)
        self._meet()
        self.header = self._comm.bcast(found)
        self._index = self.header.pop("rows")
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the file."""
        self._close_after_error()

    def _open(self) -> dict[str, Any]:
        if not self.path.is_file():
            raise CheckpointError(f"there is no file {self.path} to read")
        self._file = zipfile.ZipFile(self.path)
        text = self._file.read(_HEADER) if _HEADER in self._file.namelist() else "{}"
        header = json.loads(text, object_hook=restored)
        if header.get("format") != self._format:
            raise CheckpointError(f"{self.path} is an archive, but no {self._format}")
        if (found := header["version"]) != self._version:
            advice = "update it" if found > self._version else "write the file anew with this one"
            raise CheckpointError(
                f"{self.path} has version {found} of a {self._format}, this dolfinmpm reads "
                f"version {self._version}: {advice}"
            )
        return header

    def _begin(self, name: str) -> None:
        entry = self._index[name]
        self._member = self._file.open(f"{name}.npy")
        np.lib.format.read_magic(self._member)
        shape, _, dtype = np.lib.format.read_array_header_1_0(self._member)
        known = (sum(entry["counts"]), *entry["shape"])
        if shape != known or dtype != np.dtype(entry["dtype"]):
            raise CheckpointError(
                f"{self.path} is damaged: its array {name} has not the {known[0]} rows of its "
                "header; take an earlier file"
            )

    def _get(self, piece: Rows) -> None:
        if self._member.readinto(_bytes(piece)) != piece.nbytes:
            raise EOFError("an array is too short")

    def counts(self, name: str) -> list[int]:
        """Number of rows of an array, per rank that wrote the file."""
        return self._index[name]["counts"]

    def names(self, group: str) -> list[str]:
        """Names of the arrays in a group, without the name of the group."""
        return [n.removeprefix(f"{group}/") for n in self._index if n.startswith(f"{group}/")]

    def rows(self, name: str, counts: Sequence[int]) -> Rows:
        """Read an array, with a given number of rows per rank. Collective.

        Args:
            name: Its name in the file.
            counts: Number of rows per rank. Their sum is the number of all rows.

        Raises:
            CheckpointError: The array cannot be read.
        """
        comm, entry = self._comm, self._index[name]
        out = np.empty((counts[comm.rank], *entry["shape"]), np.dtype(entry["dtype"]))
        self._do(self._begin, name)
        for rank, rows, piece in self._pieces(name, counts):
            if comm.rank == rank:
                piece = out[rows]
            self._do(self._get, piece)
            if rank and comm.rank == 0:
                comm.Send(_bytes(piece), rank)
            elif rank and comm.rank == rank:
                comm.Recv(_bytes(piece), 0)
        self._meet()
        return out


def plain(value: Any) -> Any:
    """JSON's value for a number or a small array of NumPy, for `json.dumps(default=...)`."""
    if isinstance(value, np.ndarray):
        return {"dtype": value.dtype.str, "shape": value.shape, "values": value.ravel().tolist()}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"JSON has no {type(value).__name__}")


def restored(found: dict[str, Any]) -> Any:
    """The inverse of `plain`, for `json.loads(object_hook=...)`."""
    if found.keys() == {"dtype", "shape", "values"}:
        return np.array(found["values"], np.dtype(found["dtype"])).reshape(found["shape"])
    return found


def _bytes(rows: Rows) -> Rows:
    return rows.reshape(-1).view(np.uint8)


def _sync(path: Path) -> None:
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
