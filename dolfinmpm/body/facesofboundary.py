"""Faces of material points at the markers of a boundary: offsets and areas for a `Surface`.

Each marker belongs to the nearest material point. A point's face is at the mean of its markers, and
has the sum of their areas. At an edge of the body, a point keeps the face with most of its markers.
The others go to the nearest point whose face has about their normal. So faces lie on the sides of
the body, and the sum of their areas is that of the boundary. A point has one face. Where a body is
as thin as one point, the faces of its two sides would cancel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.markerstate import keys_of, leave_with_removed, nearest, nearest_of_all
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.lattice import largest_cell

__all__ = ["faces_of"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

# Least cosine of the angle between the normals of a face and of its markers
_ALIKE = 0.7
# Points among which a marker at an edge looks for a face
_BESIDE = 16
# Least sum of a point's markers, as a share of the sum of their sizes: 0.71 at a right angle that
# stays with one point, 0 at a sheet with two opposite sides
_LEFT = 0.5


class _Markers(NamedTuple):
    """Markers of all ranks, in one order.

    Attributes:
        x: Positions (m), shape (n, gdim).
        area: Area vectors (m^(d-1)), shape (n, gdim).
        normal: Unit normals, shape (n, gdim).
    """

    x: Array
    area: Array
    normal: Array


def faces_of(boundary: Boundary) -> tuple[Array, Array]:
    """Offsets from this rank's points to their faces, and area vectors of the faces. Collective.

    Args:
        boundary: A boundary that follows its body, which has not moved so far.

    Returns:
        Offsets (m) and areas (m^(d-1); m² around the axis of axisymmetric bodies), shape (points,
        gdim); zeros at points without a face.

    Raises:
        ParameterError: The boundary is a wall, the body has moved, or it is as thin as one point.
    """
    points, error = boundary.points, None
    if not boundary.follows:
        error = ParameterError(
            f"'{boundary.name}' is a wall, and no surface of the body: make a boundary of the body "
            "by mpm.Boundary.from_polygon(points, corners), with follows=True"
        )
    elif points.comm.allreduce(not np.array_equal(points["x"], points["x0"]), op=MPI.LOR):
        error = ParameterError(
            f"the body has moved, and a surface of '{boundary.name}' needs its first positions: "
            "make it before the first step"
        )
    raise_together(points.comm, error)
    # points that were removed before the first step have taken their markers along
    leave_with_removed(boundary)
    here = boundary.present()
    sent = (points.comm.allgather(boundary.markers[name][here]) for name in ("x", "area"))
    x, area = (np.concatenate(parts) for parts in sent)
    # a point at a right angle has as much of either face: the order of markers decides, not ranks
    order = np.lexsort((*area.T, *x.T))
    x, area = x[order], area[order]
    markers = _Markers(x, area, area / np.linalg.norm(area, axis=1)[:, None])
    found = nearest(points["x"], keys_of(points["x0"]), markers.x)
    at, rows = nearest_of_all(points.comm, *found)
    main = _main_normals(markers, at, rows, len(points))
    strange = np.zeros(len(x), bool)
    strange[at] = np.sum(markers.normal[at] * main[rows], axis=1) < _ALIKE
    points.comm.Allreduce(MPI.IN_PLACE, strange, op=MPI.LOR)
    others = np.flatnonzero(strange)
    # further than a cell away, there is no body at the marker
    reach = largest_cell(points.grid)
    found = _with_like_normal(points, markers, main, others, reach)
    again, theirs = nearest_of_all(points.comm, *found)
    # where no face near has such a normal, a marker stays
    moved = np.zeros(len(x), bool)
    moved[others[again]] = True
    points.comm.Allreduce(MPI.IN_PLACE, moved, op=MPI.LOR)
    stays = ~moved[at]
    at, rows = np.append(at[stays], others[again]), np.append(rows[stays], theirs)
    offset, area = _sums(points, markers, at, rows)
    whole = np.bincount(rows, _sizes(markers.area[at]), len(points))
    _check_thickness(boundary, np.asarray(whole, np.float64), area)
    return offset, area


def _sizes(area: Array) -> Array:
    return np.asarray(np.linalg.norm(area, axis=1))


def _check_thickness(boundary: Boundary, whole: Array, area: Array) -> None:
    """Raise ParameterError where the markers of a point cancel. Collective.

    Args:
        boundary: The boundary.
        whole: Sums of the sizes of each point's markers (m^(d-1)), shape (points,).
        area: Sums of their area vectors (m^(d-1)), shape (points, gdim).
    """
    points, error = boundary.points, None
    thin = np.flatnonzero(_sizes(area) < _LEFT * whole)
    if thin.size:
        error = ParameterError(
            f"two sides of '{boundary.name}' share the point at {points['x'][thin[0]]} m, and a "
            "point has one face: put at least two points over the thickness of the body, by "
            "per_cell= or smaller cells, or make one boundary for each side that touches"
        )
    raise_together(points.comm, error)


def _main_normals(markers: _Markers, at: Rows, rows: Rows, count: int) -> Array:
    """Normal of the face with most of a point's area, shape (count, gdim); zero without markers.

    Args:
        markers: The markers.
        at, rows: Markers of this rank's points, and these points.
        count: Number of points.
    """
    main = np.zeros((count, markers.x.shape[1]))
    order = np.argsort(rows, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(rows[order])) + 1) if rows.size else ():
        n, a = markers.normal[at[group]], markers.area[at[group]]
        alike = n @ n.T >= _ALIKE
        face = alike[np.argmax(alike @ np.linalg.norm(a, axis=1))]
        whole = a[face].sum(axis=0)
        main[rows[group[0]]] = whole / np.linalg.norm(whole)
    return main


def _with_like_normal(
    points: MaterialPoints, markers: _Markers, main: Array, others: Rows, reach: float
) -> tuple[Array, Array, Rows]:
    """Nearest points of this rank whose faces have about the normals of markers; see `nearest`.

    Args:
        points: Material points.
        markers: The markers.
        main: Normals of the points' faces, shape (points, gdim).
        others: Numbers of the markers, shape (n,).
        reach: Largest distance of such a point (m).
    """
    from scipy.spatial import cKDTree

    faces = np.flatnonzero(main.any(axis=1))
    distance, key = np.full((2, others.size), np.inf)
    if not (faces.size and others.size):
        return distance, key, np.zeros(others.size, np.intp)
    count = min(_BESIDE, faces.size)
    far, found = cKDTree(points["x"][faces]).query(markers.x[others], count)
    far, found = far.reshape(others.size, count), faces[found.reshape(others.size, count)]
    along = np.einsum("nki,ni->nk", main[found], markers.normal[others])
    near = (along >= _ALIKE) & (far <= reach)
    far = np.where(near, far, np.inf)
    best, every = np.argmin(far, axis=1), np.arange(others.size)
    rows = found[every, best]
    return far[every, best], keys_of(points["x0"])[rows], rows


def _sums(points: MaterialPoints, markers: _Markers, at: Rows, rows: Rows) -> tuple[Array, Array]:
    """See `faces_of`.

    Args:
        points: Material points.
        markers: The markers.
        at, rows: Markers of this rank's points, and these points.
    """
    size = _sizes(markers.area[at])
    on = np.bincount(rows, size, len(points)) > 0.0
    offset, area = np.zeros((2, len(points), points.gdim))
    for k in range(points.gdim):
        area[:, k] = np.bincount(rows, markers.area[at, k], len(points))
    middle = _middles(markers.x[at], size, rows, len(points))
    if points.axisymmetric:
        # The area grows with the radius. Along the face the middle is that of the section, as of a
        # `Surface` along an axis: so a uniform load balances a uniform stress, whose volumes are
        # 2π r times areas of sections. Across it the mean over the area has the mean gap.
        normal = np.divide(area, _sizes(area)[:, None], out=np.zeros_like(area), where=on[:, None])
        section = _middles(markers.x[at], size / markers.x[at, 0], rows, len(points))
        across = np.sum((middle - section) * normal, axis=1)
        middle = section + across[:, None] * normal
    offset[on] = middle[on] - points["x"][on]
    return offset, area


def _middles(x: Array, weight: Array, rows: Rows, count: int) -> Array:
    """Means of the positions of each point's markers (m), shape (count, d); zero without markers.

    Args:
        x: Positions (m), shape (n, d).
        weight: Weights, shape (n,).
        rows: Point of each marker, shape (n,).
        count: Number of points.
    """
    # a rank without markers: NumPy then returns integers, into which nothing can be divided
    columns = [np.bincount(rows, weight * column, count) for column in x.T]
    sums = np.array(columns, np.float64).T
    whole = np.bincount(rows, weight, count)[:, None]
    return np.divide(sums, whole, out=np.zeros_like(sums), where=whole > 0.0)
