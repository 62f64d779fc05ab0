"""Checks of loaded faces: their normals, and whether they are at the surface of the body."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import coordinates, floats, shown
from dolfinmpm._platform.errors import (
    FieldShapeError,
    ParameterError,
    call_together,
    raise_together,
)
from dolfinmpm.body.points import MaterialPoints

__all__ = ["axis_of", "check_exposed", "error_on_axis", "numbers_of", "offsets_and_areas"]

Array = npt.NDArray[np.float64]

# Longest way from a point to its face, in half-lengths of its domain
_FARTHEST = 8.0


def error_on_axis(points: MaterialPoints, faces: Array, chosen) -> ParameterError | None:
    """Error if faces of an axisymmetric body with these centres lie on the axis, or None."""
    bad = np.flatnonzero(chosen & ~(faces[:, 0] > 1e-9 * points["x0"][:, 0]))
    if not bad.size:
        return None
    p = bad[0]
    return ParameterError(
        f"the face of point {points['id'][p]} has the radius {faces[p, 0]:.3g} m, and it must be "
        f"positive: the axis is no boundary of the body ({bad.size} such faces here); leave them "
        "out"
    )


def axis_of(normal: Any, gdim: int) -> Array:
    """The normal as an array, if it is an axis with a sign."""
    n = coordinates("normal", normal)
    if n.shape != (gdim,) or not np.array_equal(np.sort(np.abs(n)), [0.0] * (gdim - 1) + [1.0]):
        raise ParameterError(
            f"normal = {shown(normal)} must be an axis of {gdim}D with a sign, such as "
            f"{(0,) * (gdim - 1) + (1,)}; give other faces by Surface.from_boundary"
        )
    return n


def offsets_and_areas(points: MaterialPoints, offset: Any, area: Any) -> tuple[Array, Array]:
    """The arguments of `Surface.from_arrays` as arrays. Collective.

    Raises:
        FieldShapeError: An array has another shape.
        ParameterError: A value is not finite, or a face lies on the axis.
    """
    R, A = call_together(
        points.comm, lambda: (numbers_of("offset", offset), numbers_of("area", area))
    )
    error: Exception | None = None
    for what, values in (("offset", R), ("area", A)):
        if values.shape != (len(points), points.gdim):
            error = FieldShapeError(
                f"{what} should have shape {(len(points), points.gdim)} (this rank's points "
                f"first), got {values.shape}"
            )
        elif not np.isfinite(values).all():
            p = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            error = ParameterError(
                f"{what} = {values[p]} of the point at {points['x'][p]} m must be finite"
            )
    raise_together(points.comm, error or _far_face(points, R, A))
    if points.axisymmetric:
        raise_together(points.comm, error_on_axis(points, points["x0"] + R, np.any(A, axis=1)))
    return R, A


def _far_face(points: MaterialPoints, offset: Array, area: Array) -> ParameterError | None:
    """The error for a face that is far from its point, as where positions are given, or None."""
    away = np.linalg.norm(offset, axis=1) * np.any(area, axis=1)
    bad = np.flatnonzero(away > _FARTHEST * points["l0"].max(axis=1, initial=0.0))
    if not bad.size:
        return None
    p = bad[0]
    return ParameterError(
        f"offset = {offset[p]} m of the point at {points['x'][p]} m is longer than {_FARTHEST:g} "
        f"times the half-length of its domain, {points['l0'][p].max():.4g} m ({bad.size} such "
        "points on this rank): it is the way from the point's centre to its face, the place of the "
        "face less points['x']"
    )


def numbers_of(what: str, values: Any) -> Array:
    """An argument as an array of numbers, or a FieldShapeError."""
    given = floats(values)
    if given is None:
        raise FieldShapeError(f"{what} = {shown(values)} must be an array of numbers")
    return given


def check_exposed(points: MaterialPoints, chosen, n: Array) -> None:
    """No chosen face may have another point in front of it: it would be inside the body."""
    x, half = points["x0"], points["l0"]
    # within the thinnest domain, which may be the sliver that a shape leaves in a cell
    along = np.abs(half @ n)
    thinnest = points.comm.allreduce(float(along.min(initial=np.inf)), op=MPI.MIN)
    beyond = along + np.minimum(0.02 * along, 0.5 * thinnest)
    mine = x[chosen] + beyond[chosen, None] * n
    probes = np.concatenate(points.comm.allgather(mine))
    hidden = np.zeros(len(probes), bool)
    if len(points) and len(probes):
        from scipy.spatial import cKDTree

        near = cKDTree(x).query_ball_point(probes, half.max(), p=np.inf)
        owner = np.repeat(np.arange(len(probes)), [len(found) for found in near])
        others = np.concatenate([np.asarray(found, np.int64) for found in near])
        # domains of points that are not on one lattice overlap a little at their sides
        share = np.where(n != 0, 1.0, 0.99)
        covered = np.all(np.abs(probes[owner] - x[others]) < share * half[others], axis=1)
        hidden[owner[covered]] = True
    total = np.flatnonzero(points.comm.allreduce(hidden.astype(np.int32), op=MPI.SUM))
    if total.size:
        raise ParameterError(
            f"{total.size} of {len(probes)} chosen faces are inside the body, with another point "
            f"right in front of them, such as the one at {probes[total[0]]} m; let `where` choose "
            "the body's own faces"
        )
