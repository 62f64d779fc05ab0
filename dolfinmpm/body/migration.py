"""Material points that crossed a rank border move with every field they carry."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.errors import MigrationError, PointsOutsideGridError
from dolfinmpm.body.exchange import exchange
from dolfinmpm.body.location import Destinations, cells_here
from dolfinmpm.grid.lattice import times_regridded

__all__ = ["migrate", "settle"]


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


def settle(points, configuration: str) -> None:
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
