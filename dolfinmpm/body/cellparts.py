"""Equal parts of cells; each part is a place for a material point."""

from __future__ import annotations

import functools
import itertools
import math
import os

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis.cells import BOX
from dolfinmpm.basis.linear import kind_of
from dolfinmpm.basis.refinement import Refinement
from dolfinmpm.body.familyids import ROOT_BITS, children_of, deepest
from dolfinmpm.grid.lattice import Lattice
from dolfinmpm.grid.leaves import leaves_of

__all__ = ["CellParts", "LatticeParts", "LeafParts", "Parts", "check_amount", "check_per_cell"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]
Lines = npt.NDArray[np.int32]
Numbers = npt.NDArray[np.int64]

# Points of a cell beyond which a number is a slip, and what a point takes at least (bytes)
_MOST_OF_A_CELL = 10_000
_BYTES = 300


def _owned(grid: Mesh) -> int:
    return grid.topology.index_map(grid.topology.dim).size_local


class Parts:
    """Parts of cells of this rank.

    Attributes:
        x: Centres of the parts (m), shape (n, gdim).
        volume: Volumes of the parts (m^d), shape (n,).
        cell: Local cells of the parts, shape (n,).
        key: Numbers that do not depend on the ranks, shape (n,).
    """

    x: Array
    volume: Array
    cell: npt.NDArray[np.int32]
    key: npt.NDArray[np.int64]

    def samples(self, rows: Rows, m: int) -> tuple[Array, Array]:
        """Centres and volumes of m^d pieces of some parts, shapes (rows, m^d, gdim), (rows, m^d).

        Args:
            rows: Rows of the parts.
            m: Pieces per direction.
        """
        raise NotImplementedError

    def half_lengths(self, rows: Rows, volume: Array, spread: Array | None = None) -> Array:
        """Half-lengths (m) of the domains of pieces of some parts, shape (rows, gdim).

        Args:
            rows: Rows of the parts.
            volume: Volumes of the pieces (m^d), shape (rows,).
            spread: Standard deviations of the positions in each piece along the axes (m), shape
                (rows, gdim); by default the pieces are whole parts.
        """
        raise NotImplementedError


class LatticeParts(Parts):
    """Boxes in the cells of a rectangular grid.

    Args:
        grid: Background grid.
        lattice: Lattice of the grid.
        n: Parts per cell and direction.
        low, high: Corners of a box (m) that cells must touch, or None for all cells.
    """

    def __init__(self, grid: Mesh, lattice: Lattice, n: int, low: Array | None, high: Array | None):
        gdim = len(lattice.lines)
        ijk = lattice.cell_ijk[: _owned(grid)]
        lower = np.column_stack([lattice.lines[d][ijk[:, d]] for d in range(gdim)])
        upper = np.column_stack([lattice.lines[d][ijk[:, d] + 1] for d in range(gdim)])
        near = np.ones(len(ijk), bool)
        if low is not None and high is not None:
            near = np.all((upper >= low) & (lower <= high), axis=1)
        cells = np.flatnonzero(near).astype(np.int32)
        place = np.asarray(np.ravel_multi_index(tuple(ijk[cells].T), lattice.shape), np.int64)
        self._divide(lower[cells], upper[cells], cells, place, n)

    def _divide(self, lower: Array, upper: Array, cells, place, n: int) -> None:
        """Divide boxes into n parts per direction.

        Args:
            lower, upper: Corners of the boxes (m), shape (boxes, gdim).
            cells: Local cell of the grid of each box.
            place: Number of each box that does not depend on the ranks.
            n: Parts per direction.
        """
        gdim = lower.shape[1]
        check_amount(len(cells) * n**gdim, n)
        parts = np.array(list(itertools.product(range(n), repeat=gdim)))
        size = (upper - lower)[:, None] / n
        self.low: Array = (lower[:, None] + parts * size).reshape(-1, gdim)
        self.high: Array = (lower[:, None] + (parts + 1) * size).reshape(-1, gdim)
        self.cell = np.repeat(cells, len(parts))
        self.key = (place[:, None] * len(parts) + np.arange(len(parts))).ravel()
        self.x = 0.5 * (self.low + self.high)
        self.volume = np.prod(self.high - self.low, axis=1)

    def samples(self, rows: Rows, m: int) -> tuple[Array, Array]:
        """See `Parts`."""
        low, size = self.low[rows, None], (self.high - self.low)[rows, None]
        x = low + _box_parts(m, self.x.shape[1]) * size
        return x, np.broadcast_to(self.volume[rows, None] / x.shape[1], x.shape[:2])

    def half_lengths(self, rows: Rows, volume: Array, spread: Array | None = None) -> Array:
        """Half-lengths in proportion to the piece, with the volume of the piece; see `Parts`."""
        if spread is None:
            return 0.5 * (self.high[rows] - self.low[rows])
        return 0.5 * spread * (volume / np.prod(spread, axis=1))[:, None] ** (1 / spread.shape[1])


