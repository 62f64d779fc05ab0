"""Load balance: a partition of the cells that gives all ranks the same number of points."""

from __future__ import annotations

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

__all__ = ["ENOUGH", "balance", "imbalance", "occupied", "redistributed"]

# Imbalance (largest number of points on a rank over the mean) up to which nothing changes
ENOUGH = 1.1


def imbalance(points: MaterialPoints) -> float:
    """Largest number of points on a rank over the mean. Collective."""
    if points.comm.size == 1:
        return 1.0
    most = points.comm.allreduce(len(points), op=MPI.MAX)
    return most * points.comm.size / max(points.total, 1)


def balance(points: MaterialPoints) -> int:
    """Make a new partition if the ranks have too different numbers of points. Collective.

    This needs a rectangular grid. On other grids, points stay with the cells of DOLFINx's mesh.

    Returns:
        Number of points that changed rank, over all ranks.

    Raises:
        PointsOutsideGridError: Points are outside the grid.
    """
    if points.comm.size == 1:
        return 0
    lattice = lattice_of(points.grid)
    if lattice is None:
        return 0
    # a body in few cells may have no better partition: do not try in every step
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


def redistributed(points: MaterialPoints, partition: Partition | None) -> MaterialPoints:
    """The points, distributed by a partition. Collective.

    Args:
        points: Material points; they stay unchanged.
        partition: The partition; None for the owners of cells in DOLFINx's mesh.

    Returns:
        The points themselves if they have this partition, otherwise a copy for reading.
    """
    if points.partition is partition:
        return points
    result = object.__new__(type(points))
    vars(result).update(vars(points))
    result.partition = partition
    grid, x = points.grid, points.placement(points.configuration).x
    to = destinations(grid, x, None, partition)
    result.fields = FieldArrays(exchange(points.comm, points.fields, to.rank))
    result.fields["cell"] = cells_here(grid, result.placement(result.configuration).x)
    return result


def occupied(points: MaterialPoints) -> npt.NDArray[np.int32]:
    """This rank's own cells in DOLFINx's mesh that contain points of any rank. Collective."""
    if points.partition is None:
        return np.unique(points["cell"])
    grid = points.grid
    to = destinations(grid, points.placement(points.configuration).x)
    first = grid.topology.index_map(grid.topology.dim).local_range[0]
    cells, which = np.unique(to.cell, return_index=True)
    came = exchange(points.comm, {"cell": cells}, to.rank[which])["cell"]
    return np.unique(came - first).astype(np.int32)
