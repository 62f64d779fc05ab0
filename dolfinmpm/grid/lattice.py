"""The background grid: the size of its cells, and the lattice of a rectangular grid."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, Mesh
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.compat import (
    compile_form,
    create_form,
    geometry_degree,
    geometry_dofmap,
)
from dolfinmpm._platform.errors import UnsupportedGridError
from dolfinmpm.grid.cellkinds import check_cells
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.linecells import FAR, coordinate_rounding

__all__ = ["Lattice", "cell_size", "coarse_cell_size", "lattice_of", "times_regridded"]


def once_per_grid(function: Callable) -> Callable:
    """Store the results of a function on its grid argument, which frees them with itself."""

    @functools.wraps(function)
    def wrapper(grid, *args):
        kept = getattr(grid, "_dolfinmpm", None)
        if kept is None:
            check_kind("grid", grid, Mesh, "give the background grid, points.grid")
            kept = grid._dolfinmpm = {}
        key = (function.__qualname__, *args)
        if key not in kept:
            kept[key] = function(grid, *args)
        return kept[key]

    return wrapper


def times_regridded(grid: Any) -> int:
    """How often the lines of a grid have moved."""
    return int(grid.__dict__.get("_dolfinmpm_regridded", 0))


_BOX_CELLS = (CellType.interval, CellType.quadrilateral, CellType.hexahedron)


@dataclass(frozen=True)
class Lattice:
    """A rectangular grid as the product of one line of coordinates per direction.

    Attributes:
        lines: One increasing array of node coordinates (m) per direction. The arrays cover the
            whole grid and are the same on every rank.
        cell_ijk: Lattice position of every local cell, shape (cells, gdim).
        uniform: Whether all cells have the same size, per direction.
    """

    lines: tuple[npt.NDArray[np.float64], ...]
    cell_ijk: npt.NDArray[np.int32]
    uniform: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells in each direction."""
        return tuple(line.size - 1 for line in self.lines)

    @property
    def spacing(self) -> npt.NDArray[np.float64]:
        """Mean size of the cells in each direction (m), shape (gdim,)."""
        return np.array([(line[-1] - line[0]) / (line.size - 1) for line in self.lines])

    def coarsened(self, by: int) -> Lattice:
        """The lattice of every `by`-th line.

        For each local cell of the grid, the `cell_ijk` of this lattice is the lattice position of
        the coarse cell that contains the cell.
        """
        if by == 1:
            return self
        lines = tuple(np.ascontiguousarray(line[::by]) for line in self.lines)
        return Lattice(lines, self.cell_ijk // by, self.uniform)

    def cells_at(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.int32]:
        """Lattice positions of the cells at positions x (m), shape (n, gdim).

        Outside the grid, the nearest cell is taken.
        """
        columns = []
        for d, line in enumerate(self.lines):
            if self.uniform:
                scale = (line.size - 1) / (line[-1] - line[0])
                with np.errstate(invalid="ignore"):
                    cell = np.nan_to_num(np.floor((x[:, d] - line[0]) * scale))
            else:
                cell = np.searchsorted(line, x[:, d], side="right") - 1
            columns.append(np.clip(cell, 0, line.size - 2))
        return np.column_stack(columns).astype(np.int32)

    def holds(self, x: npt.NDArray[np.float64], slack: float) -> npt.NDArray[np.bool_]:
        """Whether positions are inside the grid, shape (n,).

        Args:
            x: Positions (m), shape (n, gdim).
            slack: Distance outside the grid that still counts as inside, as a share of a cell.
        """
        inside = np.ones(len(x), bool)
        for d, line in enumerate(self.lines):
            margin = coordinate_rounding(line[0], line[-1], slack / (line.size - 1))
            inside &= (x[:, d] >= line[0] - margin) & (x[:, d] <= line[-1] + margin)
        return inside

    def index(self, coordinates: npt.NDArray[np.float64]) -> npt.NDArray[np.int32]:
        """Lattice positions of the nearest nodes to positions (m), shape (n, gdim)."""
        columns = []
        for d, line in enumerate(self.lines):
            right = np.clip(np.searchsorted(line, coordinates[:, d]), 1, line.size - 1)
            nearer_left = coordinates[:, d] - line[right - 1] < line[right] - coordinates[:, d]
            columns.append(right - nearer_left)
        return np.column_stack(columns).astype(np.int32)


def _global_line(comm: MPI.Comm, values: npt.NDArray[np.float64], tolerance: float):
    """Sorted coordinates of all ranks; coordinates closer than the tolerance are joined."""

    def unique(sorted_values):
        keep = np.ones(sorted_values.size, dtype=bool)
        keep[1:] = np.diff(sorted_values) > tolerance
        return sorted_values[keep]

    pieces = comm.allgather(unique(np.sort(values)))
    return unique(np.sort(np.concatenate(pieces)))


@once_per_grid
def lattice_of(grid: Mesh) -> Lattice | None:
    """The lattice of a rectangular grid, or None for any other grid. Collective.

    A grid is rectangular if its cells are axis-aligned boxes (intervals,
    quadrilaterals or hexahedra, graded or not) that fill one large box.
    """
    comm, gdim = grid.comm, grid.geometry.dim
    kind = grid.topology.cell_type
    if kind not in _BOX_CELLS or grid.topology.dim != gdim or geometry_degree(grid) != 1:
        return None
    x = np.asarray(grid.geometry.x[:, :gdim], float)
    vertices = geometry_dofmap(grid)
    # a rank without cells takes part in every call all the same
    low = comm.allgather(x.min(axis=0) if x.size else np.full(gdim, math.inf))
    high = comm.allgather(x.max(axis=0) if x.size else np.full(gdim, -math.inf))
    slack = coordinate_rounding(np.min(low, axis=0), np.max(high, axis=0))
    lines = tuple(_global_line(comm, x[:, d], slack[d]) for d in range(gdim))
    corners = x[vertices]
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    boxes = np.minimum(np.abs(corners - lower[:, None]), np.abs(corners - upper[:, None])) <= slack
    lattice = Lattice(lines, np.empty((0, gdim), np.int32), False)
    ijk = lattice.index(lower) if len(vertices) else np.empty((0, gdim), np.int32)
    one_apart = np.all(lattice.index(upper) - ijk == 1) if len(vertices) else True
    owned = grid.topology.index_map(gdim).size_global
    ok = bool(boxes.all() and one_apart and owned == math.prod(lattice.shape))
    if not comm.allreduce(ok, op=MPI.LAND):
        return None
    steps = [np.diff(line) for line in lines]
    uniform = all(
        np.ptp(s) <= max(1e-9 * s.mean() * line.size, coordinate_rounding(line[0], line[-1], 0.0))
        for s, line in zip(steps, lines)
    )
    if uniform:
        # rounding errors of the mesh generator must not decide the cell of a point on a grid line
        lines = tuple(np.linspace(line[0], line[-1], line.size) for line in lines)
    return Lattice(lines, ijk, uniform)


def require_lattice(grid: Mesh, what: str) -> Lattice:
    """The lattice of the grid, or an error. Collective.

    Args:
        grid: Background grid.
        what: Feature that needs the lattice, for the message.

    Raises:
        UnsupportedGridError: The grid is not rectangular.
    """
    lattice = lattice_of(grid)
    if lattice is None:
        # all else than a basis needs such a grid with any basis
        instead = 'use basis="linear", or make' if what.startswith("basis=") else "make"
        raise UnsupportedGridError(
            f"{what} needs a rectangular grid (axis-aligned intervals, quadrilaterals or "
            f"hexahedra that fill one box), got a grid of {grid.topology.cell_type.name}s that "
            f"is not rectangular; {instead} the grid with mpm.create_lattice, or with "
            "mesh.create_rectangle(..., mesh.CellType.quadrilateral), in 3D "
            "mesh.create_box(..., mesh.CellType.hexahedron)"
        )
    return lattice


@once_per_grid
def cell_volumes(grid: Mesh) -> npt.NDArray[np.float64]:
    """Volumes of the local cells (m^gdim), shape (cells,); exact for straight-sided cells."""
    space = fem.functionspace(grid, ("DG", 0))
    compiled = compile_form(grid.comm, ufl.TestFunction(space) * ufl.dx)
    volumes = fem.assemble_vector(create_form(compiled, [space], grid, {}, (), ()))
    volumes.scatter_forward()
    return np.abs(volumes.array)


@once_per_grid
@collective
def cell_size(grid: Mesh) -> fem.Constant | fem.Function:
    """Size of the cells, for UFL. Collective.

    The size of a box is the d-th root of its volume: the edge of a square or a cube. The size of a
    simplex is the d-th root of d! times its volume: the leg of an isosceles right-angled triangle.

    Returns:
        A Constant (m) where all cells have the same size; otherwise a piecewise
        constant function, which needs `ufl.avg` in a facet term.

    >>> import dolfinmpm as mpm
    >>> from dolfinx.mesh import create_unit_square
    >>> from mpi4py import MPI
    >>> float(mpm.cell_size(create_unit_square(MPI.COMM_WORLD, 4, 4)).value)
    0.25
    """
    check_cells(grid)
    gdim = grid.topology.dim
    simplex = grid.topology.cell_type in (CellType.triangle, CellType.tetrahedron)
    sizes = (cell_volumes(grid) * (math.factorial(gdim) if simplex else 1)) ** (1 / gdim)
    least = grid.comm.allreduce(sizes.min(initial=math.inf), op=MPI.MIN)
    largest = grid.comm.allreduce(sizes.max(initial=0.0), op=MPI.MAX)
    # edges of cells far from the origin are rounded by more
    far = FAR * grid.comm.allreduce(np.abs(grid.geometry.x).max(initial=0.0), op=MPI.MAX)
    if largest - least <= max(1e-9 * largest, far):
        return own_constant(grid, 0.5 * (least + largest))
    return _as_function(grid, sizes)


@once_per_grid
@collective
def leaf_size(grid: Mesh) -> fem.Function:
    """Size of the cells of a refined field, for UFL (m). Collective.

    Its values are the sizes of the grid's own cells. Terms over facets of leaves replace them by
    the size of the smaller leaf.
    """
    return _as_function(grid, cell_volumes(grid) ** (1 / grid.topology.dim))


@once_per_grid
@collective
def coarse_cell_size(grid: Mesh, by: int) -> fem.Constant | fem.Function:
    """Size of the cells of `Lattice.coarsened` (m), like `cell_size`. Collective."""
    size = cell_size(grid)
    if not isinstance(size, fem.Function):
        return own_constant(grid, by * float(size.value))
    lattice = require_lattice(grid, "a coarser field").coarsened(by)
    edges = [np.diff(line)[ijk] for line, ijk in zip(lattice.lines, lattice.cell_ijk.T)]
    return _as_function(grid, np.prod(edges, axis=0) ** (1 / len(edges)))


@once_per_grid
@collective
def cell_edges(grid: Mesh, by: int = 1) -> fem.Function | None:
    """Lengths of the edges of the cells in each direction, for UFL (m). Collective.

    Args:
        grid: The grid.
        by: Ratio of the field's cells to those of the grid, see `Lattice.coarsened`.

    Returns:
        A piecewise constant vector. None if the cells are equal squares or cubes, or no boxes:
        `cell_size` has their length in every direction.
    """
    lattice = lattice_of(grid)
    if lattice is None:
        return None
    steps = np.concatenate([np.diff(line) for line in lattice.lines])
    far = max(coordinate_rounding(line[0], line[-1], 0.0) for line in lattice.lines)
    return None if np.ptp(steps) <= max(1e-9 * steps.max(), far) else edge_function(grid, by)


def edge_function(grid: Mesh, by: int = 1) -> fem.Function:
    """Lengths of the edges of the cells of a rectangular grid, see `cell_edges`. Collective."""
    lattice = require_lattice(grid, "the lengths of edges").coarsened(by)
    edges = fem.Function(fem.functionspace(grid, ("DG", 0, (len(lattice.lines),))), name="edges")
    lengths = [np.diff(line)[ijk] for line, ijk in zip(lattice.lines, lattice.cell_ijk.T)]
    edges.x.array[:] = np.column_stack(lengths).ravel()
    edges._dolfinmpm_own = True
    return edges


def _as_function(grid: Mesh, sizes: npt.NDArray[np.float64]) -> fem.Function:
    """Sizes of the local cells (m) as a function that is marked as the library's own."""
    h = fem.Function(fem.functionspace(grid, ("DG", 0)), name="cell_size")
    h.x.array[:] = sizes
    h._dolfinmpm_own = True
    return h


def mean_size(h: fem.Constant | fem.Function) -> float:
    """Mean size of all cells (m), from `cell_size` or `coarse_cell_size`. Collective."""
    if not isinstance(h, fem.Function):
        return float(h.value)
    own = h.x.array[: h.function_space.dofmap.index_map.size_local]
    comm = h.function_space.mesh.comm
    total, count = comm.allreduce(np.array([own.sum(), own.size]), op=MPI.SUM)
    return float(total / count)


@once_per_grid
def smallest_height(grid: Mesh) -> float:
    """Least height of a cell (m): the shortest path of a wave across a cell. Collective."""
    lattice = lattice_of(grid)
    if lattice is not None:
        return float(min(np.diff(line).min() for line in lattice.lines))
    dim = grid.topology.dim
    simplex = grid.topology.cell_type in (CellType.triangle, CellType.tetrahedron)
    number = grid.topology.index_map(dim).size_local
    widest = grid.h(dim, np.arange(number, dtype=np.int32))
    # height >= volume over the area of the largest possible side
    heights = cell_volumes(grid)[:number] / widest ** (dim - 1) * (dim if simplex else 1)
    return float(grid.comm.allreduce(float(heights.min(initial=math.inf)), op=MPI.MIN))


@once_per_grid
def largest_cell(grid: Mesh) -> float:
    """Size of the largest cell (m), see `cell_size`. Collective."""
    h = cell_size(grid)
    sizes = h.x.array if isinstance(h, fem.Function) else np.array([h.value])
    return float(grid.comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX))
