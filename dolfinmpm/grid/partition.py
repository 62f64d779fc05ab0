"""Distribution of the cells of a lattice over the ranks, by the work in the cells.

DOLFINx distributes the grid evenly. A body fills only a part of the grid, and it moves. On a
lattice any rank can number any node and cell. Points, nodes and cells are therefore distributed by
the body, and not by the owner of a cell in DOLFINx's mesh.
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

    A cut is normal to one axis. It may end inside a layer of cells, so that the parts on both
    sides have equal work up to one cell.

    Attributes:
        shape: Number of cells of the lattice in each direction.
        ranks: Number of parts.
        axes: Axis of each cut. Cuts of a lower part come before cuts of the upper part.
        cuts: For each cut, the number of the first cell behind it. Cells are numbered with the
            axis of the cut slowest, then the other axes in their order.
        imbalance: Work of the largest part over mean work, at the time of the bisection.
    """

    shape: tuple[int, ...]
    ranks: int
    axes: tuple[int, ...]
    cuts: tuple[int, ...]
    imbalance: float = 1.0

    @classmethod
    def restored(cls, kept: dict[str, Any]) -> Partition:
        """The partition from the result of `dataclasses.asdict`; tuples may be lists there."""
        shape, axes, cuts = (tuple(kept[name]) for name in ("shape", "axes", "cuts"))
        return cls(shape, kept["ranks"], axes, cuts, kept["imbalance"])

    def rank_of(self, ijk: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
        """Ranks that compute some cells, shape (n,).

        Args:
            ijk: Lattice positions of the cells, shape (n, gdim).
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
    """Numbers of cells, with the given axis slowest and the other axes in their order."""
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
    """Parts of equal weight, by recursive bisection (Berger & Bokhari 1987).

    Each cut is normal to the longest extent of the positions with at least half of the largest
    weight (doi 10.1109/TC.1987.1676942). Positions with equal coordinates along the axis are
    sorted by their other coordinates.

    Args:
        x: Positions, shape (n, gdim).
        weights: Weights of the positions, not negative, shape (n,).
        parts: Number of parts.
        cut: Function that is called for each cut, with the axis and the number of the first
            position behind the cut, or None if no position is behind it. Cuts of a lower part
            come before cuts of the upper part.

    Returns:
        Part of each position, shape (n,).
    """
    part = np.zeros(len(x), np.int32)

    def split(chosen: npt.NDArray[np.intp], first: int, count: int) -> None:
        if count == 1:
            part[chosen] = first
            return
        positions, weight = x[chosen], weights[chosen]
        heavy = positions[weight >= 0.5 * weight.max(initial=0.0)]
        axis = int(np.argmax(np.ptp(heavy, axis=0))) if len(heavy) else 0
        others = [positions[:, d] for d in range(positions.shape[1] - 1, -1, -1) if d != axis]
        order = np.lexsort((*others, positions[:, axis]))
        low, sums = count // 2, np.concatenate([[0.0], np.cumsum(weight[order])])
        # cut where the weight of the lower part is nearest to its share
        at = int(np.argmin(np.abs(sums - sums[-1] * low / count)))
        cut(axis, int(chosen[order[at]]) if at < chosen.size else None)
        split(chosen[order[:at]], first, low)
        split(chosen[order[at:]], first + low, count - low)

    split(np.arange(len(x)), 0, parts)
    return part


def partition_of(
    shape: tuple[int, ...], ranks: int, ijk: npt.NDArray[np.integer], weights: npt.NDArray
) -> Partition:
    """Partition of a lattice into parts of equal weight, see `bisected`.

    Args:
        shape: Number of cells of the lattice in each direction.
        ranks: Number of parts.
        ijk: Lattice positions of the cells with weights, shape (n, gdim).
        weights: Weights of these cells, shape (n,).
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
