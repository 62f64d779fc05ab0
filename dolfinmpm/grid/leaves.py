"""Leaves: cells of a rectangular grid that are split where finer cells are wanted.

Leaves exist only where domains of points overlap them. Neighbouring leaves, across sides, edges and
corners, differ by one level at most. All ranks hold the same leaves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import PointsOutsideGridError, raise_together
from dolfinmpm.grid.lattice import Lattice
from dolfinmpm.grid.leafsearch import ROOM, mark_touched, nodes_at, overlaps_of, too_coarse
from dolfinmpm.grid.linecells import relative_rounding

__all__ = ["Leaves", "Tree", "Wanted", "leaves_of"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]
# A split cell is joined again only where cells larger by this factor are wanted
HYSTERESIS = 1.25
# Function of the lower and the upper corners of cells (m) that returns the sizes wanted there (m).
# All ranks call it together with the same cells, and it returns the same sizes on all of them.
Wanted = Callable[[Array, Array], Array]


@dataclass(eq=False)
class Tree:
    """Cells of a rectangular grid, and their children.

    Attributes:
        lattice: The grid.
        levels: Largest number of times that a root is halved.
        low: Numbers of the lowest lines of each cell on the finest level, shape (cells, gdim).
        size: Number of the finest cells per direction, shape (cells,).
        child: First child of each cell, -1 for a leaf; its 2^d children follow each other.
    """

    lattice: Lattice
    levels: int
    low: Ints
    size: Ints
    child: Ints

    @classmethod
    def roots(cls, lattice: Lattice, levels: int) -> Tree:
        """The tree of roots alone."""
        gdim = len(lattice.shape)
        every = np.indices(lattice.shape, np.int32).reshape(gdim, -1).T
        low = np.ascontiguousarray(every << levels)
        whole = np.full(len(low), 1 << levels, np.int32)
        return cls(lattice, levels, low, whole, np.full(len(low), -1, np.int32))

    @property
    def search(self) -> tuple:
        """Arguments of the compiled search."""
        lines = np.concatenate(self.lattice.lines)
        start = np.cumsum([0, *(line.size for line in self.lattice.lines)])
        shape = np.array(self.lattice.shape, np.int64)
        return lines, start, self.levels, shape, self.low, self.size, self.child

    def split(self, chosen: npt.NDArray[np.bool_]) -> None:
        """Give children to some leaves."""
        rows, gdim = np.flatnonzero(chosen & (self.child < 0)), self.low.shape[1]
        each = 1 << gdim
        offsets = np.array(list(np.ndindex(*(2,) * gdim)), np.int32)
        half = self.size[rows] >> 1
        low = self.low[rows][:, None] + offsets * half[:, None, None]
        self.child[rows] = len(self.low) + each * np.arange(rows.size, dtype=np.int32)
        self.low = np.vstack([self.low, low.reshape(-1, gdim)]).astype(np.int32)
        self.size = np.concatenate([self.size, np.repeat(half, each)]).astype(np.int32)
        self.child = np.concatenate([self.child, np.full(each * rows.size, -1, np.int32)])

    def coordinates(self, fine: Ints) -> Array:
        """Coordinates (m) of lines of the finest level, shape (n, gdim)."""
        columns = []
        for line, k in zip(self.lattice.lines, fine.T):
            i, f = k >> self.levels, k & ((1 << self.levels) - 1)
            width = np.diff(line, append=line[-1])
            columns.append(line[i] + width[i] * (f / (1 << self.levels)))
        return np.column_stack(columns)

    def corners(self, rows: npt.NDArray[np.integer]) -> tuple[Array, Array]:
        """Lower and upper corners of cells (m), both of shape (n, gdim)."""
        low = self.low[rows]
        return self.coordinates(low), self.coordinates(low + self.size[rows, None])


@dataclass(frozen=True, eq=False)
class Leaves:
    """Leaves that domains overlap, in the order of their lowest corners.

    Attributes:
        tree: The tree.
        node: Cell of the tree of each leaf, shape (leaves,).
        number: Leaf of each cell of the tree, -1 for other cells, shape (cells,).
    """

    tree: Tree
    node: Ints
    number: Ints

    @classmethod
    def of(cls, tree: Tree, rows: npt.NDArray[np.integer]) -> Leaves:
        """The leaves among the cells of a tree that stand in some rows."""
        node = rows[np.lexsort(tree.low[rows].T[::-1])].astype(np.int32)
        number = np.full(len(tree.low), -1, np.int32)
        number[node] = np.arange(node.size, dtype=np.int32)
        return cls(tree, node, number)

    @classmethod
    def restored(cls, lattice: Lattice, levels: int, low: Ints, size: Ints) -> Leaves:
        """The leaves with these lowest lines and sizes."""
        tree = Tree.roots(lattice, levels)
        node = np.empty(len(low), np.int32)
        while True:
            _, _, *search = tree.search
            nodes_at(low, *search, node)
            chosen = np.zeros(len(tree.low), bool)
            chosen[node[tree.size[node] > size]] = True
            if not chosen.any():
                return cls.of(tree, node)
            tree.split(chosen)

    @property
    def low(self) -> Ints:
        """Lowest lines of the leaves on the finest level, shape (leaves, gdim)."""
        return self.tree.low[self.node]

    @property
    def size(self) -> Ints:
        """Number of the finest cells per direction, shape (leaves,)."""
        return self.tree.size[self.node]

    def same(self, other: Leaves | None) -> bool:
        """Whether these are the same leaves."""
        return (
            other is not None
            and np.array_equal(self.low, other.low)
            and np.array_equal(self.size, other.size)
        )

    def overlapped(self, x: Array, half: Array) -> tuple[npt.NDArray[np.int64], Ints]:
        """Leaves of each domain.

        Args:
            x, half: Positions and half-lengths (m), shape (n, gdim).

        Returns:
            First entry of every domain, shape (n + 1,), and the leaves; -1 where no leaf is.
        """
        search = self.tree.search
        x, half = np.ascontiguousarray(x), np.ascontiguousarray(half)
        count, begin = np.zeros(len(x), np.int64), np.zeros(len(x) + 1, np.int64)
        overlaps_of(x, half, *search, count, begin, np.empty(0, np.int64))
        np.cumsum(count, out=begin[1:])
        nodes = np.empty(begin[-1], np.int64)
        if nodes.size:
            overlaps_of(x, half, *search, count, begin, nodes)
        return begin, self.number[nodes]

    def smallest(self, x: Array, half: Array) -> Array:
        """Shortest edge of the leaves of each domain (m), shape (n,); see `overlapped`."""
        begin, leaf = self.overlapped(x, half)
        low, high = self.tree.corners(self.node)
        edge = (high - low).min(axis=1)
        result = np.full(len(x), np.inf)
        of, known = np.repeat(np.arange(len(x)), np.diff(begin)), leaf >= 0
        np.minimum.at(result, of[known], edge[leaf[known]])
        return result


def leaves_of(
    comm: MPI.Intracomm,
    lattice: Lattice,
    levels: int,
    x: Array,
    half: Array,
    wanted: Wanted,
    former_leaves: Leaves | None = None,
) -> Leaves:
    """The leaves for some domains. Collective; all ranks get the same leaves.

    A cell is split while a smaller size is wanted in it.

    Args:
        comm: Communicator.
        lattice: The grid of the roots.
        levels: Largest number of times that a root is halved.
        x, half: Positions and half-lengths of the domains on this rank (m), shape (n, gdim).
        wanted: Function of the corners of cells that returns the sizes wanted there (m).
        former_leaves: Those of the last step, or None. Cells that were split stay split unless
            cells larger by `HYSTERESIS` are wanted.

    Raises:
        PointsOutsideGridError: A domain overlaps too many leaves.
    """
    tree, close = Tree.roots(lattice, levels), relative_rounding(lattice.lines, 2.0**-levels)
    x, half = np.ascontiguousarray(x), np.ascontiguousarray(half)
    for level in range(levels):
        touched = _touched(comm, tree, x, half)
        rows = np.flatnonzero(touched & (tree.child < 0) & (tree.size == 1 << (levels - level)))
        low, high = tree.corners(rows)
        edge = np.prod(high - low, axis=1) ** (1 / low.shape[1])
        chosen = np.zeros(len(tree.low), bool)
        if rows.size:
            size = wanted(low, high)
            if former_leaves is not None:
                _, _, *search = former_leaves.tree.search
                former = np.empty(rows.size, np.int32)
                nodes_at(tree.low[rows], *search, former)
                was_split = former_leaves.tree.size[former] < tree.size[rows]
                size = np.where(was_split, size / HYSTERESIS, size)
            chosen[rows] = size < edge * (1 - close)
        if not chosen.any():
            break
        tree.split(chosen)
    touched = _touched(comm, tree, x, half)
    while True:
        rows, chosen = np.flatnonzero(touched & (tree.child < 0)), np.zeros(len(tree.low), bool)
        _, _, *search = tree.search
        if not too_coarse(rows, *search, touched, chosen):
            break
        tree.split(chosen)
        touched = _touched(comm, tree, x, half)
    return Leaves.of(tree, rows)


def _touched(comm: MPI.Intracomm, tree: Tree, x: Array, half: Array) -> npt.NDArray[np.bool_]:
    """Mask of the leaves that domains of any rank overlap. Collective."""
    touched = np.zeros(len(tree.low), bool)
    worst = mark_touched(x, half, *tree.search, touched)
    error = None
    if worst >= 0:
        error = PointsOutsideGridError(
            f"the domain of the point at {x[worst]} m overlaps more than {ROOM} leaves; its "
            f"half-lengths are {half[worst]} m: split the points (problem.adapt()), or want "
            "larger cells"
        )
    raise_together(comm, error)
    if comm.size > 1:
        comm.Allreduce(MPI.IN_PLACE, touched, op=MPI.LOR)
    return touched
