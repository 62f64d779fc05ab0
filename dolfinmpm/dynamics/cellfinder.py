"""Cells of points on a lattice, and their order."""

from __future__ import annotations

import numba
import numpy as np
from mpi4py import MPI

from dolfinmpm.basis import LatticeBasis
from dolfinmpm.body.loadbalance import balance
from dolfinmpm.body.points import MaterialPoints

__all__ = ["CellFinder", "extent"]


@numba.njit(cache=True, error_model="numpy")
def _cells(x, lines, start, scale, origin, table, shape, cell):
    """Find local cells of the points; returns the number of points without a known cell."""
    lost = 0
    d = x.shape[1]
    for p in range(x.shape[0]):
        at = 0
        for k in range(d):
            number = start[k + 1] - start[k] - 1
            i = min(max(int((x[p, k] - lines[start[k]]) * scale[k]), 0), number - 1) - origin[k]
            if i < 0 or i >= shape[k]:
                at = -1
                break
            at = at * shape[k] + i
        found = table[at] if at >= 0 else -1
        cell[p] = found
        if found < 0:
            lost += 1
    return lost


@numba.njit(cache=True, error_model="numpy")
def extent(values):
    """Smallest and largest value of each column, shape (2, columns), of at least one row."""
    found = np.empty((2, values.shape[1]))
    for k in range(values.shape[1]):
        low = high = values[0, k]
        for p in range(values.shape[0]):
            low, high = min(low, values[p, k]), max(high, values[p, k])
        found[0, k], found[1, k] = low, high
    return found


# Steps after which points are sorted by cells again
_SORT = 256


class CellFinder:
    """Cells of points by their positions.

    Args:
        basis: Basis on the lattice. Its overlap of ranks gives the known cells.

    Attributes:
        steps: Steps since the last sorting of the points.
    """

    def __init__(self, basis: LatticeBasis):
        lines, halo = basis.lattice.lines, basis.halo
        self.steps = _SORT
        self._lines, self._origin = lines, halo.origin
        self._flat = np.concatenate(lines)
        self._starts = np.cumsum([0] + [line.size for line in lines])
        self._scale = np.array([(x.size - 1) / (x[-1] - x[0]) for x in lines])
        self._table = halo.cell_table.ravel()
        self._shape = np.array(halo.cell_table.shape, np.int64)
        self._owned = basis.cells.owned

    def sort(self, points: MaterialPoints) -> None:
        """Sort the points by cells, if a sorting is due. Collective."""
        if self.steps < _SORT:
            return
        self.steps = 0
        key = np.zeros(len(points), np.int64)
        for k, line in enumerate(self._lines):
            i = ((points["x"][:, k] - line[0]) * self._scale[k]).astype(np.int64)
            key = key * line.size + i
        # a revision is common to all ranks, because operations after it are collective
        if points.comm.allreduce(bool(np.all(np.diff(key) >= 0)), op=MPI.LAND):
            return
        order = np.argsort(key, kind="stable")
        for name, values in points.fields.items():
            points.fields[name] = values[order]
        points.revision += 1

    def settle(self, points: MaterialPoints) -> int:
        """Update cells and ranks of the points; returns how many changed rank. Collective."""
        lost = _cells(
            points["x"], self._flat, self._starts, self._scale, self._origin, self._table,
            self._shape, points["cell"],
        )  # fmt: skip
        if points.comm.size == 1:
            points._located = points["x"].sum()
            return 0
        away = lost > 0 or bool(np.any(points["cell"] >= self._owned))
        if points.partition is not None:
            # these were numbers in the old overlap of ranks
            points["cell"][:] = -1
        if not points.comm.allreduce(away, op=MPI.LOR):
            points._located = points["x"].sum()
            return 0
        points["cell"][points["cell"] < 0] = 0
        return points.locate() + balance(points)
