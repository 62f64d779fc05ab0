"""Unknowns that part those of different ranks, and where entries of a matrix go then."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

__all__ = ["Interior", "Separator"]

Integers = npt.NDArray[np.int32]
Places = npt.NDArray[np.int64]


@numba.njit(cache=True, error_model="numpy")
def _outside(start, columns, low, high, rows, others):
    """Couplings to columns of other ranks, both numbered globally; their number.

    Only counts if the arrays to be filled are empty.
    """
    count = 0
    for row in range(start.size - 1):
        for at in range(start[row], start[row + 1]):
            if columns[at] < low or columns[at] >= high:
                if rows.size > 0:
                    rows[count], others[count] = low + row, columns[at]
                count += 1
    return count


@numba.njit(cache=True, error_model="numpy")
def _place_of(column, low, high, number, among):
    """Interior number of a column, or −1 less its place in the separator; −1 less its size if
    it is of neither."""
    if low <= column < high:
        return number[column - low]
    at = np.searchsorted(among, column)
    return -1 - at if at < among.size and among[at] == column else -1 - among.size


@numba.njit(cache=True, error_model="numpy")
def _touched(start, columns, low, high, number, among, touched):
    """Mark the unknowns of the separator that interior rows couple to; entries that a lower
    triangle has, or −1 if a row couples to the interior of another rank."""
    count = 0
    for row in range(start.size - 1):
        if number[row] < 0:
            continue
        for at in range(start[row], start[row + 1]):
            place = _place_of(columns[at], low, high, number, among)
            if -1 - place == among.size:
                return -1
            if place < 0:
                touched[-1 - place] = True
            count += place < 0 or place >= number[row]
    return count


@numba.njit(cache=True, error_model="numpy")
def _fill(start, columns, low, high, number, among, late, indptr, rows, take):
    """Columns of the lower triangle of the interior rows, and where their entries are."""
    count = 0
    for row in range(start.size - 1):
        if number[row] < 0:
            continue
        for at in range(start[row], start[row + 1]):
            place = _place_of(columns[at], low, high, number, among)
            if place < 0 or place >= number[row]:
                rows[count] = place if place >= 0 else late[-1 - place]
                take[count] = at
                count += 1
        indptr[number[row] + 1] = count


def cover(rows: Integers, columns: Integers) -> Integers:
    """Fewest unknowns without which two sets are not coupled, by König's theorem.

    Args:
        rows, columns: Coupled unknowns of the first and of the second set, shape (n,) each.
    """
    from scipy import sparse
    from scipy.sparse.csgraph import maximum_bipartite_matching

    left, row = np.unique(rows, return_inverse=True)
    right, column = np.unique(columns, return_inverse=True)
    shape = left.size, right.size
    graph = sparse.csr_matrix((np.ones(row.size, np.int32), (row, column)), shape)
    partner = maximum_bipartite_matching(graph, perm_type="column")
    matched = np.flatnonzero(partner >= 0)
    back = np.full(right.size, -1)
    back[partner[matched]] = matched
    # what alternating paths from the unmatched of the first set reach
    on_left, on_right = partner < 0, np.zeros(right.size, bool)
    new = on_left
    while new.any():
        ahead = (graph.T @ new.astype(np.int32) > 0) & ~on_right
        on_right |= ahead
        new = np.zeros(left.size, bool)
        # all of them have partners, or the matching were not a maximum
        new[back[ahead]] = True
        on_left = on_left | new
    return np.concatenate([left[~on_left], right[on_right]])


@dataclass(frozen=True)
class Separator:
    """Unknowns without which those of different ranks are not coupled, the same on all ranks.

    Attributes:
        among: Their global rows, increasing, shape (n,).
        own: Which of them this rank owns.
        low, high: This rank's first row, and that after its last one.
    """

    among: Integers
    own: slice
    low: int
    high: int

    @staticmethod
    def of(A: PETSc.Mat, start: Integers, columns: Integers) -> Separator:
        """That of a matrix with symmetric pattern. Collective.

        Between any two ranks it is the smallest that there is.

        Args:
            A: The matrix.
            start, columns: First entries of its rows on this rank, and their global columns.
        """
        comm = A.comm.tompi4py()
        low, high = A.getOwnershipRange()
        none = np.empty(0, np.int32)
        count = _outside(start, columns, low, high, none, none)
        rows, others = np.empty((2, count), np.int32)
        _outside(start, columns, low, high, rows, others)
        found: list[Any] = [none]
        # for each pair the first one decides
        ends = A.getOwnershipRanges()
        for q in range(comm.rank + 1, comm.size):
            there = (others >= ends[q]) & (others < ends[q + 1])
            if there.any():
                found.append(cover(rows[there], others[there]))
        among = np.unique(np.concatenate(comm.allgather(np.concatenate(found))))
        return Separator(among, slice(*np.searchsorted(among, (low, high))), low, high)

    @property
    def size(self) -> int:
        """How many there are."""
        return self.among.size

    @property
    def own_rows(self) -> Integers:
        """Local rows of those that this rank owns."""
        return self.among[self.own] - np.int32(self.low)


@dataclass(frozen=True)
class Interior:
    """What a rank owns of the unknowns without the separator, and the lower triangle of

        B = (A_II, A_IG; A_GI, D),

    where G are the unknowns of the separator that the interior I couples to, and D is diagonal.

    Attributes:
        rows: Local rows of I, shape (n,).
        late: Which of the separator G is, shape (m,).
        indptr, indices: First entries and rows of its columns.
        take: Which entries of this rank's rows of A its first entries are; D follows.
        between: Which of them are between two unknowns of the separator,
        at: and which two.
    """

    rows: Integers
    late: Places
    indptr: Integers
    indices: Integers
    take: Places
    between: Places
    at: tuple[Places, Places]

    @staticmethod
    def of(separator: Separator, start: Integers, columns: Integers) -> Interior:
        """That of this rank.

        Args:
            separator: The separator.
            start, columns: First entries of this rank's rows, and their global columns.

        Raises:
            RuntimeError: The pattern is not symmetric.
        """
        low, high, among = separator.low, separator.high, separator.among
        own, n = separator.own_rows, separator.high - separator.low
        inside = np.ones(n, bool)
        inside[own] = False
        rows = np.flatnonzero(inside).astype(np.int32)
        number = np.empty(n, np.int32)
        number[rows] = np.arange(rows.size, dtype=np.int32)
        number[own] = -1 - np.arange(among.size, dtype=np.int32)[separator.own]
        touched = np.zeros(among.size, bool)
        count = _touched(start, columns, low, high, number, among, touched)
        if count < 0:
            raise RuntimeError("substructures need a matrix whose pattern is symmetric")
        late = np.flatnonzero(touched)
        numbers = np.full(among.size, -1, np.int32)
        numbers[late] = rows.size + np.arange(late.size, dtype=np.int32)
        indptr = np.zeros(rows.size + late.size + 1, np.int32)
        indices = np.empty(count + late.size, np.int32)
        take = np.empty(count, np.int64)
        _fill(start, columns, low, high, number, among, numbers, indptr, indices, take)
        indices[count:] = numbers[late]
        indptr[rows.size + 1 :] = count + 1 + np.arange(late.size)
        # few rows: those of the separator
        each = np.diff(start)[own]
        of_row = np.repeat(np.arange(among.size)[separator.own], each)
        first = np.repeat(start[own] - np.concatenate([[0], np.cumsum(each)[:-1]]), each)
        entries = (first + np.arange(of_row.size)).astype(np.int64)
        there = np.searchsorted(among, columns[entries])
        both = among[np.minimum(there, among.size - 1)] == columns[entries]
        between, at = entries[both], (of_row[both], there[both])
        return Interior(rows, late, indptr, indices, take, between, at)
