"""Whether points have room in the cells that they fill: bodies must not overlap by mistake."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.location import bounds
from dolfinmpm.grid.lattice import cell_size, lattice_of, mean_size

if TYPE_CHECKING:
    from dolfinx.mesh import Mesh

    from dolfinmpm.body.points import MaterialPoints

__all__ = ["check_room", "check_room_of_both"]

Array = npt.NDArray[np.float64]

# Shares of a cell by which points may overfill it: by so much parts whose centres are inside a
# shape miss its surface, or at least by so much of the largest point
_EXCESS, _POINT = 0.3, 0.6
# and where boxes of the size of cells stand for cells of other kinds, whose points are no boxes
_EXCESS_OF_BOXES = 0.6
# cells of an axis that a domain is looked for in
_MOST = 16


@numba.njit(cache=True, error_model="numpy")
def _spread(x, half, volume, lines, start, origin, shape, out):
    """Add each point's volume to the cells that its domain overlaps, by the shares in them."""
    d = x.shape[1]
    first, count, at = np.empty(d, np.int64), np.empty(d, np.int64), np.empty(d, np.int64)
    for p in range(x.shape[0]):
        total = 1
        for i in range(d):
            line = lines[start[i] : start[i + 1]]
            low = np.searchsorted(line, x[p, i] - half[p, i], side="right") - 1
            high = np.searchsorted(line, x[p, i] + half[p, i], side="left")
            first[i] = max(low, 0)
            count[i] = max(min(high, line.size - 1, first[i] + _MOST) - first[i], 1)
            total *= count[i]
            at[i] = 0
        for _ in range(total):
            share, cell = 1.0, 0
            for i in range(d):
                line, k = lines[start[i] : start[i + 1]], first[i] + at[i]
                left = max(x[p, i] - half[p, i], line[k])
                right = min(x[p, i] + half[p, i], line[k + 1])
                share *= max(right - left, 0.0) / (2.0 * half[p, i])
                cell = cell * shape[i] + k - origin[i]
            out[cell] += share * volume[p]
            for i in range(d - 1, -1, -1):
                at[i] += 1
                if at[i] < count[i]:
                    break
                at[i] = 0


def check_room(points: MaterialPoints) -> None:
    """Refuse points that have not moved and fill a cell more than once. Collective.

    What has moved may be denser than it was: it is left alone.

    Raises:
        ParameterError: There is such a cell.
    """
    if points.overlapping or points.roomy == points.revision:
        return
    moved = not np.array_equal(points.fields.read("x"), points.fields.read("x0"))
    if not points.comm.allreduce(moved, op=MPI.LOR):
        _check(points.comm, _Filled((points,)))
    points.roomy = points.revision


def check_room_of_both(a: MaterialPoints, b: MaterialPoints) -> None:
    """Refuse bodies that fill a cell more than once, as they are now. Collective.

    Raises:
        ParameterError: There is such a cell.
    """
    if not (a.overlapping or b.overlapping):
        _check(a.comm, _Filled((a, b)))


class _Filled:
    """Cells that points of some bodies are in, on any rank. Collective.

    Attributes:
        lines: Lines of the cells (m), one array per direction.
        cells: Numbers of the cells.
        shares: The share of each that each body fills, shape (bodies, cells).
        limits: The excess of each cell that counts as none, as a share of it.
    """

    def __init__(self, bodies: Sequence[MaterialPoints]):
        grid, comm = bodies[0].grid, bodies[0].comm
        mine = [np.append(_size(body), len(body)) for body in bodies]
        volume, number = comm.allreduce(np.sum(mine, axis=0), op=MPI.SUM)
        self.lines, least = _lines(grid, (volume / number) ** (1 / grid.geometry.dim))
        parts = [_in_cells(body, self.lines) for body in bodies]
        of = [np.full(len(cells), k) for k, (cells, _) in enumerate(parts)]
        everywhere = comm.allgather((np.concatenate(of), *map(np.concatenate, zip(*parts))))
        body, cells, amounts = (np.concatenate(rows) for rows in zip(*everywhere))
        self.cells, at = np.unique(cells, return_inverse=True)
        sums = np.zeros((len(bodies), self.cells.size))
        np.add.at(sums, (body, at.ravel()), amounts)
        sizes = np.ones(self.cells.size)
        for line, k in zip(self.lines, self.places()):
            sizes *= np.diff(line)[k]
        self.shares = sums / sizes
        largest = max(float(one.placement().volume.max(initial=0.0)) for one in bodies)
        largest = comm.allreduce(largest, op=MPI.MAX)
        self.limits = np.maximum(least, _POINT * np.minimum(largest / sizes, 1.0))

    def places(self) -> list[npt.NDArray[np.int64]]:
        """Positions of the cells on the lattice, one array per direction."""
        whole = tuple(line.size - 1 for line in self.lines)
        return [np.asarray(k, np.int64) for k in np.unravel_index(self.cells, whole)]


