"""Location: the cell and the rank of a position, and points that move to them.

Points that cross a rank border move with every field that they carry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from dolfinx import geometry
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm._platform.errors import MigrationError, PointsOutsideGridError
from dolfinmpm.basis.cells import contained
from dolfinmpm.basis.linear import kind_of
from dolfinmpm.body.exchange import exchange
from dolfinmpm.grid.lattice import Lattice, lattice_of, once_per_grid, times_regridded
from dolfinmpm.grid.linecells import FAR, coordinate_rounding
from dolfinmpm.grid.partition import Partition

__all__ = [
    "Destinations",
    "bounds",
    "cells_here",
    "destinations",
    "migrate",
    "outside_cells",
    "use_configuration",
]

# A point on a facet belongs to either cell; rounding must not put it outside both.
_TOLERANCE = 1e-10


@numba.njit(cache=True, error_model="numpy")
def _cells(x, lines, starts, uniform, origin, table, shape, cells):
    """Local cells of positions; -1 outside the grid, or in cells that this rank does not know."""
    for p in range(x.shape[0]):
        at = 0
        for d in range(x.shape[1]):
            line = lines[starts[d] : starts[d + 1]]
            n, here = line.size - 1, x[p, d]
            length = line[n] - line[0]
            beyond = max(_TOLERANCE * length / n, FAR * max(abs(line[0]), abs(line[n])))
            if not (here >= line[0] - beyond and here <= line[n] + beyond):
                at = -1
                break
            # as `Lattice.cells_at` finds it
            if uniform:
                i = int(np.floor((here - line[0]) * (n / length)))
            else:
                i, end = -1, n + 1
                while end - i > 1:
                    middle = (i + end) // 2
                    if line[middle] <= here:
                        i = middle
                    else:
                        end = middle
            i = min(max(i, 0), n - 1) - origin[d]
            if i < 0 or i >= shape[d]:
                at = -1
                break
            at = at * shape[d] + i
        cells[p] = table[at] if at >= 0 else -1


class _LatticeLocator:
    """Cells of a rectangular grid by division."""

    def __init__(self, grid: Mesh, lattice: Lattice):
        self._lattice = lattice
        self._lines = np.concatenate(lattice.lines)
        self._starts = np.cumsum([0] + [line.size for line in lattice.lines])
        ijk = lattice.cell_ijk
        known = ijk if len(ijk) else np.zeros((1, len(lattice.lines)), np.int32)
        self._origin = known.min(axis=0)
        self._table = np.full(known.max(axis=0) + 1 - self._origin, -1, np.int32)
        self._table[tuple((ijk - self._origin).T)] = np.arange(len(ijk), dtype=np.int32)
        self._shape = np.array(self._table.shape, np.int64)

    def find(self, x, guess) -> npt.NDArray[np.int32]:
        cells = np.empty(len(x), np.int32)
        _cells(
            x, self._lines, self._starts, self._lattice.uniform, self._origin, self._table.ravel(),
            self._shape, cells,
        )  # fmt: skip
        return cells

    def holds(self, x, cells) -> npt.NDArray[np.bool_]:
        """Whether each position is in a given local cell."""
        inside = np.ones(len(x), bool)
        for d, line in enumerate(self._lattice.lines):
            slack = coordinate_rounding(line[0], line[-1], _TOLERANCE / (line.size - 1))
            at = self._lattice.cell_ijk[cells, d]
            inside &= (x[:, d] >= line[at] - slack) & (x[:, d] <= line[at + 1] + slack)
        return inside


class _MeshLocator:
    """Cells of any grid: first the point's last cell, then a search in the bounding-box tree."""

    def __init__(self, grid: Mesh):
        self._grid = grid
        self._vertices = geometry_dofmap(grid)
        self._gdim = grid.geometry.dim
        self._coordinates = np.ascontiguousarray(grid.geometry.x[:, : self._gdim])
        self._kind = kind_of(grid)
        self._tree: Any = None

    def holds(self, x, cells) -> npt.NDArray[np.bool_]:
        """Whether each position is in a given local cell; False for the cell -1."""
        result = np.empty(len(x), bool)
        contained(
            self._kind, self._vertices, self._coordinates, cells.astype(np.int32), x, _TOLERANCE,
            result,
        )  # fmt: skip
        return result

    def find(self, x, guess) -> npt.NDArray[np.int32]:
        cells = np.where(self.holds(x, guess), guess, -1).astype(np.int32)
        lost = np.flatnonzero((cells < 0) & np.isfinite(x).all(axis=1))
        if lost.size == 0 or len(self._vertices) == 0:
            return cells
        if self._tree is None:
            size = np.ptp(self._coordinates, axis=0).max()
            self._tree = geometry.bb_tree(
                self._grid, self._grid.topology.dim, padding=_TOLERANCE * size
            )
        padded = np.zeros((lost.size, 3))
        padded[:, : self._gdim] = x[lost]
        candidates = geometry.compute_collisions_points(self._tree, padded)
        owner = np.repeat(np.arange(lost.size), np.diff(candidates.offsets))
        hit = self.holds(np.ascontiguousarray(x[lost][owner]), candidates.array)
        # the smallest cell index wins: owned cells come before ghosts
        best = np.full(lost.size, np.iinfo(np.int32).max)
        np.minimum.at(best, owner[hit], candidates.array[hit])
        found = best < np.iinfo(np.int32).max
        cells[lost[found]] = best[found]
        return cells


