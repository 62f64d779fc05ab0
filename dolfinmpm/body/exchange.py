"""Rows of arrays that go from rank to rank, and numbers that do not depend on the ranks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

__all__ = ["exchange", "numbers_in_order", "row_bytes"]

Rows = dict[str, npt.NDArray[Any]]


def row_bytes(values: npt.NDArray[Any]) -> int:
    """Bytes of one row of an array."""
    return values.dtype.itemsize * int(np.prod(values.shape[1:], dtype=int))


def exchange(
    comm: MPI.Intracomm, rows: Mapping[str, npt.NDArray[Any]], to: npt.NDArray[np.int32]
) -> Rows:
    """Send rows to other ranks; what stays comes first. Collective.

    Args:
        comm: Communicator.
        rows: Arrays of n rows each, with the same names, kinds and shapes of a row on all ranks.
        to: Rank that each row goes to, shape (n,).
    """
    leaving = np.flatnonzero(to != comm.rank)
    leaving = leaving[np.argsort(to[leaving], kind="stable")]
    counts = np.bincount(to[leaving], minlength=comm.size)
    packed = np.hstack(
        [np.ascontiguousarray(a[leaving]).view(np.uint8).reshape(leaving.size, row_bytes(a))
         for a in rows.values()]
    )  # fmt: skip
    width = packed.shape[1]
    arriving = np.empty_like(counts)
    comm.Alltoall(counts, arriving)
    received = np.empty((arriving.sum(), width), np.uint8)
    comm.Alltoallv([np.ascontiguousarray(packed), counts * width], [received, arriving * width])
    staying, start = np.flatnonzero(to == comm.rank), 0
    joined: Rows = {}
    for name, values in rows.items():
        size = row_bytes(values)
        piece = np.ascontiguousarray(received[:, start : start + size]).view(values.dtype)
        piece = piece.reshape(-1, *values.shape[1:])
        both = np.empty((staying.size + len(piece), *values.shape[1:]), values.dtype)
        # with an array to write to, and no checks, this is as fast as copying can be
        np.take(values, staying, axis=0, out=both[: staying.size], mode="clip")
        both[staying.size :] = piece
        joined[name] = both
        start += size
    return joined


def numbers_in_order(comm: MPI.Intracomm, keys: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Numbers 0, 1, ... of rows in the order of their keys over all ranks. Collective.

    Args:
        comm: Communicator.
        keys: Keys, shape (n, k); the first column counts most. No two rows are equal.
    """
    pieces = comm.gather(keys, root=0)
    numbers = None
    if pieces is not None:
        order = np.lexsort(np.concatenate(pieces).T[::-1])
        ranked = np.empty(len(order), np.int64)
        ranked[order] = np.arange(len(order))
        numbers = np.split(ranked, np.cumsum([len(piece) for piece in pieces])[:-1])
    return comm.scatter(numbers, root=0)
