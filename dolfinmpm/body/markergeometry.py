"""Geometry of the markers of a boundary: checks of arguments, and pieces of lines and surfaces."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import number
from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    FieldShapeError,
    ParameterError,
    UnsupportedGridError,
    call_together,
    raise_together,
)
from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.body.contours import (
    along_segments,
    contour,
    cut_triangles,
    gauss,
    kuhn,
    no_longer,
    quartered,
)
from dolfinmpm.body.location import bounds
from dolfinmpm.body.markerturns import check_crossings, check_turns
from dolfinmpm.body.surfacechecks import numbers_of
from dolfinmpm.grid.lattice import Lattice, largest_cell, lattice_of, smallest_height
from dolfinmpm.grid.userfunctions import call_function

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = [
    "WITHIN", "check_outward", "level_set_markers", "put_inside", "revolved", "rows_of",
    "segment_markers", "segments_of", "share_within", "side_markers", "triangle_markers",
    "triangles_of",
]  # fmt: skip

Array = npt.NDArray[np.float64]

# Markers on a grid line belong to the cell on the body's side: they move by this share of a cell
_INWARD = 1e-9
# Markers nearer to the axis than this share of a cell are on the axis
_AXIS = 1e-6
# More pieces of a boundary take too much memory
_MOST_PIECES = 1e7
# Sizes of a point within which points count, and how many times more of them must be in front of
# the markers than behind: within a body as many are on both sides
_NEAR, _MORE = 1.25, 4.0
# and the least ratio of what is on both sides of a marker within a body
_BOTH = 0.5
# Share of a boundary with the body on both sides that its corners may have
WITHIN = 0.2


def revolved(points: Any, x: Array, area: Array) -> tuple[Array, Array]:
    """Markers of an axisymmetric body from markers of its section: areas times 2π r.

    Markers on the axis have no area and are left out. Other bodies keep their markers.

    Args:
        points: Material points of the body.
        x: Positions (m), shape (n, gdim).
        area: Area vectors in the section (m^(gdim-1)), shape (n, gdim).
    """
    if not points.axisymmetric:
        return x, area
    off = x[:, 0] > _AXIS * largest_cell(points.grid)
    return x[off], ring(x[off, :1], area[off])


def rows_of(d: int, x: Any, area: Any) -> tuple[Array, Array]:
    """Positions and area vectors as arrays, checked."""
    made = [corners_of(what, values, d) for what, values in (("x", x), ("area", area))]
    if len(made[0]) != len(made[1]):
        raise FieldShapeError(
            f"x has {len(made[0])} rows and area {len(made[1])}; give one row per marker"
        )
    none = np.flatnonzero(~(np.linalg.norm(made[1], axis=1) > 0))
    if none.size:
        raise ParameterError(
            f"the area of the marker at {made[0][none[0]]} m is zero; leave such markers out"
        )
    return made[0], made[1]


def put_inside(grid, x: Array, normal: Array) -> Array:
    """Markers on grid lines, moved a little into the body, so that they lie in cells. Collective.

    Args:
        grid: Background grid.
        x: Positions (m), shape (n, gdim).
        normal: Outward unit normals, shape (n, gdim).

    Raises:
        ParameterError: A marker at the grid's edge would leave the grid, because its normal points
            into the grid.
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
            f"{normal[p] + 0.0} points into the grid; it must point out of the body. The body is "
            "to the left of the corners in their order: give vertices[::-1]; for triangles and "
            "arrays reverse the normals"
        )
    raise_together(grid.comm, error)
    return moved


def _inward(grid, x: Array) -> Array:
    """Distance by which markers move into the body (m), shape (n, 1)."""
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
    """Rows of numbers as an array, shape (n, d); n may be 0.

    Args:
        what: Name of the argument.
        values: The argument.
        d: Number of columns.

    Raises:
        FieldShapeError: The argument has another shape, or is no array of numbers.
        ParameterError: A value is not finite.
    """
    given = numbers_of(what, values)
    if given.size == 0:
        return np.empty((0, d))
    if given.ndim != 2 or given.shape[1] != d:
        raise FieldShapeError(f"{what} should have shape (n, {d}), got {given.shape}")
    if not np.isfinite(given).all():
        row = given[~np.isfinite(given).all(axis=1)][0]
        raise ParameterError(f"{what} has the row {row}, which must be finite")
    return given