@once_per_grid
def _locator(grid: Mesh) -> _LatticeLocator | _MeshLocator:
    lattice = lattice_of(grid)
    return _MeshLocator(grid) if lattice is None else _LatticeLocator(grid, lattice)


@once_per_grid
def bounds(grid: Mesh) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Lowest and highest coordinates of the grid (m), both of shape (gdim,). Collective."""
    x = grid.geometry.x[:, : grid.geometry.dim]
    low = np.min(grid.comm.allgather(x.min(axis=0, initial=np.inf)), axis=0)
    high = np.max(grid.comm.allgather(x.max(axis=0, initial=-np.inf)), axis=0)
    return low, high


def outside_cells(
    grid: Mesh, x: npt.NDArray[np.float64], cells: npt.NDArray[np.int32]
) -> npt.NDArray[np.intp]:
    """Rows of the positions that are not in the given cells.

    Args:
        grid: Background grid.
        x: Positions (m), shape (n, gdim).
        cells: Local cells, shape (n,).
    """
    return np.flatnonzero(~_locator(grid).holds(x, cells))


def cells_here(grid: Mesh, x: npt.NDArray[np.float64]) -> npt.NDArray[np.int32]:
    """Local cells of DOLFINx's mesh at positions (m), shape (n, gdim); -1 if not known here."""
    return _locator(grid).find(np.ascontiguousarray(x), np.full(len(x), -1, np.int32))


@dataclass(frozen=True)
class Destinations:
    """Ranks and cells of positions.

    Attributes:
        rank: Rank of each position, shape (n,); -1 outside the grid.
        cell: Global index of each cell, shape (n,); -1 outside the grid, or with a partition.
    """

    rank: npt.NDArray[np.int32]
    cell: npt.NDArray[np.int64]


