"""Which rank computes which cell of a lattice, decided by where the work is.

DOLFINx distributes the grid evenly; a body fills a part of it only, and moves. On a lattice any
rank can number any node and cell, so that points, and what is owned at nodes and cells, are
distributed by the body, whoever has the cell in DOLFINx's mesh.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Partition", "bisected"]

Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Partition:
    """Parts of a lattice by recursive bisection, the same on all ranks.

    A cut is across one axis, and ends within a layer of cells, so that the parts on both sides
    have their shares to a cell.

    Attributes:
        shape: Number of cells of the lattice in each direction.
        ranks: Number of parts.
        axes: Axis of each cut, those of the lower part before those of the upper one.
        cuts: For each the number of the first cell beyond it, in the order of cells in which
            this axis counts most and the others in their order.
        imbalance: Largest part over mean, when it was made.
    """

    shape: tuple[int, ...]
    ranks: int
    axes: tuple[int, ...]
    cuts: tuple[int, ...]
    imbalance: float = 1.0

    @classmethod
    def restored(cls, kept: dict[str, Any]) -> Partition:
        """That of `dataclasses.asdict`, whose tuples may have become lists."""
        shape, axes, cuts = (tuple(kept[name]) for name in ("shape", "axes", "cuts"))
        return cls(shape, kept["ranks"], axes, cuts, kept["imbalance"])

    def rank_of(self, ijk: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
        """Ranks that compute cells.

        Args:
            ijk: Lattice positions of the cells, shape (n, gdim).

        Returns:
            Shape (n,).
        """
        ranks = np.zeros(len(ijk), np.int32)

        def visit(rows, at: int, first: int, end: int) -> None:
            if end - first == 1:
                ranks[rows] = first
                return
            middle = (first + end) // 2
            below = _number(ijk[rows], self.shape, self.axes[at]) < self.cuts[at]
            every = np.arange(len(ijk)) if isinstance(rows, slice) else rows
            visit(every[below], at + 1, first, middle)
            visit(every[~below], at + middle - first, middle, end)

        visit(slice(None), 0, 0, self.ranks)
        return ranks

    @functools.cache  # noqa: B019  one or two partitions live at a time
    def cells(self, rank: int) -> npt.NDArray[np.int32]:
        """Lattice positions of the cells that a rank computes, shape (n, gdim)."""
        every = np.indices(self.shape, np.int32).reshape(len(self.shape), -1).T
        return np.ascontiguousarray(every[self.rank_of(every) == rank])


def _number(ijk, shape: tuple[int, ...], axis: int) -> Ints:
    """Numbers of cells in the order in which an axis counts most."""
    order = [axis, *(d for d in range(len(shape)) if d != axis)]
    number = ijk[:, axis].astype(np.int64)
    for d in order[1:]:
        number = number * shape[d] + ijk[:, d]
    return number


def bisected(
    shape: tuple[int, ...], ranks: int, ijk: npt.NDArray[np.integer], weights: npt.NDArray
) -> Partition:
    """Parts of equal weight by recursive bisection across the longest side.

    Berger & Bokhari (1987, doi 10.1109/TC.1987.1676942), with cuts that end within a layer.

    Args:
        shape: Number of cells of the lattice in each direction.
        ranks: Number of parts.
        ijk: Lattice positions of the cells that have weights, shape (n, gdim).
        weights: The weights, shape (n,).
    """
    axes: list[int] = []
    cuts: list[int] = []
    largest = 0.0

    def visit(rows: Ints, first: int, end: int) -> None:
        nonlocal largest
        if end - first == 1:
            largest = max(largest, float(weights[rows].sum()))
            return
        middle = (first + end) // 2
        mine = ijk[rows]
        axis = int(np.argmax(np.ptp(mine, axis=0))) if rows.size else 0
        number = _number(mine, shape, axis)
        order = np.argsort(number)
        sums = np.concatenate([[0.0], np.cumsum(weights[rows[order]])])
        # the cell at which the lower part is nearest to its share
        at = int(np.argmin(np.abs(sums - sums[-1] * (middle - first) / (end - first))))
        axes.append(axis)
        cuts.append(int(number[order[at]]) if at < rows.size else int(np.prod(shape)))
        visit(rows[order[:at]], first, middle)
        visit(rows[order[at:]], middle, end)

    visit(np.arange(len(ijk)), 0, ranks)
    mean = float(weights.sum()) / ranks
    imbalance = largest / mean if mean else 1.0
    return Partition(tuple(shape), ranks, tuple(axes), tuple(cuts), imbalance)
