"""Where the markers of a boundary are: what is given, checked, and the pieces that they lie on."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm._platform.errors import (
    FieldShapeError,
    ParameterError,
    UnsupportedGridError,
    raise_together,
)
from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.body.contours import kuhn
from dolfinmpm.body.location import bounds
from dolfinmpm.grid.lattice import largest_cell, lattice_of, smallest_height

__all__ = ["put_inside", "revolved", "rows_of", "segments_of", "simplices_of", "triangles_of"]

Array = npt.NDArray[np.float64]

# Markers on a grid line are in the cell on the body's side: moved there by this share of a cell.
_INWARD = 1e-9
# and nearer to the axis than this share of a cell they are on it
_AXIS = 1e-6


def revolved(points: Any, x: Array, area: Array) -> tuple[Array, Array]:
    """Markers of a section as those of the whole body: 2π r times their lengths.

    Pieces on the axis weigh nothing and bound nothing: they are left out.

    Args:
        points: Material points of the body.
        x: Positions (m), shape (n, gdim).
        area: Area vectors within the dimensions of the grid (m^(gdim-1)), likewise.
    """
    if not points.axisymmetric:
        return x, area
    off = x[:, 0] > _AXIS * largest_cell(points.grid)
    return x[off], ring(x[off, :1], area[off])


def rows_of(d: int, x: Any, area: Any) -> tuple[Array, Array]:
    """Positions and area vectors as arrays, checked."""
    made = []
    for what, values in (("x", x), ("area", area)):
        made.append(corners_of(what, values, d))
    if len(made[0]) != len(made[1]):
        raise FieldShapeError(f"x has {len(made[0])} rows and area {len(made[1])}; give one each")
    none = np.flatnonzero(~(np.linalg.norm(made[1], axis=1) > 0))
    if none.size:
        raise ParameterError(
            f"the area of the marker at {made[0][none[0]]} m is zero; leave such markers out"
        )
    return made[0], made[1]


def put_inside(grid, x: Array, normal: Array) -> Array:
    """Markers moved inwards by a little, so that those at the grid's edge see it. Collective.

    Args:
        grid: Background grid.
        x: Positions (m), shape (n, gdim).
        normal: Their outward unit normals, likewise.

    Raises:
        ParameterError: A marker at the grid's edge would leave it: its normal points into the grid.
    """
    low, high = bounds(grid)
    moved = x - _inward(grid, x) * normal
    inside, still = (np.all((at >= low) & (at <= high), axis=1) for at in (x, moved))
    out = np.flatnonzero(inside & ~still)
    error = None
    if out.size:
        p = out[0]
        error = ParameterError(
            f"the boundary lies on the grid's edge at {x[p]} m, and its outward normal "
            f"{normal[p] + 0.0} points into the grid, where the body would not be: the body is to "
            "the left of corners in order, so turn them round, vertices[::-1]; of triangles and "
            "arrays turn the normals round"
        )
    raise_together(grid.comm, error)
    return moved


def _inward(grid, x: Array) -> Array:
    """How far markers go inwards (m), shape (n, 1)."""
    far = np.full((len(x), 1), _INWARD * smallest_height(grid))
    lattice = lattice_of(grid)
    if lattice is None:
        return far
    gap = np.full(len(x), np.inf)
    for d, line in enumerate(lattice.lines):
        at = np.clip(np.searchsorted(line, x[:, d]), 1, line.size - 1)
        gap = np.minimum(
            gap, np.minimum(np.abs(x[:, d] - line[at - 1]), np.abs(x[:, d] - line[at]))
        )
    return np.where(gap[:, None] < far, far, 0.0)


def corners_of(what: str, values: Any, d: int) -> Array:
    """An array of so many columns, which may have no rows.

    Args:
        what: Its name in messages.
        values: What was given.
        d: Number of columns.

    Raises:
        FieldShapeError: It has another shape.
        ParameterError: A value is not finite.
    """
    try:
        given = np.asarray(values, float)
    except (TypeError, ValueError):
        raise FieldShapeError(f"{what} = {shown(values)} must be an array of numbers") from None
    if given.size == 0:
        return np.empty((0, d))
    if given.ndim != 2 or given.shape[1] != d:
        raise FieldShapeError(f"{what} should have shape (n, {d}), got {given.shape}")
    if not np.isfinite(given).all():
        row = given[~np.isfinite(given).all(axis=1)][0]
        raise ParameterError(f"{what} has the row {row}, which must be finite")
    return given


def simplices_of(grid, subdivisions: int) -> Array:
    """Simplices that this rank's own cells fall into (m), shape (n, d + 1, d)."""
    d, own = grid.geometry.dim, grid.topology.index_map(grid.topology.dim).size_local
    lattice = lattice_of(grid)
    x = np.asarray(grid.geometry.x[:, :d], float)[geometry_dofmap(grid)[:own]]
    if x.shape[1] == d + 1:
        return x
    if lattice is None:
        raise UnsupportedGridError(
            "a level set is found in rectangular grids, and in those of triangles or tetrahedra"
        )
    parts = np.array(list(np.ndindex(*(subdivisions,) * d)), float)
    cube = np.array(list(np.ndindex(*(2,) * d)), float)
    corners = (parts[:, None, :] + cube) / subdivisions
    ijk = lattice.cell_ijk[:own]
    low = np.column_stack([line[ijk[:, k]] for k, line in enumerate(lattice.lines)])
    high = np.column_stack([line[ijk[:, k] + 1] for k, line in enumerate(lattice.lines)])
    size = (high - low)[:, None, None, :]
    boxes = low[:, None, None, :] + corners * size
    return boxes.reshape(-1, 2**d, d)[:, kuhn(d)].reshape(-1, d + 1, d)


def segments_of(vertices: Any, closed: bool) -> Array:
    """Ends of the segments of a chain (m), shape (segments, 2, 2).

    Args:
        vertices: Its corners (m), shape (n, 2).
        closed: Whether the last corner is joined to the first.

    Raises:
        FieldShapeError, ParameterError: The corners are not what they may be.
    """
    corners = corners_of("vertices", vertices, 2)
    if len(corners) < 2 + closed:
        raise ParameterError(f"vertices are {len(corners)}; a boundary has {2 + closed} or more")
    ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    ends = ends if closed else ends[:-1]
    short = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) == 0
    if short.any():
        raise ParameterError(f"the vertex {ends[short][0, 0]} m is given twice in a row")
    return ends


def triangles_of(vertices: Any, triangles: Any) -> Array:
    """Corners of triangles (m), shape (m, 3, 3).

    Args:
        vertices: Corners (m), shape (n, 3).
        triangles: Three of them each, shape (m, 3).

    Raises:
        FieldShapeError, ParameterError: They are not what they may be.
    """
    corners = corners_of("vertices", vertices, 3)
    rows = np.asarray(triangles)
    if rows.ndim != 2 or rows.shape[1] != 3 or not np.issubdtype(rows.dtype, np.integer):
        raise FieldShapeError(
            f"triangles should be whole numbers of shape (m, 3), got {rows.dtype} of shape "
            f"{rows.shape}"
        )
    if rows.size and not (rows.min() >= 0 and rows.max() < len(corners)):
        raise ParameterError(
            f"triangles name vertices {rows.min()} ... {rows.max()}; there are 0 ... "
            f"{len(corners) - 1}"
        )
    return corners[rows]