def side_markers(
    lattice: Lattice, axis: int, end: int, rule: int, spacing: float | None = None
) -> tuple[Array, Array]:
    """Positions (m) and area vectors (m^(d-1)) of Gauss points on a side of a rectangular grid.

    Args:
        lattice: Lattice of the grid.
        axis: Direction normal to the side.
        end: 0 for the lower end of the axis, 1 for the upper end.
        rule: Gauss points per piece and direction.
        spacing: Greatest length of a piece (m); None for the sides of the cells.
    """
    at, weights = gauss(rule)
    longest = np.inf if spacing is None else number("spacing", spacing, 0.0, unit="m")
    places, lengths = [], []
    for d, line in enumerate(lattice.lines):
        line = no_longer(line, longest)
        middle, half = 0.5 * (line[1:] + line[:-1]), 0.5 * np.diff(line)
        across = d == axis
        places.append(line[[-end]] if across else (middle[:, None] + half[:, None] * at).ravel())
        lengths.append(np.ones(1) if across else (half[:, None] * weights).ravel())
    gdim = len(lattice.lines)
    x = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1)
    area = np.prod(np.meshgrid(*lengths, indexing="ij"), axis=0).reshape(-1, 1)
    normal = np.eye(gdim)[axis] * (1.0 if end else -1.0)
    return x.reshape(-1, gdim), area * normal


def level_set_markers(
    grid, phi: Callable[[Array], Any], subdivisions: int, rule: int
) -> tuple[Array, Array]:
    """Positions (m) and area vectors (m^(d-1)) of markers where a function is zero. Collective.

    Args:
        grid: Background grid, in 2D or 3D.
        phi: Function of positions (m), shape (gdim, n).
        subdivisions: Parts per cell and direction, on rectangular grids.
        rule: Gauss points per piece of a line in 2D.

    Raises:
        EmptyShapeError: The function is zero nowhere on the grid.
        ParameterError: A value of the function is not finite.
        UnsupportedGridError: The grid is neither rectangular nor of triangles or tetrahedra.
    """
    pieces = _level_set_pieces(grid, phi, subdivisions)
    if grid.geometry.dim == 2:
        x, area = along_segments(pieces, (), np.inf, rule)
    else:
        x, area = cut_triangles(pieces, None, coarse=True)
    if grid.comm.allreduce(len(x), op=MPI.SUM) == 0:
        raise EmptyShapeError(
            "phi changes its sign nowhere on the grid: phi must be negative in the body, "
            "positive outside, and 0 at the boundary"
        )
    return x, area


def _level_set_pieces(grid, phi: Callable[[Array], Any], subdivisions: int) -> Array:
    """Segments or triangles on which a function is zero (m), in this rank's cells. Collective."""
    simplices = _simplices_of(grid, subdivisions)
    x = simplices.reshape(-1, grid.geometry.dim)
    values = call_together(grid.comm, lambda: call_function("phi", phi, x))
    bad, error = np.flatnonzero(~np.isfinite(values)), None
    if bad.size:
        error = ParameterError(f"phi = {values[bad[0]]} at {x[bad[0]]} m must be finite")
    raise_together(grid.comm, error)
    return contour(simplices, values.reshape(simplices.shape[:2]))


