"""HDF5 files of arrays whose rows are spread over ranks, whole or not there.

Rank 0 writes and reads for all, some megabytes at a time, for that needs neither an
HDF5 built for MPI nor a folder that all ranks see.
"""

from __future__ import annotations

import contextlib
import glob
import io
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import CheckpointError, raise_together

__all__ = ["RowReader", "RowWriter"]

Rows = npt.NDArray[Any]

# What goes through rank 0 at a time, and what HDF5 gives a checksum of its own (bytes).
_PIECE, _CHUNK = 1 << 22, 1 << 18
_HEADER = "header"


def _h5py() -> Any:
    try:
        import h5py
    except ImportError as cause:
        raise CheckpointError(
            "checkpoints need h5py; install python3-h5py, or h5py by pip"
        ) from cause
    return h5py


class _RowFile:
    """What writer and reader share: the file on rank 0, and its first error.

    An error waits until the ranks meet next: those that send or receive rows
    would wait for ever for a rank 0 that has left.
    """

    def __init__(self, comm: MPI.Intracomm, path: str | os.PathLike[str]):
        self._comm = comm
        # through links, which stay; what rank 0 was told counts
        self.path = Path(comm.bcast(os.path.realpath(path)))
        self._file: Any = None
        self._error: Exception | None = None

    def _do(self, action: Callable[..., Any], *arguments: Any) -> Any:
        """Act on rank 0, unless something went wrong there before."""
        if self._comm.rank == 0 and self._error is None:
            try:
                return action(*arguments)
            except Exception as caught:
                self._error = caught
        return None

    def _meet(self) -> None:
        """Raise on all ranks what went wrong on rank 0. Collective."""
        error = self._error
        if error is not None and not isinstance(error, CheckpointError):
            told = CheckpointError(self._tell(error))
            told.__cause__ = error
            error = told
        raise_together(self._comm, error)

    def _tell(self, error: Exception) -> str:
        raise NotImplementedError

    def _close(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _pieces(self, counts: Sequence[int], row: int):
        """Rank, first and last of its rows, and the first of these in the file, piece by piece."""
        step, at = max(1, _PIECE // max(row, 1)), 0
        for rank, count in enumerate(counts):
            for begin in range(0, count, step):
                yield rank, begin, min(begin + step, count), at + begin
            at += count


def _row_bytes(dtype: np.dtype, shape: Sequence[int]) -> int:
    return dtype.itemsize * int(np.prod(shape, dtype=int))


class _Disk(io.RawIOBase):
    """A new file as HDF5 writes it, through Python's own calls, of which none fails.

    HDF5 crashes when it closes a file that the disk has no room for. So it is not told:
    what the disk refused is kept, for HDF5 reads some of it again, and the error too.

    Args:
        file: Descriptor of the file, which it closes.
    """

    def __init__(self, file: int):
        self.error: BaseException | None = None
        self._file = file
        self._at = 0
        self._refused: list[tuple[int, bytes]] = []

    def _try(self, call: Callable[..., Any], *arguments: Any) -> Any:
        if self.error is None:
            try:
                return call(self._file, *arguments)
            # an interruption too would reach HDF5 as an error of the file
            except BaseException as caught:
                self.error = caught
        return None

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place, of which the end of the file is one."""
        if whence == os.SEEK_END:
            ends = [at + len(data) for at, data in self._refused]
            offset += max([os.fstat(self._file).st_size, *ends])
        self._at = offset + (self._at if whence == os.SEEK_CUR else 0)
        return self._at

    def tell(self) -> int:
        """Where it is."""
        return self._at

    def readinto(self, buffer: Any) -> int:
        """What was written here; zeros where nothing was."""
        view = memoryview(buffer).cast("B")
        data = self._try(os.pread, len(view), self._at) or b""
        view[:] = data + bytes(len(view) - len(data))
        for at, kept in self._refused:
            begin, end = max(at, self._at), min(at + len(kept), self._at + len(view))
            if begin < end:
                view[begin - self._at : end - self._at] = kept[begin - at : end - at]
        self._at += len(view)
        return len(view)

    def write(self, data: Any) -> int:
        """Write here, on the disk if there was no error yet."""
        view = memoryview(data).cast("B")
        done = 0
        while done < len(view):
            written = self._try(os.pwrite, view[done:], self._at + done)
            if written is None:
                self._refused.append((self._at + done, bytes(view[done:])))
                break
            done += written
        self._at += len(view)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the file's size."""
        size = self._at if size is None else size
        self._try(os.ftruncate, size)
        return size

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Close the file, all of it on the disk."""
        if not self.closed:
            self._try(os.fsync)
            os.close(self._file)
        super().close()


class RowWriter(_RowFile):
    """Writes a file beside its target, which it replaces when it is whole. Collective.

    A context: what is written takes the target's name at its end. Before that, and
    after any error or a kill, the target is what it was; what a killed writer left
    is removed by the next one.

    Args:
        comm: Ranks that write.
        path: File to write, in a folder that is there.
        format: What the file is, for readers.
        version: Version of the format.

    Raises:
        CheckpointError: The file cannot be written, or h5py is missing.
    """

    def __init__(
        self, comm: MPI.Intracomm, path: str | os.PathLike[str], format: str, version: int
    ):
        super().__init__(comm, path)
        self._part = self.path.with_name(f"{self.path.name}.part-{os.getpid()}")
        self._about = {"format": format, "version": version}
        self._disk: _Disk | None = None
        self._index: dict[str, Any] = {}
        self._header: dict[str, Any] = {}

    def __enter__(self) -> RowWriter:
        """The writer itself."""
        self._do(self._open)
        self._meet_or_clean()
        return self

    def __exit__(self, kind, *exception: object) -> None:
        """Give the file its name, or remove it."""
        if kind is not None:
            self._clean()
            return
        self._do(self._complete)
        self._meet_or_clean()

    def _open(self) -> None:
        h5py = _h5py()
        for left in self.path.parent.glob(glob.escape(self.path.name) + ".part-*"):
            with contextlib.suppress(OSError):
                left.unlink()
        # from 1.10 on HDF5 has checksums of its structure too
        self._disk = _Disk(os.open(self._part, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666))
        self._file = h5py.File(self._disk, "w", libver=("v110", "v110"))
        for name, value in self._about.items():
            self._file.attrs[name] = value

    def _complete(self) -> None:
        header = {"rows": self._index, **self._header}
        text = np.frombuffer(json.dumps(header).encode(), np.uint8)
        # written last: a file without it is not whole
        self._create(_HEADER, len(text), text)[:] = text
        self._close()
        os.replace(self._part, self.path)
        with contextlib.suppress(OSError):  # some file systems cannot sync a folder
            _sync(self.path.parent)

    def _close(self) -> None:
        super()._close()
        disk, self._disk = self._disk, None
        if disk is not None:
            disk.close()
            if disk.error is not None:
                raise disk.error

    def _do(self, action: Callable[..., Any], *arguments: Any) -> Any:
        result = super()._do(action, *arguments)
        if self._disk is not None and self._disk.error is not None and self._error is None:
            if not isinstance(self._disk.error, Exception):
                raise self._disk.error
            self._error = self._disk.error
        return result

    def _meet_or_clean(self) -> None:
        if self._error is not None:
            self._clean()
        self._meet()

    def _clean(self) -> None:
        if self._comm.rank == 0:
            with contextlib.suppress(Exception):  # there is an error to tell already
                self._close()
            with contextlib.suppress(OSError):
                self._part.unlink(missing_ok=True)

    def _tell(self, error: Exception) -> str:
        return (
            f"cannot write {self.path}: {error}; is its folder there and writable, and the disk "
            "not full? A file that had this name before is as it was"
        )

    def _create(self, name: str, rows: int, like: Rows) -> Any:
        shape = (rows, *like.shape[1:])
        if 0 in shape:
            return self._file.create_dataset(name, shape, like.dtype)
        chunk = min(rows, max(1, _CHUNK // _row_bytes(like.dtype, like.shape[1:])))
        return self._file.create_dataset(
            name, shape, like.dtype, chunks=(chunk, *like.shape[1:]), fletcher32=True
        )

    def rows(self, name: str, values: Rows) -> None:
        """Write an array, the rows of one rank behind those of another. Collective.

        Args:
            name: Its name in the file.
            values: This rank's rows, of one shape and type on all ranks.
        """
        comm = self._comm
        values = np.ascontiguousarray(values)
        dtype, shape = values.dtype, values.shape[1:]
        counts = comm.allgather(len(values))
        target = self._do(self._create, name, sum(counts), values)
        for rank, begin, end, at in self._pieces(counts, _row_bytes(dtype, shape)):
            if comm.rank == 0:
                piece = values[begin:end] if rank == 0 else np.empty((end - begin, *shape), dtype)
                if rank:
                    comm.Recv(_bytes(piece), rank)
                self._do(_put, target, at, piece)
            elif comm.rank == rank:
                comm.Send(_bytes(values[begin:end]), 0)
        self._index[name] = {"counts": counts, "dtype": dtype.str, "shape": shape}

    def header(self, values: dict[str, Any]) -> None:
        """Give the file's header, which JSON can hold; rank 0's counts."""
        self._header = values


class RowReader(_RowFile):
    """Reads what a `RowWriter` wrote. Collective.

    Args:
        comm: Ranks that read; any number.
        path: The file.
        format: What it must be.
        version: The newest version that the caller knows.

    Attributes:
        header: What the writer was given as such.

    Raises:
        CheckpointError: There is no such file, it is cut short or damaged, something
            else, or of a newer version.
    """

    def __init__(
        self, comm: MPI.Intracomm, path: str | os.PathLike[str], format: str, version: int
    ):
        super().__init__(comm, path)
        self._format, self._version = format, version
        self.header: dict[str, Any] = {}

    def __enter__(self) -> RowReader:
        """The reader itself."""
        found = self._do(self._open)
        if self._error is not None:
            self.__exit__()
        self._meet()
        self.header = self._comm.bcast(found)
        self._index = self.header.pop("rows")
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the file."""
        with contextlib.suppress(Exception):  # nothing was written
            self._close()

    def _open(self) -> dict[str, Any]:
        h5py = _h5py()
        if not self.path.is_file():
            raise CheckpointError(f"there is no file {self.path} to read")
        # a file has its name when it is whole, and is never changed then: it needs no lock
        self._file = h5py.File(self.path, "r", locking=False)
        found = self._file.attrs.get("format"), self._file.attrs.get("version")
        if found[0] != self._format:
            raise CheckpointError(f"{self.path} is an HDF5 file, but no {self._format}")
        if found[1] > self._version:
            raise CheckpointError(
                f"{self.path} has version {found[1]} of a {self._format}, this dolfinmpm reads up "
                f"to {self._version}: update it"
            )
        if _HEADER not in self._file:
            raise CheckpointError(f"{self.path} is not whole: its header is missing")
        header = json.loads(self._file[_HEADER][:].tobytes())
        for name, entry in header["rows"].items():
            shape, dtype = (sum(entry["counts"]), *entry["shape"]), np.dtype(entry["dtype"])
            if self._file[name].shape != shape or self._file[name].dtype != dtype:
                raise CheckpointError(
                    f"{self.path} is damaged: its array {name} has not the {shape[0]} rows of "
                    "which its header knows; take an earlier file"
                )
        return header

    def _tell(self, error: Exception) -> str:
        return (
            f"cannot read {self.path}: it is no HDF5 file, cut short or damaged ({error}); take "
            "an earlier file"
        )

    def _get(self, name: str, at: int, piece: Rows) -> None:
        self._file[name].read_direct(piece, np.s_[at : at + len(piece)])

    def counts(self, name: str) -> list[int]:
        """Rows of an array that each of the ranks wrote."""
        return self._index[name]["counts"]

    def names(self, group: str) -> list[str]:
        """Names of the arrays in a group, without it."""
        return [n.removeprefix(f"{group}/") for n in self._index if n.startswith(f"{group}/")]

    def rows(self, name: str, counts: Sequence[int]) -> Rows:
        """Read an array, so many rows for each rank in turn. Collective.

        Args:
            name: Its name in the file.
            counts: Number of rows for each rank; all rows together.

        Raises:
            CheckpointError: The file cannot be read there.
        """
        comm, entry = self._comm, self._index[name]
        dtype, shape = np.dtype(entry["dtype"]), tuple(entry["shape"])
        out = np.empty((counts[comm.rank], *shape), dtype)
        for rank, begin, end, at in self._pieces(counts, _row_bytes(dtype, shape)):
            if comm.rank == 0:
                piece = out[begin:end] if rank == 0 else np.zeros((end - begin, *shape), dtype)
                self._do(self._get, name, at, piece)
                if rank:
                    comm.Send(_bytes(piece), rank)
            elif comm.rank == rank:
                comm.Recv(_bytes(out[begin:end]), 0)
        self._meet()
        return out


def _bytes(rows: Rows) -> Rows:
    return rows.reshape(-1).view(np.uint8)


def _put(target: Any, at: int, piece: Rows) -> None:
    target[at : at + len(piece)] = piece


def _sync(path: Path) -> None:
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