class LeafParts(LatticeParts):
    """Boxes in the leaves of a refined space. Collective.

    A part of a leaf is a descendant of a part of a larger cell, as if that had split. So its points
    merge where leaves become larger. `key` has the number of the first ancestor, and the code of
    the descendant, see `dolfinmpm.body.familyids`, shape (n, 2).

    Args:
        refinement: The refinement.
        grid: Background grid.
        n: Parts per leaf and direction.
        low, high: Corners of a box (m) that leaves must touch, or None for all leaves.
    """

    def __init__(
        self, refinement: Refinement, grid: Mesh, n: int, low: Array | None, high: Array | None
    ):
        lattice = refinement.lattice
        own = lattice.cell_ijk[: _owned(grid)]
        ends = [(line[i], line[i + 1]) for line, i in zip(lattice.lines, own.T)]
        lower, upper = (np.column_stack(side) for side in zip(*ends))
        if low is not None and high is not None:
            # leaves beside the box would make smaller leaves in it than the body will have
            lower, upper = np.maximum(lower, low), np.minimum(upper, high)
        near = np.all(upper - lower > 1e-9 * lattice.spacing, axis=1)
        x, half = 0.5 * (lower + upper)[near], 0.5 * (upper - lower)[near]
        leaves = leaves_of(grid.comm, lattice, refinement.levels, x, half, refinement.wanted)
        root = leaves.low >> leaves.tree.levels
        local = np.full(lattice.shape, -1, np.int32)
        local[tuple(own.T)] = np.arange(len(own), dtype=np.int32)
        cells = local[tuple(root.T)]
        lower, upper = leaves.tree.corners(leaves.node)
        mine = cells >= 0
        if low is not None and high is not None:
            mine &= np.all((upper >= low) & (lower <= high), axis=1)
        rows = np.flatnonzero(mine)
        self._divide(lower[rows], upper[rows], cells[rows], rows.astype(np.int64), n)
        size = leaves.tree.size[leaves.node][rows]
        self.key = _descent(leaves.low[rows], size, leaves.tree.levels, lattice.shape, n)


