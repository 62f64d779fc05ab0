"""Points go to the ranks that compute their cells, which are chosen so that all have as many."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.body.exchange import exchange
from dolfinmpm.body.fieldarrays import FieldArrays
from dolfinmpm.body.location import cells_here, destinations
from dolfinmpm.grid.lattice import Lattice, lattice_of
from dolfinmpm.grid.partition import Partition, partition_of

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["ENOUGH", "balance", "beside", "imbalance", "occupied"]

# Largest number of points on a rank over the mean that is left as it is
ENOUGH = 1.1


def imbalance(points: MaterialPoints) -> float:
    """Largest number of points on a rank over the mean. Collective."""
    if points.comm.size == 1:
        return 1.0
    most = points.comm.allreduce(len(points), op=MPI.MAX)
    return most * points.comm.size / max(points.total, 1)


def balance(points: MaterialPoints) -> int:
    """Distribute the points anew over the ranks if these have too unequal shares. Collective.

    On a lattice; on other grids points stay with the cells of DOLFINx's mesh.

    Returns:
        How many points changed rank, over all ranks.

    Raises:
        PointsOutsideGridError: Points are outside the grid.
    """
    if points.comm.size == 1:
        return 0
    lattice = lattice_of(points.grid)
    if lattice is None:
        return 0
    # a body of a few cells cannot be divided better, and is not tried again and again
    best = 1.0 if points.partition is None else points.partition.imbalance
    if imbalance(points) <= max(ENOUGH, 1.02 * best):
        return 0
    points.partition = _divided(points, lattice)
    return points.locate()


def _divided(points: MaterialPoints, lattice: Lattice) -> Partition:
    """A partition by the numbers of points in the cells. Collective."""
    shape, comm = lattice.shape, points.comm
    x = points.placement(points.configuration).x
    number = np.ravel_multi_index(tuple(lattice.cells_at(x).T), shape)
    found = np.unique(number, return_counts=True)
    cells, counts = (np.concatenate(part) for part in zip(*comm.allgather(found)))
    # points of several ranks may be in a cell
    cells, at = np.unique(cells, return_inverse=True)
    weights = np.bincount(at.ravel(), counts, minlength=cells.size)
    ijk = np.column_stack(np.unravel_index(cells, shape))
    return partition_of(shape, comm.size, ijk, weights)


def beside(points: MaterialPoints, partition: Partition | None) -> MaterialPoints:
    """The points, on the ranks that a partition tells. Collective.

    Args:
        points: Material points; they stay as they are.
        partition: The partition, or None for the ranks that have the cells in DOLFINx's mesh.

    Returns:
        The points themselves if they are there already; else a copy for reading.
    """
    if points.partition is partition:
        return points
    result = copy.copy(points)
    result.partition = partition
    grid, x = points.grid, points.placement(points.configuration).x
    to = destinations(grid, x, None, partition)
    result.fields = FieldArrays(exchange(points.comm, points.fields, to.rank))
    result.fields["cell"] = cells_here(grid, result.placement(result.configuration).x)
    return result


def occupied(points: MaterialPoints) -> npt.NDArray[np.int32]:
    """Cells of DOLFINx's mesh owned by this rank that points of any rank are in. Collective."""
    if points.partition is None:
        return np.unique(points["cell"])
    grid = points.grid
    to = destinations(grid, points.placement(points.configuration).x)
    first = grid.topology.index_map(grid.topology.dim).local_range[0]
    cells, which = np.unique(to.cell, return_index=True)
    came = exchange(points.comm, {"cell": cells}, to.rank[which])["cell"]
    return np.unique(came - first).astype(np.int32)