def _check(comm: MPI.Comm, filled: _Filled) -> None:
    total = filled.shares.sum(axis=0)
    # a body that is denser by itself, for it has moved, does not overlap for that
    own = np.maximum(filled.shares.max(axis=0), 1.0) if len(filled.shares) > 1 else 1.0
    excess = total - own - filled.limits
    if not np.any(excess > 0):
        return
    k = int(np.argmax(excess))
    middle = [0.5 * (line[at[k]] + line[at[k] + 1]) for line, at in
              zip(filled.lines, filled.places())]  # fmt: skip
    raise ParameterError(
        f"the points fill the cell at {np.array(middle)} m {total[k]:.3g} times, and "
        f"{int(np.count_nonzero(excess > 0))} cells more than once: bodies overlap, or volumes are "
        "too large. Take one shape out of the other, as in fill(grid, ground - lens, ...), or "
        "give the points other volumes; where it is meant, set points.overlapping = True before"
    )


def _size(body: MaterialPoints) -> float:
    return float(body.placement().volume.sum())


def _lines(grid: Mesh, point: float) -> tuple[list[Array], float]:
    """Lines of the cells, or of boxes of their size, and the excess that counts as none there.

    Args:
        grid: Background grid.
        point: Mean size of the points (m).
    """
    lattice = lattice_of(grid)
    if lattice is not None:
        return list(lattice.lines), _EXCESS
    low, high = bounds(grid)
    # a box holds some points, or their number in it is by chance
    size = max(mean_size(cell_size(grid)), 3 * point)
    numbers = np.maximum(np.floor((high - low) / size), 1).astype(int)
    return [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, numbers)], _EXCESS_OF_BOXES


def _in_cells(body: MaterialPoints, lines: list[Array]) -> tuple[npt.NDArray[np.int64], Array]:
    """Numbers of the cells that points of this rank fill, and what they fill of each (m^d)."""
    where, whole = body.placement(), tuple(line.size - 1 for line in lines)
    if not len(body):
        return np.empty(0, np.int64), np.empty(0)
    # a mere point counts as a cube
    cube = 0.5 * where.volume[:, None] ** (1 / body.gdim)
    half = np.where(where.half > 0, where.half, cube)
    low, high = (where.x - half).min(axis=0), (where.x + half).max(axis=0)
    origin = [max(np.searchsorted(line, a) - 1, 0) for line, a in zip(lines, low)]
    end = [min(np.searchsorted(line, b) + 1, n) for line, b, n in zip(lines, high, whole)]
    shape = np.maximum(np.subtract(end, origin), 1)
    start = np.cumsum([0, *(line.size for line in lines)])
    out = np.zeros(int(np.prod(shape)))
    _spread(
        where.x, half, where.volume, np.concatenate(lines), start, np.array(origin), shape, out
    )  # fmt: skip
    found = np.flatnonzero(out)
    ijk = [k + first for k, first in zip(np.unravel_index(found, tuple(shape)), origin)]
    return np.ravel_multi_index(ijk, whole).astype(np.int64), out[found]