def destinations(
    grid: Mesh,
    x: npt.NDArray[np.float64],
    guess: npt.NDArray[np.int32] | None = None,
    partition: Partition | None = None,
) -> Destinations:
    """Rank and cell of each position. Collective.

    Every position gets one rank. A position on a facet between ranks goes to the lowest rank that
    finds it in one of its own cells.

    Args:
        grid: Background grid.
        x: Positions (m), shape (n, gdim).
        guess: Local cells for the first search, shape (n,); -1 for none.
        partition: Rank that computes each cell; None for the owner in DOLFINx's mesh.
    """
    if partition is not None:
        lattice = lattice_of(grid)
        assert lattice is not None
        to = np.where(lattice.holds(x, _TOLERANCE), partition.rank_of(lattice.cells_at(x)), -1)
        return Destinations(to.astype(np.int32), np.full(len(x), -1, np.int64))
    comm = grid.comm
    cell_map = grid.topology.index_map(grid.topology.dim)
    first = cell_map.local_range[0]
    locator = _locator(grid)
    x = np.ascontiguousarray(x)
    if guess is None:
        guess = np.full(len(x), -1, np.int32)
    local = locator.find(x, guess)
    owned = (local >= 0) & (local < cell_map.size_local)
    ghost = local >= cell_map.size_local
    rank = np.full(len(x), -1, np.int32)
    cell = np.full(len(x), -1, np.int64)
    rank[owned], cell[owned] = comm.rank, first + local[owned]
    at = local[ghost] - cell_map.size_local
    rank[ghost], cell[ghost] = cell_map.owners[at], cell_map.ghosts[at]
    lost = np.flatnonzero(local < 0)
    counts = comm.allgather(lost.size)
    if comm.size == 1 or sum(counts) == 0:
        return Destinations(rank, cell)
    # few positions are unknown on this rank: all ranks search for these positions
    everyone = np.concatenate(comm.allgather(x[lost]))
    claimed = locator.find(everyone, np.full(len(everyone), -1, np.int32))
    mine = (claimed >= 0) & (claimed < cell_map.size_local)
    bids = np.array(comm.allgather(np.where(mine, first + claimed, -1)))
    winner = np.argmax(bids >= 0, axis=0)
    taken = bids.max(axis=0) >= 0
    here = slice(sum(counts[: comm.rank]), sum(counts[: comm.rank + 1]))
    rank[lost] = np.where(taken, winner, -1)[here]
    cell[lost] = np.where(taken, bids[winner, np.arange(taken.size)], -1)[here]
    return Destinations(rank, cell)


@stages.migrate
def migrate(points, to: Destinations) -> int:
    """Move points to the ranks that compute their cells. Collective.

    All fields of the points move. The number and the mass of the points on all ranks must be the
    same before and after.

    Args:
        points: Material points.
        to: Rank and cell of each point.

    Returns:
        Number of points that changed rank, over all ranks.

    Raises:
        MigrationError: Points or mass were lost or doubled.
    """
    comm, fields = points.comm, points.fields
    first = points.grid.topology.index_map(points.grid.topology.dim).local_range[0]
    moved = comm.allreduce(int(np.count_nonzero(to.rank != comm.rank)), op=MPI.SUM)
    before = _totals(points) if moved else None
    if moved:
        fields.update(exchange(comm, {**fields, "cell": to.cell}, to.rank))
        to_cell = fields["cell"]
    else:
        to_cell = to.cell
    if points.partition is None:
        fields["cell"] = (to_cell - first).astype(np.int32)
    else:
        x = points.placement(points.configuration).x
        fields["cell"] = cells_here(points.grid, x)
    if before is None:
        return 0
    after = _totals(points)
    if after[0] != before[0] or abs(after[1] - before[1]) > 1e-12 * abs(before[1]):
        raise MigrationError(
            f"migration changed the points from {before[0]:.0f} with mass {before[1]!r} kg to "
            f"{after[0]:.0f} with mass {after[1]!r} kg; please report this with mpm.info()"
        )
    return moved


def _totals(points) -> np.ndarray:
    mass = float(np.dot(points["density"], points["V0"]))
    return points.comm.allreduce(np.array([len(points), mass]), op=MPI.SUM)


def use_configuration(points, configuration: str) -> None:
    """Move points to the ranks and cells of the positions that a problem uses. Collective.

    Args:
        points: Material points.
        configuration: "updated" for present positions, "total" for first positions.

    Raises:
        PointsOutsideGridError: Positions lie outside the grid.
    """
    regridded, kept = times_regridded(points.grid), points.__dict__
    # the lines of the grid may have moved for other points
    if points.configuration == configuration and kept.get("_regridded", 0) == regridded:
        return
    kept["_regridded"] = regridded
    former, points.configuration = points.configuration, configuration
    try:
        points.locate()
    except PointsOutsideGridError:
        points.configuration = former
        raise
