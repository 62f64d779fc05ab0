"""Fill a shape with material points."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import choice, number, shown, truth, whole
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    ParameterError,
    RoughShapeWarning,
    ShapeOutsideGridError,
    call_together,
    warn,
)
from dolfinmpm.basis.refinement import Refinement
from dolfinmpm.basis.space import Space
from dolfinmpm.body.axisymmetry import require_axis, ring
from dolfinmpm.body.cellparts import (
    CellParts,
    LatticeParts,
    LeafParts,
    Parts,
    check_amount,
    check_per_cell,
)
from dolfinmpm.body.exchange import numbers_in_order
from dolfinmpm.body.familyids import MERGES, ROOT_BITS, SPLITS
from dolfinmpm.body.location import bounds, destinations
from dolfinmpm.body.pointchecks import require_grid
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.shapes import Box, Shape, TurnedBox
from dolfinmpm.body.shapevolumes import correct, pieces_inside
from dolfinmpm.grid.lattice import Lattice, lattice_of, require_lattice
from dolfinmpm.grid.linecells import coordinate_rounding
from dolfinmpm.grid.userfunctions import call_function

__all__ = ["fill"]

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]
Density = float | Callable[[Array], Array]

# Relative error of the volume that is told
_ROUGH = 0.15
# Overlaps below this share of a part of a cell come from rounding
_SLIVER = 1e-9


@collective
def fill(
    grid: Mesh,
    shape: Shape,
    per_cell: int,
    density: Density,
    *,
    aligned: str = "grid",
    tag: int = 0,
    exact: bool = False,
    axisymmetric: bool = False,
    refine: Space | None = None,
) -> MaterialPoints:
    """Fill a shape with material points. Collective.

    Every cell is divided into `per_cell` equal parts per direction: n, n² or n³ parts. Each part
    with its centre in the shape gets a point at the centre. On rectangular grids, parts that a
    `Box` cuts are trimmed to the box, so that volume and mass are exact. For other shapes,
    `volume_error` of the points is the relative error of their volume; more than 15 % is told by a
    `RoughShapeWarning`.

    With `exact`, every part that the surface of the shape cuts gets a point. The point has the
    volume and the centroid of the piece inside the shape. For shapes with a known volume and
    centroid, the volume and the centre of mass of the body are exact to rounding. These shapes are
    `Box`, `Ball`, `TurnedBox`, `Polygon`, and shapes whose `volume` and `centroid` are set. Pieces
    of a `Polygon` on a rectangular grid are exact, with faces at its edges; others are sampled. For
    combinations of shapes the volume is sampled, with an error of up to 1e-3 for a body eight
    cells wide, and of 4e-3 if a flat face lies between lines of the grid. Set the `volume` and
    the `centroid` of the combination (those of the section, if it is axisymmetric).

    Numbers of points follow the cells of the grid. They do not depend on the number of ranks.

    Args:
        grid: Background grid.
        shape: The shape.
        per_cell: Points per cell and direction.
        density: Mass per volume (kg/m^d): a number, or a function of positions, shape (gdim, n),
            that returns n values.
        aligned: "grid" divides the cells of the grid. "body" divides a `Box` or a `TurnedBox`
            into parts of nearly the same size that start at the corner of the box.
        tag: Number of the part of the body, from 0.
        exact: Whether parts that the surface cuts get points, see above.
        axisymmetric: Whether the shape is the section of an axisymmetric body about the axis
            x[0] = 0. Volumes are then 2π r times the areas of the parts. Masses, forces and
            energies are for the whole body.
        refine: A refined space, or None. The leaves that it wants now are divided instead of the
            cells of the grid. Points in leaves are families, as if larger points had split, see
            `mpm.families`. Give the space the same `per_cell`: points would
            split or merge from half or twice that number.

    Raises:
        ParameterError: An argument is not valid, or so few points cannot have the exact volume.
        ShapeOutsideGridError: The shape reaches outside the grid.
        EmptyShapeError: No point falls into the shape.
        UnsupportedGridError: The cells are curved, or coordinates have single precision;
            `aligned="body"` needs a rectangular grid. For axisymmetric points: the grid is not
            two-dimensional, or reaches beyond the axis.

    A box that ends in the middle of a row of cells is filled exactly:

    >>> from dolfinx.mesh import CellType, create_unit_square
    >>> from mpi4py import MPI
    >>> from dolfinmpm import Box
    >>> grid = create_unit_square(MPI.COMM_WORLD, 4, 4, CellType.quadrilateral)
    >>> points = fill(grid, Box((0, 0), (1, 0.625)), per_cell=2, density=1000.0)
    >>> len(points), float(points["V0"].sum())
    (40, 0.625)
    """
    require_grid(grid)
    aligned = _check_arguments(shape, per_cell, aligned, tag)
    # numbers of few bits would overflow
    per_cell = int(per_cell)
    check_per_cell(per_cell, grid.geometry.dim)
    exact, axisymmetric = truth("exact", exact), truth("axisymmetric", axisymmetric)
    if axisymmetric:
        require_axis(grid)
    if not callable(density):
        number("density", density, 0.0, unit="kg/m^d")
    _check_inside(grid, shape, axisymmetric)
    if aligned == "body":
        lattice = require_lattice(grid, 'aligned="body"')
        x, volume, half, cell, key = _divide_box(grid, lattice, shape, per_cell)
    else:
        divide = _cut if exact else _whole_parts
        parts = _parts(grid, lattice_of(grid), shape, per_cell, _refinement(grid, refine, per_cell))
        x, volume, half, cell, key = divide(grid, parts, shape)
    if grid.comm.allreduce(len(x), op=MPI.SUM) == 0:
        raise EmptyShapeError(
            f"no material point falls into the shape with {per_cell} points per cell and "
            "direction: use more points per cell, a finer grid or a larger shape"
        )

    rho: Any = density
    if callable(density):
        rho = call_together(grid.comm, lambda: call_function("density", density, x))
    ids = _numbers(grid.comm, key)
    whole = shape.volume
    if axisymmetric:
        volume = ring(x[:, 0], volume)
        # Pappus's theorem, if the centroid is known
        middle = None if shape.centroid is None else shape.centroid[0]
        whole = None if middle is None or whole is None else ring(middle, whole)
    points = MaterialPoints(
        grid, x, cell, volume, half, rho, tag=tag, id=ids, axisymmetric=axisymmetric
    )
    if whole is not None:
        total = grid.comm.allreduce(float(volume.sum()), op=MPI.SUM)
        points.shape_volume = float(whole)
        points.volume_error = error = (total - points.shape_volume) / points.shape_volume
        if abs(error) > _ROUGH:
            warn(
                grid.comm,
                f"the points have the volume {total:.4g}, and their shape has {whole:.4g}: "
                f"{100 * error:+.0f} %, more than {100 * _ROUGH:.0f} %. Parts of cells are in the "
                "shape if their centres are: take fill(..., exact=True), smaller cells or more "
                "points per cell",
                RoughShapeWarning,
            )
    return points


def _numbers(comm: MPI.Intracomm, key: Numbers) -> Numbers:
    """Numbers of points in the order of the keys of their parts. Collective."""
    if key.ndim == 1:
        return numbers_in_order(comm, key[:, None])
    first, own = np.unique(key[:, 0], return_inverse=True)
    return numbers_in_order(comm, first[:, None])[own] + (key[:, 1] << ROOT_BITS)


def _check_arguments(shape: Any, per_cell: Any, aligned: Any, tag: Any) -> str:
    """Check arguments of `fill`; returns the word for `aligned`."""
    if not isinstance(shape, Shape):
        hint = {
            True: "join bodies of points with +: fill(grid, a, ...) + fill(grid, b, ...)",
            False: "use mpm.Box, Ball, Polygon or Where(condition), joined with |, & and -",
        }[isinstance(shape, MaterialPoints)]
        raise ParameterError(f"fill takes one shape, got a {type(shape).__name__}; {hint}")
    if not isinstance(per_cell, (int, np.integer)) or isinstance(per_cell, bool) or per_cell < 1:
        raise ParameterError(
            f"per_cell = {shown(per_cell)} must be a whole number of at least 1: the number of "
            "points per cell and direction, such as 2 for 2² points per square"
        )
    whole("tag", tag, 0, np.iinfo(np.int32).max)
    return choice("aligned", aligned, ("grid", "body"))


def _check_inside(grid: Mesh, shape: Shape, axisymmetric: bool) -> None:
    low, high = bounds(grid)
    if shape.low is None or shape.high is None:
        return
    gdim = len(low)
    if len(shape.low) != gdim:
        raise ParameterError(
            f"{type(shape).__name__} has {len(shape.low)} coordinates, the grid has {gdim}"
        )
    slack = coordinate_rounding(low, high)
    if np.any(shape.low < low - slack) or np.any(shape.high > high + slack):
        cut = "enlarge the grid"
        if axisymmetric and shape.low[0] < 0.0:
            cut = "cut the shape at the axis, as in shape & mpm.Box((0, bottom), (radius, top))"
        raise ShapeOutsideGridError(
            f"the shape reaches from {shape.low} to {shape.high} m, the grid only from {low} to "
            f"{high} m; {cut}"
        )


def _refinement(grid: Mesh, space: Any, per_cell: int) -> Refinement | None:
    """The refinement of a space, checked."""
    if space is None:
        return None
    if not isinstance(space, Space) or space.grid is not grid:
        raise ParameterError(f"refine = {shown(space)} must be a mpm.Space on this grid")
    if space.refinement is None or space.per_cell is None:
        return space.refinement
    share = space.per_cell / per_cell
    if share > SPLITS or 2.0 * share < MERGES:
        raise ParameterError(
            f"per_cell = {per_cell}, and points follow the leaves of the space with per_cell = "
            f"{space.per_cell}: they would split or merge to that number before the first step; "
            f"give both the same, as in Space(..., per_cell={per_cell})"
        )
    return space.refinement


def _parts(
    grid: Mesh, lattice: Lattice | None, shape: Shape, n: int, refinement: Refinement | None
) -> Parts:
    """Parts of the cells that the shape touches. Collective."""
    if refinement is not None:
        return LeafParts(refinement, grid, n, shape.low, shape.high)

    def made() -> Parts:
        if lattice is None:
            return CellParts(grid, n, shape.low, shape.high)
        return LatticeParts(grid, lattice, n, shape.low, shape.high)

    return call_together(grid.comm, made)


def _whole_parts(grid: Mesh, parts: Parts, shape: Shape):
    """Parts with their centres in the shape; parts that a box cuts are trimmed. Collective."""
    if isinstance(parts, LatticeParts) and isinstance(shape, Box):
        return _trimmed(parts, shape)
    keep = call_together(grid.comm, lambda: np.flatnonzero(shape.contains(parts.x)))
    volume = parts.volume[keep]
    return (parts.x[keep], volume, parts.half_lengths(keep, volume), parts.cell[keep],
            parts.key[keep])  # fmt: skip


def _trimmed(parts: LatticeParts, shape: Box):
    low, high = parts.low, parts.high
    # a gap from rounding between a face of the box and a face of a part is no overlap
    slack = coordinate_rounding(low, high, _SLIVER)
    low = np.where(np.abs(low - shape.low) > slack, np.maximum(low, shape.low), low)
    high = np.where(np.abs(high - shape.high) > slack, np.minimum(high, shape.high), high)
    keep = np.all(high - low > slack, axis=1)
    low, high = low[keep], high[keep]
    return (0.5 * (low + high), np.prod(high - low, axis=1), 0.5 * (high - low),
            parts.cell[keep], parts.key[keep])  # fmt: skip


def _cut(grid: Mesh, parts: Parts, shape: Shape):
    """Pieces of the parts inside the shape, with the shape's volume and moments. Collective."""
    if isinstance(parts, LatticeParts) and isinstance(shape, Box):
        return _trimmed(parts, shape)
    pieces = call_together(grid.comm, lambda: pieces_inside(parts, shape))
    if grid.comm.allreduce(len(pieces.x), op=MPI.SUM):
        correct(grid.comm, pieces, shape)
    rows = pieces.rows
    half = parts.half_lengths(rows, pieces.volume, pieces.spread)
    return pieces.x, pieces.volume, half, parts.cell[rows], parts.key[rows]


def _divide_box(grid: Mesh, lattice: Lattice, shape: Shape, n: int):
    box = shape.box if isinstance(shape, TurnedBox) else shape
    if not isinstance(box, Box):
        raise ParameterError(
            f'aligned="body" needs a Box or a TurnedBox, got {type(shape).__name__}'
        )
    lines = []
    for low, high, size in zip(box.low, box.high, lattice.spacing):
        number = max(1, round((high - low) / (size / n)))
        lines.append(low + (np.arange(number) + 0.5) * (high - low) / number)
    check_amount(math.prod(line.size for line in lines), n)
    half = 0.5 * (box.high - box.low) / [line.size for line in lines]
    x: Array = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(lines))
    if isinstance(shape, TurnedBox):
        x = shape.turn(x)
    # every rank makes all points, and keeps the points in its own cells
    to = destinations(grid, x)
    mine = to.rank == grid.comm.rank
    x, key = x[mine], np.flatnonzero(mine)
    cell = to.cell[mine] - grid.topology.index_map(grid.topology.dim).local_range[0]
    half = np.broadcast_to(half, x.shape).copy()
    return x, np.full(len(x), np.prod(2 * half[0]) if len(x) else 0.0), half, cell, key
