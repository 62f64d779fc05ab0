"""A distributed matrix: all ranks add to its rows, and send their parts to the owners."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["OwnedRows"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]


@numba.njit(cache=True, error_model="numpy")
def _unite(start, columns, number, row_of, got_start, got_rows, got_columns, low, high, to, rows,
           inner, outer):  # fmt: skip
    """Merge this rank's entries and received entries into owned rows with increasing columns.

    Args:
        start, columns: First entries of this rank's rows, and columns of the entries, with local
            numbers.
        number: Global number of every local number.
        row_of: Local row of each owned row, -1 for none.
        got_start: Start of each owned row in `got_rows`, shape (owned + 1,).
        got_rows: Received entries, sorted by owned row.
        got_columns: Columns of the received entries, with global numbers.
        low, high: First owned column, and the column behind the last owned one.
        to: Written: position of each entry in the matrix, first this rank's entries, then received
            entries. In columns of other ranks, −1 minus the position among these columns.
        rows: Written: first entries of the owned rows, in owned columns and in other columns.
        inner, outer: Written: owned columns, counted from 0, and other columns of the matrix.

    Returns:
        Numbers of entries in owned columns and in other columns.
    """
    longest = 0
    for row in range(row_of.size):
        count = got_start[row + 1] - got_start[row]
        if row_of[row] >= 0:
            count += start[row_of[row] + 1] - start[row_of[row]]
        longest = max(longest, count)
    column, source = np.empty(longest, np.int32), np.empty(longest, np.int32)
    here, there = 0, 0
    for row in range(row_of.size):
        count = 0
        if row_of[row] >= 0:
            for at in range(start[row_of[row]], start[row_of[row] + 1]):
                column[count], source[count] = number[columns[at]], at
                count += 1
        for at in range(got_start[row], got_start[row + 1]):
            column[count] = got_columns[got_rows[at]]
            source[count] = columns.size + got_rows[at]
            count += 1
        # insertion sort: only ghosts are out of order
        for k in range(1, count):
            c, s, at = column[k], source[k], k
            while at > 0 and column[at - 1] > c:
                column[at], source[at] = column[at - 1], source[at - 1]
                at -= 1
            column[at], source[at] = c, s
        for k in range(count):
            c = column[k]
            new = k == 0 or column[k - 1] != c
            if low <= c < high:
                if new:
                    inner[here] = c - low
                    here += 1
                to[source[k]] = here - 1
            else:
                if new:
                    outer[there] = c
                    there += 1
                to[source[k]] = -there
        rows[0, row + 1], rows[1, row + 1] = here, there
    return here, there


@numba.njit(cache=True, error_model="numpy")
def _put(data, to, got, got_to, values):
    """Replace the values of a matrix: this rank's entries plus received entries."""
    for k in range(got.size):
        values[got_to[k]] = 0.0
    for k in range(data.size):
        if to[k] >= 0:
            values[to[k]] = data[k]
    for k in range(got.size):
        values[got_to[k]] += got[k]


class OwnedRows:
    """Owned rows of a distributed matrix, with entries from all ranks. Collective.

    PETSc works on the array of values of this object. All data that depend on the pattern are
    computed once.

    Args:
        comm: Communicator.
        start, columns: First entries of the rows on this rank, and columns of the entries, with
            local numbers in increasing order.
        number: Global number of every local row and column.
        owned: Number of owned rows. Global numbers are consecutive, rank by rank.
        size: Number of rows of the matrix.

    Attributes:
        petsc: The PETSc matrix.
    """

    def __init__(
        self, comm: MPI.Intracomm, start: Integers, columns: Integers, number: Integers,
        owned: int, size: int,
    ):  # fmt: skip
        self._comm = comm
        ends = np.cumsum(comm.allgather(owned))
        high = int(ends[comm.rank])
        low = high - owned
        here = (number >= low) & (number < high)
        row_of = np.full(owned, -1, np.int32)
        row_of[number[here] - low] = np.flatnonzero(here)
        away = np.flatnonzero(~here)
        owner = np.searchsorted(ends, number[away], side="right")
        away = away[np.argsort(owner, kind="stable")]
        counts = np.diff(start)[away]
        self._sent = _ranges(start[away], counts)
        out = np.bincount(owner, minlength=comm.size)
        self._out = np.zeros(comm.size, np.int64)
        np.add.at(self._out, np.sort(owner), counts)
        into, self._in = np.empty_like(out), np.empty_like(self._out)
        comm.Alltoall(out, into)
        comm.Alltoall(self._out, self._in)
        got_rows = self._exchange(number[away], out, into)
        got_counts = self._exchange(counts.astype(np.int32), out, into)
        got_columns = self._exchange(number[columns[self._sent]], self._out, self._in)
        row = np.repeat(got_rows - low, got_counts)
        got_start = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=owned))])
        most = columns.size + row.size
        to, rows = np.full(most, -most - 1, np.int32), np.zeros((2, owned + 1), PETSc.IntType)
        inner, outer = np.empty((2, most), PETSc.IntType)
        n, m = _unite(
            start, columns, number, row_of, got_start, np.argsort(row, kind="stable"),
            got_columns, low, high, to, rows, inner, outer,
        )  # fmt: skip
        # values in other ranks' columns follow the values in owned columns; no entry, no position
        outside = (to < 0) & (to >= -most)
        to[outside] = n - 1 - to[outside]
        self._to, self._got_to = np.split(to, [columns.size])
        self._got = np.empty(row.size)
        self._values = np.zeros(n + m)
        shape = (owned, size)
        self.petsc: Any = PETSc.Mat().createAIJWithArrays(
            (shape, shape),
            ((rows[0], inner[:n].copy(), self._values[:n]),
             (rows[1], outer[:m].copy(), self._values[n:])),
            comm=comm,
        )  # fmt: skip
        self.petsc.setOption(PETSc.Mat.Option.NO_OFF_PROC_ENTRIES, True)

    def _exchange(self, values: npt.NDArray, out: npt.NDArray, into: npt.NDArray) -> npt.NDArray:
        """Values from all ranks, in the order of the ranks. Collective."""
        got = np.empty(into.sum(), values.dtype)
        self._comm.Alltoallv([values, out], [got, into])
        return got

    def put(self, data: Array) -> None:
        """Set the values of the matrix. Collective.

        Args:
            data: This rank's entries, shape (entries,).
        """
        self._comm.Alltoallv([data[self._sent], self._out], [self._got, self._in])
        _put(data, self._to, self._got, self._got_to, self._values)
        self.petsc.assemble()
        self.petsc.stateIncrease()


def _ranges(first: npt.NDArray, counts: npt.NDArray) -> npt.NDArray[np.intp]:
    """Joined ranges: counts[i] numbers from first[i] on, for all i."""
    begins = np.cumsum(counts) - counts
    return np.repeat(first - begins, counts).astype(np.intp) + np.arange(counts.sum())