def _simplices_of(grid, subdivisions: int) -> Array:
    """Simplices that fill this rank's own cells (m), shape (n, d + 1, d)."""
    d, own = grid.geometry.dim, grid.topology.index_map(grid.topology.dim).size_local
    lattice = lattice_of(grid)
    x = np.asarray(grid.geometry.x[:, :d], float)[geometry_dofmap(grid)[:own]]
    if x.shape[1] == d + 1:
        return x
    if lattice is None:
        raise UnsupportedGridError(
            "a level set needs a rectangular grid, or a grid of triangles or tetrahedra"
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
        vertices: Corners (m), shape (n, 2).
        closed: Whether a segment joins the last corner to the first.

    Raises:
        FieldShapeError: The corners have another shape.
        ParameterError: There are too few corners, a corner is given twice in a row, or segments
            cross.
    """
    corners = corners_of("vertices", vertices, 2)
    if len(corners) < 2 + closed:
        raise ParameterError(f"vertices are {len(corners)}; a boundary has {2 + closed} or more")
    ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    ends = ends if closed else ends[:-1]
    short = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) == 0
    if short.any():
        raise ParameterError(f"the vertex {ends[short][0, 0]} m is given twice in a row")
    check_crossings(ends)
    return ends


def segment_markers(grid, ends: Array, spacing: float | None, rule: int) -> tuple[Array, Array]:
    """Positions (m) and area vectors (m) of Gauss points on segments.

    Args:
        grid: Background grid, in 2D.
        ends: Ends of the segments (m), shape (segments, 2, 2).
        spacing: Greatest length of a piece (m); None for what `Boundary.from_polygon` says.
        rule: Gauss points per piece.
    """
    lattice = lattice_of(grid)
    longest = np.inf if lattice is not None else smallest_height(grid) / 2
    if spacing is not None:
        longest = number("spacing", spacing, 0.0, unit="m")
        pieces = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum() / longest
        if pieces > _MOST_PIECES:
            raise ParameterError(
                f"spacing = {longest:g} m makes {pieces:.3g} pieces, more than {_MOST_PIECES:g}: "
                "give about half the size of a cell"
            )
    lines = () if lattice is None else lattice.lines
    return along_segments(ends, lines, longest, rule)


def triangle_markers(grid, corners: Array) -> tuple[Array, Array]:
    """Positions (m) and area vectors (m²) of quadrature points on triangles.

    Args:
        grid: Background grid, in 3D.
        corners: Corners of the triangles (m), shape (triangles, 3, 3).
    """
    lattice = lattice_of(grid)
    if lattice is not None:
        return cut_triangles(corners, lattice.lines)
    return cut_triangles(quartered(corners, smallest_height(grid) / 2), None)


def triangles_of(vertices: Any, triangles: Any) -> Array:
    """Corners of triangles (m), shape (m, 3, 3).

    Args:
        vertices: Corners (m), shape (n, 3).
        triangles: Three corners per triangle, shape (m, 3).

    Raises:
        FieldShapeError: An array has another shape.
        ParameterError: A triangle has a corner that does not exist, or normals of neighbours
            disagree.
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
    check_turns(corners[rows])
    return corners[rows]


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
    amounts = volumes_beside(points, x, area)[0]
    front, behind = amounts.sum(axis=0)
    if front > _MORE * behind:
        raise ParameterError(
            f"the boundary '{name}' is inside out: the body is where its normals point, and they "
            "point out of a body. Give vertices anticlockwise around a body and clockwise around "
            "a hole, triangles whose right-handed turn points outwards, a phi that is negative in "
            "the body, or area vectors the other way"
        )


def volumes_beside(points: MaterialPoints, x: Array, area: Array, tags=None) -> tuple[Array, Array]:
    """Volumes of nearby points with the tags in front of and behind all markers. Collective.

    Returns:
        Volumes times areas of the markers, shape (markers, 2), and areas, shape (markers,).
    """
    placed = points.placement()
    largest = points.comm.allreduce(float(placed.volume.max(initial=0.0)), op=MPI.MAX)
    size = largest ** (1 / points.gdim)
    # a marker between two cells may be on another rank than the points beside it
    everywhere = points.comm.allgather((x, area))
    x, area = (np.concatenate(rows) for rows in zip(*everywhere))
    sizes = np.linalg.norm(area, axis=1)
    amounts = np.zeros((len(x), 2))
    of_tags = np.isin(points["tag"], points["tag"] if tags is None else list(tags))
    places, volumes = points["x"][of_tags], placed.volume[of_tags]
    if len(places) and len(x):
        from scipy.spatial import cKDTree

        near = cKDTree(places).query_ball_point(x, _NEAR * size)
        of = np.repeat(np.arange(len(x)), [len(found) for found in near])
        rows = np.concatenate([np.asarray(found, np.intp) for found in near])
        ahead = np.sum((places[rows] - x[of]) * area[of], axis=1)
        volume = volumes[rows] * sizes[of]
        for column, here in enumerate((ahead > 0, ahead < 0)):
            np.add.at(amounts[:, column], of[here], volume[here])
    points.comm.Allreduce(MPI.IN_PLACE, amounts, op=MPI.SUM)
    return amounts, sizes


def share_within(amounts: Array, sizes: Array) -> float:
    """Share of a boundary that has points on both sides; see `volumes_beside`."""
    within = amounts.min(axis=1) > _BOTH * amounts.max(axis=1)
    return float(sizes[within].sum() / sizes.sum())
