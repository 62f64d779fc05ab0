"""Rows of a system of equations in even shares, whoever owns the nodes that they belong to."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

__all__ = ["EvenRows"]

Array = npt.NDArray[np.float64]

# Largest share over the mean that is even enough. Ranks own the nodes of a compact region; where
# their rows are cut anew, those that change hands may lie anywhere in it, so that more of them
# are coupled to rows of other ranks.
_EVEN = 1.1


class EvenRows:
    """Rows that ranks have one after the other, cut anew if their shares differ. Collective.

    Args:
        comm: Communicator.
        count: Rows that this rank has in the first place.
        block: Rows that stay together.

    Attributes:
        owned: Rows of this rank's share.
        imbalance: Largest share over the mean.
    """

    def __init__(self, comm: MPI.Intracomm, count: int, block: int):
        self._comm, size = comm, comm.size
        had = np.concatenate([[0], np.cumsum(comm.allgather(count))])
        units = had[-1] // block
        gets = block * (np.arange(size + 1) * units // size)
        if np.diff(had).max() * size <= _EVEN * had[-1]:
            gets = had
        self._same = np.array_equal(had, gets)

        def overlaps(begin, end, parts):
            return np.maximum(np.minimum(end, parts[1:]) - np.maximum(begin, parts[:-1]), 0)

        rank = comm.rank
        self._out = overlaps(had[rank], had[rank + 1], gets)
        self._in = overlaps(gets[rank], gets[rank + 1], had)
        self.imbalance = float(np.diff(gets).max() * size / max(gets[-1], 1)) or 1.0
        self.owned = int(gets[rank + 1] - gets[rank])

    def shared_out(self, values: Array) -> Array:
        """Values in the rows that ranks have, in their shares. Collective."""
        return self._send(values, self._out, self._in)

    def given_back(self, values: Array) -> Array:
        """The inverse of `shared_out`. Collective."""
        return self._send(values, self._in, self._out)

    def _send(self, values: Array, out, into) -> Array:
        if self._same:
            return values
        result = np.empty(into.sum())
        self._comm.Alltoallv([np.ascontiguousarray(values), out], [result, into])
        return result
