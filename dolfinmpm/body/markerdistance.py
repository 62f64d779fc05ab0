"""Checks that a boundary has a body beside it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import IdleConditionWarning, ParameterError, warn
from dolfinmpm.grid.lattice import largest_cell

__all__ = ["APART", "mark_far"]

# Field that is 1 at markers with no body beside them
APART = "apart"
# Beyond this distance from the nearest point, in cells, a marker is not at the body
_REACH = 1.0


def mark_far(points: Any, markers: Any, name: str) -> None:
    """Mark the markers of a body's boundary that are away from the body. Collective.

    In empty cells a stabilisation would hold the body there, at a distance.

    Args:
        points: Material points of the body.
        markers: The markers of a boundary that follows the body.
        name: Name of the boundary.

    Raises:
        ParameterError: All markers are away from the body.

    Warns:
        IdleConditionWarning: Some are.
    """
    from scipy.spatial import cKDTree

    comm, reach = points.comm, _REACH * largest_cell(points.grid)
    at = np.concatenate(comm.allgather(markers["x"]))
    distance: npt.NDArray[np.float64] = np.full(len(at), np.inf)
    if len(points):
        distance = cKDTree(points["x"]).query(at)[0]
    comm.Allreduce(MPI.IN_PLACE, distance, op=MPI.MIN)
    far = distance > reach
    if not far.any():
        return
    p = int(np.argmax(distance))
    place = f"{distance[p]:.3g} m from the next material point, at {at[p]} m"
    advice = (
        "move the boundary to the body, or give follows=False for a wall that waits for the body"
    )
    if far.all():
        raise ParameterError(
            f"the boundary '{name}' is away from the body: markers are up to {place}, and more "
            f"than a cell ({reach:.3g} m) everywhere; {advice}"
        )
    warn(
        comm,
        f"{np.count_nonzero(far)} of {len(at)} markers of the boundary '{name}' are away from the "
        f"body and do not act, up to {place}: {advice}",
        IdleConditionWarning,
    )
    first = sum(comm.allgather(len(markers))[: comm.rank])
    markers.add_field(APART)
    markers.fields[APART][...] = far[first : first + len(markers)]