def _descent(low: Lines, size: Lines, levels: int, shape: tuple[int, ...], n: int) -> Numbers:
    """First ancestor and code of each part of some leaves, shape (leaves n^d, 2).

    Args:
        low, size: Lowest lines and sizes of the leaves on the finest level, shapes (leaves, d) and
            (leaves,).
        levels: Largest number of times that a cell of the grid is halved.
        shape: Numbers of cells of the grid.
        n: Parts per leaf and direction.
    """
    gdim = low.shape[1]
    parts = np.array(list(itertools.product(range(n), repeat=gdim)))
    own: Numbers = low.astype(np.int64) // size[:, None]
    at: Numbers = (own[:, None] * n + parts).reshape(-1, gdim)
    level = np.repeat(levels - np.log2(size).astype(np.int64), len(parts))
    # such a part can split as often again
    known = np.minimum(level, deepest(gdim) // 2)
    code: Numbers = np.zeros(len(at), np.int64)
    for k in range(int(known.max(initial=0)))[::-1]:
        place = ((at >> k) & 1) @ (1 << np.arange(gdim)[::-1])
        code = np.where(k < known, children_of(code, place, gdim), code)
    # ancestors of two levels may have the same lowest corner
    first: Numbers = (at >> known[:, None]) << (known + levels - level)[:, None]
    counts = tuple(n * c << levels for c in shape)
    number = np.ravel_multi_index(tuple(first.T), counts) * (levels + 1) + level - known
    return np.stack([number, code >> ROOT_BITS], axis=1)


class CellParts(Parts):
    """Parts of equal size in reference coordinates, n^d per cell, on any straight-sided grid.

    Args:
        grid: Background grid.
        n: Parts per cell and direction.
        low, high: Corners of a box (m) that cells must touch, or None for all cells.
    """

    def __init__(self, grid: Mesh, n: int, low: Array | None, high: Array | None):
        self._n, self._gdim = n, grid.geometry.dim
        vertices = grid.geometry.x[:, : self._gdim][geometry_dofmap(grid)[: _owned(grid)]]
        near = np.ones(len(vertices), bool)
        if low is not None and high is not None:
            near = np.all((vertices.max(axis=1) >= low) & (vertices.min(axis=1) <= high), axis=1)
        cells = np.flatnonzero(near).astype(np.int32)
        check_amount(len(cells) * n**self._gdim, n)
        self._vertices = vertices[cells]
        self._box = kind_of(grid) == BOX
        xi = self._pieces(1)
        self._number = len(xi)
        self.cell = np.repeat(cells, self._number)
        original = np.asarray(grid.topology.original_cell_index, np.int64)[cells]
        self.key = (original[:, None] * self._number + np.arange(self._number)).ravel()
        rows = np.arange(len(self.cell))
        self.x = self._at(rows, xi)[0][:, 0]
        # two Gauss points per direction integrate the Jacobian of a straight-sided box
        inner = np.zeros((1, self._gdim))
        if self._box:
            ends = itertools.product((-1.0, 1.0), repeat=self._gdim)
            inner = np.array(list(ends)) / (2 * n * math.sqrt(3.0))
        self.volume = np.zeros(len(rows))
        for offset in inner:
            self.volume += self._at(rows, xi + offset)[1][:, 0] / len(inner)

    def _pieces(self, m: int) -> Array:
        """Reference centres of m^d pieces of each part of a cell, shape (parts, m^d, gdim)."""
        if not self._box:
            return _simplex_parts(self._n, m, self._gdim)
        parts, inner = _box_parts(self._n, self._gdim), _box_parts(m, self._gdim)
        return parts[:, None] + (inner - 0.5) / self._n

    def _at(self, rows: Rows, xi: Array) -> tuple[Array, Array]:
        """Positions, and volumes of equal pieces, at xi of shape (parts of a cell, q, gdim)."""
        gdim = self._gdim
        if self._box:
            bits = (np.arange(2**gdim)[:, None] >> np.arange(gdim)) & 1
            factors = np.where(bits, xi[..., None, :], 1 - xi[..., None, :])
            N, dN = np.prod(factors, axis=-1), np.empty(factors.shape)
            for j in range(gdim):
                others = np.delete(factors, j, axis=-1)
                dN[..., j] = np.where(bits[:, j], 1.0, -1.0) * np.prod(others, axis=-1)
            share = 1.0
        else:
            N = np.concatenate([1 - xi.sum(axis=-1, keepdims=True), xi], axis=-1)
            gradient = np.vstack([-np.ones(gdim), np.eye(gdim)])
            # the Jacobian of a simplex is the same everywhere
            dN = np.broadcast_to(gradient, (len(xi), 1, *gradient.shape))
            share = 1 / math.factorial(gdim)
        vertices, part = self._vertices[rows // self._number], rows % self._number
        x = np.einsum("rqa,rai->rqi", N[part], vertices)
        J = np.einsum("rqaj,rai->rqij", dN[part], vertices)
        volume = np.abs(np.linalg.det(J)) * share / (self._number * xi.shape[1])
        return x, np.broadcast_to(volume, x.shape[:2])

    def samples(self, rows: Rows, m: int) -> tuple[Array, Array]:
        """See `Parts`."""
        return self._at(rows, self._pieces(m))

    def half_lengths(self, rows: Rows, volume: Array, spread: Array | None = None) -> Array:
        """Half-lengths of a cube, because no basis averages over domains here; see `Parts`."""
        return np.repeat(0.5 * volume[:, None] ** (1 / self._gdim), self._gdim, axis=1)


def _box_parts(n: int, gdim: int) -> Array:
    line = (np.arange(n) + 0.5) / n
    return np.stack(np.meshgrid(*[line] * gdim, indexing="ij"), axis=-1).reshape(-1, gdim)


@functools.cache
def _simplex_parts(n: int, m: int, gdim: int) -> Array:
    """Centroids of m^d pieces of each of the n^d equal parts of the reference simplex.

    The cubes of a lattice are cut along the orderings of their coordinates
    (Freudenthal 1942); those parts that lie in 1 ≥ s_1 ≥ ... ≥ s_d ≥ 0 tile it, and
    such a lattice n m times as fine as the simplex refines one that is n times as fine.

    Returns:
        Shape (n^d, m^d, gdim).
    """
    s = []
    for cube in itertools.product(range(n * m), repeat=gdim):
        if any(a < b for a, b in itertools.pairwise(cube)):
            continue
        for order in itertools.permutations(range(gdim)):
            corner = np.array(cube, float)
            total = corner.copy()
            for axis in order:
                corner[axis] += 1
                total += corner
            centroid = total / (gdim + 1) / (n * m)
            if np.all(np.diff(np.concatenate([[1.0], centroid, [0.0]])) <= 0):
                s.append(centroid)
    fine = np.array(s)
    # the part that a piece is in: its cube, and the ordering of what is left of its coordinates
    cubes = np.floor(fine * n)
    orders = np.argsort(-(fine * n - cubes), axis=1, kind="stable")
    _, part = np.unique(np.hstack([cubes, orders]), axis=0, return_inverse=True)
    grouped = fine[np.argsort(part.ravel(), kind="stable")].reshape(n**gdim, m**gdim, gdim)
    return grouped - np.concatenate([grouped[..., 1:], np.zeros((*grouped.shape[:2], 1))], axis=-1)


def check_per_cell(per_cell: int, gdim: int) -> None:
    """Raise ParameterError if a cell would have too many points to be meant."""
    if per_cell > _MOST_OF_A_CELL or per_cell**gdim > _MOST_OF_A_CELL:
        many = f"{float(per_cell) ** gdim:.4g}" if per_cell < 1e100 else "far too many"
        raise ParameterError(
            f"per_cell = {shown(per_cell)} puts {many} points into each cell, and must not put "
            f"more than {_MOST_OF_A_CELL}; 2 to 4 a direction are usual: refine the grid"
        )


def check_amount(count: int, per_cell: int) -> None:
    """Raise ParameterError if this rank's memory does not hold so many points."""
    memory = _memory()
    if memory is not None and count * _BYTES > memory:
        raise ParameterError(
            f"per_cell = {per_cell} makes {count:.4g} points or parts of cells on one rank, which "
            f"take {count * _BYTES / 1e9:.4g} GB at least, and the machine has {memory / 1e9:.4g} "
            "GB: take fewer points per cell, a coarser grid, or more machines"
        )


def _memory() -> float | None:
    """Memory of this machine (bytes), or None where the system does not tell."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return None
