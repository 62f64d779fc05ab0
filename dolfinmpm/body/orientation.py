"""Which way the normals of a boundary point: out of the body, or into it by mistake."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["check_outward"]

Array = npt.NDArray[np.float64]

# Sizes of a point within which points count, and how many times more of them must be in front of
# the markers than behind: within a body as many are on both sides
_NEAR, _MORE = 1.25, 4.0


def check_outward(points: MaterialPoints, x: Array, area: Array, name: str) -> None:
    """Refuse a boundary that has the body in front of it and not behind. Collective.

    Markers far from the body, as of a wall that it has not reached, tell nothing.

    Args:
        points: Material points of the body.
        x: Positions of the markers of this rank (m), shape (n, gdim).
        area: Their area vectors (m^(d-1)), likewise.
        name: Name of the boundary.

    Raises:
        ParameterError: It is inside out.
    """
    amounts = np.zeros(2)
    placed = points.placement()
    largest = points.comm.allreduce(float(placed.volume.max(initial=0.0)), op=MPI.MAX)
    size = largest ** (1 / points.gdim)
    # a marker between two cells may be on another rank than the points beside it
    everywhere = points.comm.allgather((x, area))
    x, area = (np.concatenate(rows) for rows in zip(*everywhere))
    if len(points) and len(x):
        from scipy.spatial import cKDTree

        near = cKDTree(points["x"]).query_ball_point(x, _NEAR * size)
        of = np.repeat(np.arange(len(x)), [len(found) for found in near])
        rows = np.concatenate([np.asarray(found, np.intp) for found in near])
        ahead = np.sum((points["x"][rows] - x[of]) * area[of], axis=1)
        volume = placed.volume[rows] * np.linalg.norm(area[of], axis=1)
        amounts[:] = volume[ahead > 0].sum(), volume[ahead < 0].sum()
    front, behind = points.comm.allreduce(amounts, op=MPI.SUM)
    if front > _MORE * behind:
        raise ParameterError(
            f"the boundary '{name}' is inside out: the body is where its normals point, and they "
            "point out of a body. Give vertices anticlockwise around a body and clockwise around "
            "a hole, triangles whose right-handed turn points outwards, a phi that is negative in "
            "the body, or area vectors the other way"
        )
