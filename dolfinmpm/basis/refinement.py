"""Refined spaces: which sizes of cells are wanted where, and the basis on the leaves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import shown, whole
from dolfinmpm._platform.errors import (
    IdleConditionWarning,
    ParameterError,
    call_together,
    warn,
)
from dolfinmpm.basis.latticebasis import LatticeBasis
from dolfinmpm.basis.leafbasis import LeafBasis
from dolfinmpm.basis.stencils import Placement
from dolfinmpm.grid.lattice import Lattice, require_lattice
from dolfinmpm.grid.leaves import Leaves, Tree, leaves_of
from dolfinmpm.grid.linecells import relative_rounding
from dolfinmpm.grid.partition import Partition
from dolfinmpm.grid.userfunctions import call_function

__all__ = [
    "MOST_LEVELS",
    "CellSize",
    "Refinement",
    "SizeAt",
    "leaves_on",
    "refinement_of",
    "refinements_on",
]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]
# Lines of the finest level are 32-bit numbers
MOST_LEVELS = 10


@runtime_checkable
class CellSize(Protocol):
    """A size of cells that is wanted somewhere; see `dolfinmpm.near`."""

    def wanted(self, low: Array, high: Array) -> Array:
        """Sizes wanted in cells (m), shape (n,); infinite where any size will do.

        Args:
            low, high: Corners of the cells (m), shape (n, gdim).
        """


class SizeAt:
    """A function of position as the size wanted.

    It is evaluated at the corners, the middles of the sides and the centre of every cell.

    Args:
        size: Function of positions (m), shape (gdim, n), that returns n sizes (m).
    """

    told = "a function"

    def __init__(self, size: Callable[[Array], Any]):
        self._size = size

    def wanted(self, low: Array, high: Array) -> Array:
        """See `CellSize`."""
        gdim = low.shape[1]
        t = 0.5 * np.array(list(np.ndindex(*(3,) * gdim)))
        x = low[:, None] + t * (high - low)[:, None]
        sizes = call_function("the size wanted (refine)", self._real, x.reshape(-1, gdim))
        wrong = ~(sizes >= 0)
        if wrong.any():
            k = int(np.argmax(wrong))
            raise ParameterError(
                f"the size wanted (refine) is {sizes[k]:g} m at {shown(x.reshape(-1, gdim)[k])}: "
                "it must be a length; inf takes cells as large as those of the grid"
            )
        return np.asarray(sizes.reshape(len(low), -1).min(axis=1))

    def _real(self, x: Array) -> Any:
        """Answer of the function at positions (m), shape (gdim, n)."""
        answer = self._size(x)
        sizes = np.asarray(answer)
        if sizes.dtype.kind in "bc" and sizes.size:
            raise ParameterError(
                f"the size wanted (refine) is {sizes.flat[0]} at {shown(x[:, 0])}: give sizes in "
                "m, such as np.where(x[0] < 1, 0.25, np.inf)"
            )
        return answer


def _sizes_of(one: CellSize, low: Array, high: Array) -> Array:
    """Sizes wanted by one of them (m), shape (n,), checked; see `CellSize`."""
    sizes = np.asarray(one.wanted(low, high), float)
    if sizes.shape != (len(low),) or not (sizes >= 0).all():
        raise ParameterError(
            f"{type(one).__name__}.wanted returned {shown(sizes)} for {len(low)} cells: it must "
            "return a size for each cell; inf takes cells as large as those of the grid"
        )
    return sizes


def _sizes(given: Any, gdim: int) -> tuple[CellSize, ...]:
    """The sizes wanted on a grid of that dimension, as a tuple of `CellSize`."""
    every = given if isinstance(given, (tuple, list)) else (given,)
    if not every:
        raise ParameterError("refine = [] has no size: leave refine and levels out for one size")
    made: list[CellSize] = []
    for one in every:
        if isinstance(one, CellSize):
            made.append(one)
        elif callable(one):
            made.append(SizeAt(one))
        else:
            raise ParameterError(
                f"refine = {shown(given)} must be a function of positions that returns sizes (m), "
                "mpm.near(body, size), mpm.where_it_yields(points, size), or a list of these"
            )
        own = getattr(one, "gdim", gdim)
        if own != gdim:
            raise ParameterError(
                f"refine = {getattr(one, 'told', shown(one))} is for {own} dimensions, and the "
                f"grid has {gdim}: take a body, or points, of {gdim} dimensions"
            )
    return tuple(made)


class Refinement:
    """Sizes wanted for cells, and the leaves of the present step. Spaces may share it.

    Args:
        grid: Background grid, rectangular: the roots.
        sizes: The sizes wanted; the least one counts.
        levels: Largest number of times that a root is halved.

    Attributes:
        sizes, levels: The arguments.
        leaves: The leaves of the last activation, or None.
    """

    def __init__(self, grid: Mesh, sizes: Sequence[CellSize], levels: int):
        self._grid, self.sizes, self.levels = grid, tuple(sizes), levels
        self.leaves: Leaves | None = None
        self._former: Leaves | None = None
        self._seen = False
        self._bases: dict[tuple[int, int], tuple[Partition | None, LeafBasis]] = {}

    @property
    def depth(self) -> int:
        """Levels that the sizes wanted can reach, at most `levels`."""
        least = min(getattr(one, "least", 0.0) for one in self.sizes)
        if least <= 0.0:
            return self.levels
        edge = max(np.diff(line).max() for line in self.lattice.lines)
        close = relative_rounding(self.lattice.lines)
        return min(self.levels, max(0, math.ceil(math.log2(edge / least) - close)))

    @property
    def lattice(self) -> Lattice:
        """The grid of the roots."""
        return require_lattice(self._grid, "refine")

    def wanted(self, low: Array, high: Array) -> Array:
        """Sizes wanted in cells (m), shape (n,); see `CellSize`. Collective.

        All ranks ask for the same cells. The least size of all ranks counts, because a function may
        depend on the points of its rank.

        Raises:
            ParameterError: A function fails on any rank, or does not return sizes.
        """
        comm = self._grid.comm
        size = np.full(len(low), np.inf)
        for one in self.sizes:
            # one after the other: some of them are collective, and all ranks must reach them
            found = call_together(comm, partial(_sizes_of, one, low, high))
            size = np.minimum(size, found)
        if comm.size > 1:
            comm.Allreduce(MPI.IN_PLACE, size, op=MPI.MIN)
        return size

    def hold(self) -> None:
        """Let cells that are split now stay split unless clearly larger ones are wanted."""
        self._former = self.leaves

    def regrid(self) -> None:
        """Forget all leaves: the grid's lines have moved, and leaves keep those of their time."""
        self._former, self.leaves, self._bases = None, None, {}

    def state(self) -> dict[str, Any]:
        """The former leaves, as lowest lines and sizes, and `levels`; the same on all ranks."""
        if self._former is None:
            return {}
        return {"low": self._former.low, "size": self._former.size, "levels": self.levels}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`, also one of other `levels`."""
        self.regrid()
        if "low" in values:
            low, size = (np.asarray(values[name], np.int32) for name in ("low", "size"))
            more = self.levels - int(values.get("levels", self.levels))
            self._former = Leaves.restored(self.lattice, self.levels, *_rescaled(low, size, more))

    @property
    def told(self) -> str:
        """The levels and the sizes wanted, in words."""
        sizes = ", ".join(getattr(one, "told", type(one).__name__) for one in self.sizes)
        return f"levels = {self.levels}, refine = {sizes}"

    def update_leaves(self, where: Placement, averaged: bool) -> Leaves:
        """The leaves for some points. Collective.

        Args:
            where: The points.
            averaged: Whether functions are averaged over the domains of the points.
        """
        half = where.half if averaged else np.zeros_like(where.half)
        comm = self._grid.comm
        made = leaves_of(comm, self.lattice, self.levels, where.x, half, self.wanted, self._former)
        first, self._seen = not self._seen, True
        if first and (made.size == 1 << self.levels).all():
            self._warn_of_idle()
        if not made.same(self.leaves):
            self.leaves, self._bases = made, {}
        assert self.leaves is not None
        return self.leaves

    def _warn_of_idle(self) -> None:
        """Warn of sizes that are larger than the cells of the grid everywhere. Collective.

        Sizes equal to those of the cells are meant, as by scripts that go through sizes. Those that
        a function leaves infinite everywhere may become finite later.
        """
        comm, tree = self._grid.comm, Tree.roots(self.lattice, self.levels)
        low, high = tree.corners(np.arange(len(tree.low)))
        edge = np.prod(high - low, axis=1) ** (1 / low.shape[1])
        largest = edge * (1 + relative_rounding(self.lattice.lines, 2.0**-self.levels))
        for one in self.sizes:
            size: Array = np.full(len(low), getattr(one, "least", np.inf))
            if not hasattr(one, "least"):
                size = call_together(comm, partial(_sizes_of, one, low, high))
            found = np.array([size.min(), -float((size <= largest).any())])
            comm.Allreduce(MPI.IN_PLACE, found, op=MPI.MIN)
            if np.isfinite(found[0]) and not found[1]:
                told = getattr(one, "told", type(one).__name__)
                warn(
                    comm,
                    f"refine = {told} refines nothing: the least size that it wants is "
                    f"{found[0]:.4g} m, and cells of the grid are {edge.max():.4g} m wide. Give "
                    f"sizes below {edge.max():.4g} m, in the unit of the grid (m), or leave "
                    "refine and levels out",
                    IdleConditionWarning,
                )

    def basis(self, base: LatticeBasis, layers: int, partition: Partition | None) -> LeafBasis:
        """The basis on the present leaves. The same arguments return the same object.

        Args:
            base: Basis of the same functions on the roots.
            layers: Layers of roots, around this rank's own roots, that it knows.
            partition: Which rank computes a root.
        """
        assert self.leaves is not None
        key = id(base), layers
        if key not in self._bases or self._bases[key][0] is not partition:
            self._bases[key] = partition, LeafBasis(base, self.leaves, layers, partition)
        return self._bases[key][1]


def _rescaled(low: Ints, size: Ints, more: int) -> tuple[Ints, Ints]:
    """Lowest lines and sizes of leaves, in lines of another finest level.

    Leaves finer than that level become the cell of that level that they are in.

    Args:
        low: Lowest lines, shape (n, gdim).
        size: Numbers of finest cells per direction, shape (n,).
        more: Levels of the result less those of the arguments.

    Returns:
        Lowest lines, shape (m, gdim), and sizes, shape (m,).
    """
    if more >= 0:
        return low << more, size << more
    low, first = np.unique(low >> -more, axis=0, return_index=True)
    return low, np.maximum(size[first] >> -more, 1).astype(np.int32)


def refinement_of(grid: Mesh, refine: Any, levels: Any) -> Refinement | None:
    """The refinement with these arguments; equal arguments on a grid return the same object.

    Args:
        grid: Background grid.
        refine: The sizes wanted; see `dolfinmpm.Space`.
        levels: Largest number of times that a cell of the grid is halved.

    Returns:
        The refinement, or None with `levels` = 0.

    Raises:
        ParameterError: An argument is not valid.
        UnsupportedGridError: The grid is not rectangular.
    """
    sizes = _sizes(refine, grid.geometry.dim)
    if whole("levels", levels, 0) == 0:
        return None
    require_lattice(grid, "refine")
    if levels > MOST_LEVELS:
        raise ParameterError(
            f"levels = {levels} must be at most {MOST_LEVELS}: give the grid smaller cells"
        )
    every = refine if isinstance(refine, (tuple, list)) else (refine,)
    known = grid.__dict__.setdefault("_dolfinmpm_refinements", {})
    key = (levels, *(id(one) for one in every))
    if key not in known:
        # the arguments stay alive with the result, so that their ids stay theirs
        known[key] = every, Refinement(grid, sizes, levels)
    return known[key][1]


def refinements_on(grid: Mesh) -> list[Refinement]:
    """The refinements of all spaces of a grid, in the order in which they were made."""
    return [made for _, made in grid.__dict__.get("_dolfinmpm_refinements", {}).values()]


def leaves_on(grid: Mesh) -> Leaves | None:
    """The present leaves of the last refined space of a grid, for pictures; None without any."""
    found = [made.leaves for made in refinements_on(grid) if made.leaves is not None]
    return found[-1] if found else None
