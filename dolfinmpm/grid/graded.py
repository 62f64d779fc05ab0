"""Rectangular grids with a fine zone, which may move from step to step.

The grid carries no state between steps: the points carry all state. The grid lines may therefore
move between steps, if their number stays. Cells and nodes then keep their numbers, and DOLFINx's
spaces, the distribution over ranks and compiled forms stay valid.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, floats, number, shown, whole
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, UnsupportedGridError
from dolfinmpm.grid.lattice import (
    cell_size,
    coarse_cell_size,
    edge_function,
    lattice_of,
    require_lattice,
    times_regridded,
)

__all__ = ["create_lattice", "set_lines", "zoned_line"]

Array = npt.NDArray[np.float64]

# Functions whose values are kept on a grid when its lines move. Most of these values do not depend
# on coordinates. The sizes of cells are functions in forms and get new values.
_SIZES = ("cell_size", "coarse_cell_size", "cell_edges")
_KEPT = ("_basis_of", "ghost_facets", "_constants_by_cell", *_SIZES)
# Largest ratio of neighbouring cells outside a zone
_STEEPEST = 3.0


def zoned_line(
    low: float, high: float, zone: tuple[float, float], cells: tuple[int, int, int]
) -> Array:
    """Coordinates of grid lines in one direction, with equal cells in a zone.

    Outside the zone the sizes of cells are geometric series that begin at the zone. Another zone
    with the same numbers of cells gives the same number of lines.

    Args:
        low, high: First and last coordinate (m).
        zone: First and last coordinate of the zone (m).
        cells: Numbers of cells before, in and after the zone.

    Returns:
        Coordinates of the lines (m), increasing, shape (sum of cells + 1,).

    Raises:
        ParameterError: The zone is not within the grid; a side has cells without room, or room
            without cells; or neighbouring cells would differ by more than 3 times.

    >>> import dolfinmpm as mpm
    >>> mpm.zoned_line(0, 5, zone=(1, 2), cells=(2, 4, 4)).round(2).tolist()
    [0.0, 0.61, 1.0, 1.25, 1.5, 1.75, 2.0, 2.37, 2.93, 3.76, 5.0]
    """
    number("low", low, unit="m"), number("high", high, unit="m")
    for what, given, n in (("zone", zone, 2), ("cells", cells, 3)):
        if not isinstance(given, (tuple, list, np.ndarray)) or len(given) != n:
            words = "first and last coordinate (m)" if n == 2 else "before, in and after the zone"
            raise ParameterError(f"{what} = {shown(given)} must be {n} numbers, {words}")
    a, b = (number(f"zone[{k}]", value, unit="m") for k, value in enumerate(zone))
    before, within, after = (whole(f"cells[{k}]", c, 0) for k, c in enumerate(cells))
    if not low <= a < b <= high or within < 1:
        raise ParameterError(
            f"zone = ({a:g}, {b:g}) m with {within} cells must lie within {low:g} ... {high:g} m "
            "and have at least one cell"
        )
    h = (b - a) / within
    first = a - _graded(a - low, before, h)[::-1]
    last = b + _graded(high - b, after, h)
    line = np.concatenate([first, np.linspace(a, b, within + 1), last])
    line[0], line[-1] = low, high
    return line


def _graded(length: float, cells: int, h: float) -> Array:
    """Ends of cells (m) that fill a length, graded from a neighbour of size h."""
    if cells == 0 and length == 0:
        return np.empty(0)
    if cells == 0 or length <= 0:
        raise ParameterError(
            f"{cells} cells beside the zone have {length:g} m; give cells if there is room, and "
            "room if there are cells"
        )

    def total(ratio: float) -> float:
        return h * float(np.sum(ratio ** np.arange(1, cells + 1)))

    lower, upper = 1.0 / _STEEPEST, _STEEPEST
    if not total(lower) <= length <= total(upper):
        raise ParameterError(
            f"{cells} cells beside a zone with cells of {h:g} m cannot fill {length:g} m unless "
            f"neighbours differ by more than {_STEEPEST:g} times; give "
            f"{'more' if length > total(upper) else 'fewer'} cells"
        )
    for _ in range(200):
        middle = 0.5 * (lower + upper)
        lower, upper = (middle, upper) if total(middle) < length else (lower, middle)
    sizes = (0.5 * (lower + upper)) ** np.arange(1, cells + 1)
    return np.cumsum(sizes) * (length / sizes.sum())


@collective
def create_lattice(comm: MPI.Intracomm, lines: Sequence[npt.ArrayLike]) -> mesh.Mesh:
    """A rectangular grid with given lines. Collective.

    Args:
        comm: Communicator.
        lines: Increasing coordinates of the lines (m), one array per direction, in 2D or 3D.

    Raises:
        ParameterError: The lines are not two or three arrays of increasing coordinates.

    Cells of 1 m, and finer cells near the bottom:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), (0.0, 0.25, 0.5, 1.0, 2.0)])
    >>> grid.topology.index_map(2).size_global
    16
    """
    check_kind("comm", comm, MPI.Comm, "give MPI.COMM_WORLD, and then the lines")
    made = _lines(lines)
    low, high = [line[0] for line in made], [line[-1] for line in made]
    count = [line.size - 1 for line in made]
    if len(made) == 2:
        grid = mesh.create_rectangle(comm, [low, high], count, mesh.CellType.quadrilateral)
    else:
        grid = mesh.create_box(comm, [low, high], count, mesh.CellType.hexahedron)
    x = grid.geometry.x
    for d, line in enumerate(made):
        place = np.rint((x[:, d] - line[0]) / (line[-1] - line[0]) * count[d]).astype(int)
        x[:, d] = line[place]
    return grid


def set_lines(grid: mesh.Mesh, lines: Sequence[npt.ArrayLike]) -> None:
    """Move the lines of a rectangular grid. Collective.

    `regrid` also tells the problems on the grid.

    Args:
        grid: The grid.
        lines: New coordinates of the lines (m), with the same number of lines per direction.

    Raises:
        ParameterError: The lines are no increasing coordinates, or their number differs.
        UnsupportedGridError: The grid is not rectangular, or all its cells had the same size.
            Forms on such a grid contain the size as a constant.
    """
    lattice, made = require_lattice(grid, "laying lines anew"), _lines(lines)
    if [line.size for line in made] != [line.size for line in lattice.lines]:
        raise ParameterError(
            f"lines have {[line.size for line in made]} coordinates, and the grid has "
            f"{[line.size for line in lattice.lines]} lines; give the same number"
        )
    h = cell_size(grid)
    if not isinstance(h, fem.Function):
        raise UnsupportedGridError(
            "all cells of the grid have one size, and forms on the grid contain this size as a "
            "constant; make the grid with a zone from the start, with mpm.create_lattice"
        )
    x = grid.geometry.x
    ijk = lattice.index(np.asarray(x[:, : len(made)], float))
    for d, line in enumerate(made):
        x[:, d] = line[ijk[:, d]]
    kept = grid.__dict__["_dolfinmpm"]
    for key in [key for key in kept if key[0] not in _KEPT]:
        del kept[key]
    makers: dict[str, Any] = dict(zip(_SIZES, (cell_size, coarse_cell_size, edge_function)))
    for key in [key for key in kept if key[0] in makers]:
        found = kept.pop(key)
        values = makers[key[0]](grid, *key[1:])
        sizes = values.x.array if isinstance(values, fem.Function) else float(values.value)
        found.x.array[:] = sizes
        kept[key] = found
    grid.__dict__["_dolfinmpm_regridded"] = times_regridded(grid) + 1
    assert lattice_of(grid) is not None


def _lines(lines: Any) -> list[Array]:
    """Lines as arrays, checked."""
    if not isinstance(lines, (list, tuple)) or len(lines) not in (2, 3):
        raise ParameterError(f"lines = {shown(lines)} must be two or three arrays of coordinates")
    made = []
    for d, line in enumerate(lines):
        values = floats(line)
        good = values is not None and values.ndim == 1 and values.size > 1
        if values is None or not (
            good and np.isfinite(values).all() and (np.diff(values) > 0).all()
        ):
            raise ParameterError(
                f"lines[{d}] = {shown(line)} must be two or more increasing coordinates (m)"
            )
        made.append(values)
    return made
