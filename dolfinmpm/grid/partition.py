"""Which rank computes which cell of a lattice, decided by where the work is.

DOLFINx distributes the grid evenly; a body fills a part of it only, and moves. On a lattice any
rank can number any node and cell, so that points, and what is owned at nodes and cells, are
distributed by the body, whoever has the cell in DOLFINx's mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Partition", "bisected", "partition_of"]

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
    x: npt.NDArray,
    weights: npt.NDArray,
    parts: int,
    cut: Callable[[int, int | None], None] = lambda axis, beyond: None,
) -> npt.NDArray[np.int32]:
    """Parts of equal weight, by recursive bisection across the longest side of what weighs most.

    Berger & Bokhari (1987, doi 10.1109/TC.1987.1676942); those in line along a cut are told apart
    by their other coordinates.

    Args:
        x: Positions, shape (n, gdim).
        weights: Their weights, not negative, shape (n,).
        parts: Number of parts.
        cut: Told of each cut, those of a lower part before those of the upper one: its axis, and
            the first position beyond it, None if there is none.

    Returns:
        Part of each, shape (n,).
    """
    part = np.zeros(len(x), np.int32)

    def split(chosen: npt.NDArray[np.intp], first: int, count: int) -> None:
        if count == 1:
            part[chosen] = first
            return
        here, heavy = x[chosen], weights[chosen]
        most = here[heavy >= 0.5 * heavy.max(initial=0.0)]
        axis = int(np.argmax(np.ptp(most, axis=0))) if len(most) else 0
        others = [here[:, d] for d in range(here.shape[1] - 1, -1, -1) if d != axis]
        order = np.lexsort((*others, here[:, axis]))
        low, sums = count // 2, np.concatenate([[0.0], np.cumsum(heavy[order])])
        # where the lower part is nearest to its share
        at = int(np.argmin(np.abs(sums - sums[-1] * low / count)))
        cut(axis, int(chosen[order[at]]) if at < chosen.size else None)
        split(chosen[order[:at]], first, low)
        split(chosen[order[at:]], first + low, count - low)

    split(np.arange(len(x)), 0, parts)
    return part


def partition_of(
    shape: tuple[int, ...], ranks: int, ijk: npt.NDArray[np.integer], weights: npt.NDArray
) -> Partition:
    """Parts of a lattice that share out what its cells weigh, see `bisected`.

    Args:
        shape: Number of cells of the lattice in each direction.
        ranks: Number of parts.
        ijk: Lattice positions of the cells that have weights, shape (n, gdim).
        weights: The weights, shape (n,).
    """
    axes: list[int] = []
    cuts: list[int] = []

    def note(axis: int, beyond: int | None) -> None:
        axes.append(axis)
        last = int(np.prod(shape))
        cuts.append(last if beyond is None else int(_number(ijk[[beyond]], shape, axis)[0]))

    shares = np.bincount(bisected(ijk, weights, ranks, note), weights, minlength=ranks)
    mean = shares.mean()
    imbalance = float(shares.max() / mean) if mean else 1.0
    return Partition(tuple(shape), ranks, tuple(axes), tuple(cuts), imbalance)
