"""Sizes of cells that are wanted near a rigid body, or where the soil yields."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import check_kind, number, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm.body.formarguments import check_points
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.rigidbody import RigidBody
from dolfinmpm.contact.shapesurface import surface_of
from dolfinmpm.contact.surfaces import RigidSurface

__all__ = ["near", "where_it_yields"]

Array = npt.NDArray[np.float64]


class _Near(Unchanged):
    """See `near`."""

    def __init__(
        self, body: RigidBody, surface: RigidSurface, size: float, reach: float, growth: float
    ):
        self._body, self._surface = body, surface
        self._size, self._reach, self._growth = size, reach, growth
        self.least = size
        self.told, self.gdim = f"{size:g} m near a body", surface.gdim

    def wanted(self, low: Array, high: Array) -> Array:
        """See `dolfinmpm.basis.refinement.CellSize`."""
        if not len(low):
            return np.empty(0)
        # the surface is that of the body where it was made
        x = self._body.start.back(0.5 * (low + high))
        gap = self._surface.probe(np.ascontiguousarray(x))[0]
        apart = np.abs(gap) - 0.5 * np.linalg.norm(high - low, axis=1)
        return np.maximum(self._size, self._growth * (apart - self._reach))


def near(
    body: RigidBody,
    size: float,
    *,
    reach: float | None = None,
    growth: float = 0.5,
    part: Any = None,
) -> _Near:
    """Cells of a size near a rigid body, for `Space(refine=...)`; they grow with distance.

    The size wanted at a distance a from the surface of the body is max(size, growth (a − reach)).
    The surface is where the body is at the start of a step, so that the cells follow the body.

    Args:
        body: A rigid body.
        size: Size of the cells at the body (m).
        reach: Distance up to which cells have this size (m); four cells by default.
        growth: Growth of the size with distance (-): with 0.5, a ring of cells of each size is two
            cells wide.
        part: A shape, where the body was made. The cells are fine near its surface, in place of
            that of the body, and go along with the body. For a penetrometer, it is the cone without
            the shaft.

    Raises:
        ParameterError: An argument is not valid.

    >>> import numpy as np
    >>> import dolfinmpm as mpm
    >>> ball = mpm.RigidBody(mpm.Ball((0, 0), 1.0), increment=(0, 0))
    >>> fine = mpm.near(ball, size=0.1)
    >>> fine.wanted(np.array([[0.9, 0.0], [4.0, 0.0]]), np.array([[1.1, 0.2], [4.1, 0.1]])).round(2)
    array([0.1 , 1.29])
    """
    check_kind("body", body, RigidBody, "make it with mpm.RigidBody(shape)")
    number("size", size, 0.0, unit="m")
    reach = 4 * size if reach is None else number("reach", reach, 0.0, unit="m", closed=True)
    surface = body.surface if part is None else surface_of(part, 0.0)
    if surface.gdim != body.surface.gdim:
        raise ParameterError(
            f"part = {shown(part)} has {surface.gdim} dimensions; the body has {body.surface.gdim}"
        )
    return _Near(body, surface, float(size), float(reach), number("growth", growth, 0.0))


class _WhereItYields(Unchanged):
    """See `where_it_yields`."""

    def __init__(self, points: MaterialPoints, size: float, field: str, least: float):
        self._points, self._size, self._field, self._least = points, size, field, least
        self.least = size
        self.told, self.gdim = f"{size:g} m where {field} > {least:g}", points.gdim

    def wanted(self, low: Array, high: Array) -> Array:
        """See `dolfinmpm.basis.refinement.CellSize`."""
        points, sizes = self._points, np.full(len(low), np.inf)
        values = points[self._field]
        if values.ndim > 1:
            raise ParameterError(
                f"field = {self._field!r} has shape {values.shape[1:]} at each point; refinement "
                "needs a field of one number, such as plastic_strain"
            )
        chosen = values > self._least
        every = points.comm.allgather(points["x"][chosen])
        x = np.concatenate(every)
        if not len(x) or not len(low):
            return sizes
        from scipy.spatial import cKDTree

        middle, edge = 0.5 * (low + high), (high - low).max(axis=1)
        apart, _ = cKDTree(x).query(middle, p=np.inf)
        # a cell and its neighbours
        sizes[apart <= edge] = self._size
        return sizes


def where_it_yields(
    points: MaterialPoints, size: float, *, field: str = "plastic_strain", least: float = 1e-3
) -> _WhereItYields:
    """Cells of a size where points have yielded, for `Space(refine=...)`.

    A cell has this size if a point that has yielded is in it, or within one cell of it.

    Args:
        points: Material points.
        size: Size of the cells (m).
        field: Name of the field of the points that tells how much they have yielded.
        least: Least value of the field, such as a plastic strain (-).

    The law of the points adds the field when a problem is made. A field that is missing then is an
    `UnknownNameError` of the first step.

    Raises:
        ParameterError: An argument is not valid.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> fine = mpm.where_it_yields(points, 0.25)
    >>> V = mpm.Space(grid, "gimp", refine=fine, levels=2)
    >>> clay = mpm.materials.Tresca(1e6, 0.3, cohesion=20e3)
    >>> F = mpm.momentum(clay, points, V.increment, V.test)
    >>> problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    >>> points["plastic_strain"][points["x"][:, 0] < 0.5] = 0.01
    >>> problem.adapt().split
    48
    """
    check_points(points)
    number("size", size, 0.0, unit="m")
    number("least", least)
    check_kind("field", field, str, "the name of a field of the points")
    return _WhereItYields(points, float(size), field, float(least))
