"""Fill a shape with material points."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.compat import geometry_degree, geometry_dofmap
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    ParameterError,
    ShapeOutsideGridError,
    UnsupportedGridError,
    call_together,
)
from dolfinmpm.basis.cells import BOX
from dolfinmpm.basis.linear import kind_of
from dolfinmpm.body.location import destinations
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.shapes import Box, Shape, TurnedBox
from dolfinmpm.grid.lattice import Lattice, lattice_of, require_lattice

__all__ = ["fill"]

Array = npt.NDArray[np.float64]
Density = float | Callable[[Array], Array]

# Slivers below this share of a sub-cell come from rounding, not from the shape.
_SLIVER = 1e-9


def fill(
    grid: Mesh,
    shape: Shape,
    per_cell: int,
    density: Density,
    aligned: str = "grid",
    tag: int = 0,
) -> MaterialPoints:
    """Place material points in a shape. Collective.

    Every cell is divided into `per_cell` equal parts in each direction, and a
    point is put at the centre of each part whose centre is in the shape: n, n² or
    n³ points a cell. On rectangular grids the parts that a `Box` cuts are
    trimmed to it, so that volume and mass are exact.

    Args:
        grid: Background grid.
        shape: What to fill.
        per_cell: Points a cell and direction.
        density: Mass per volume (kg/m^d): a number, or a function of positions in
            DOLFINx's layout, shape (gdim, n), that returns n values.
        aligned: "grid" divides the cells of the grid; "body" divides a `Box` or a
            `TurnedBox` into parts of the same size that start at its own corner,
            wherever the grid's lines are.
        tag: Number of the part of the body that these points are, from 0.

    Raises:
        ParameterError: `per_cell`, `density` or `aligned` is not what it may be.
        ShapeOutsideGridError: The shape reaches outside the grid.
        EmptyShapeError: No point falls into the shape.
        UnsupportedGridError: The cells are curved, or `aligned="body"` is asked for
            on a grid that is not rectangular.

    A box that ends in the middle of a row of cells is filled exactly:

    >>> from dolfinx.mesh import CellType, create_unit_square
    >>> from mpi4py import MPI
    >>> from dolfinmpm import Box
    >>> grid = create_unit_square(MPI.COMM_WORLD, 4, 4, CellType.quadrilateral)
    >>> points = fill(grid, Box((0, 0), (1, 0.625)), per_cell=2, density=1000.0)
    >>> len(points), float(points["V0"].sum())
    (40, 0.625)
    """
    if not isinstance(per_cell, (int, np.integer)) or per_cell < 1:
        raise ParameterError(f"per_cell = {per_cell!r} must be a whole number of at least 1")
    if aligned not in ("grid", "body"):
        raise ParameterError(f'aligned = {aligned!r} must be "grid" or "body"')
    if not isinstance(tag, (int, np.integer)) or tag < 0:
        raise ParameterError(f"tag = {tag!r} must be a whole number of at least 0")
    if geometry_degree(grid) != 1 or grid.topology.dim != grid.geometry.dim:
        raise UnsupportedGridError(
            "the background grid must have straight-sided cells of the dimension of space, got "
            f"degree {geometry_degree(grid)}, cells of dimension {grid.topology.dim} in "
            f"{grid.geometry.dim}D"
        )
    _check_inside(grid, shape)
    lattice = lattice_of(grid)
    if aligned == "body":
        x, volume, half, cell = _divide_box(
            grid, require_lattice(grid, 'aligned="body"'), shape, per_cell
        )
    else:
        x, volume, half, cell = call_together(
            grid.comm,
            lambda: (
                _divide_cells(grid, shape, per_cell)
                if lattice is None
                else _divide_lattice(grid, lattice, shape, per_cell)
            ),
        )
    if grid.comm.allreduce(len(x), op=MPI.SUM) == 0:
        raise EmptyShapeError(
            f"no material point falls into the shape with {per_cell} points a cell and direction; "
            "use more points a cell, a finer grid or a larger shape"
        )

    def evaluate():
        # a function is not asked about no points: many cannot answer
        if not callable(density):
            return density
        rho = np.asarray(density(np.ascontiguousarray(x.T)) if len(x) else np.empty(0), float)
        if rho.shape not in ((), (len(x),)):
            raise ParameterError(f"density should have shape ({len(x)},) here, got {rho.shape}")
        return rho

    return MaterialPoints(grid, x, cell, volume, half, call_together(grid.comm, evaluate), tag)


def _check_inside(grid: Mesh, shape: Shape) -> None:
    x = grid.geometry.x[:, : grid.geometry.dim]
    gdim = x.shape[1]
    low = np.min(grid.comm.allgather(x.min(axis=0, initial=math.inf)), axis=0)
    high = np.max(grid.comm.allgather(x.max(axis=0, initial=-math.inf)), axis=0)
    if shape.low is None or shape.high is None:
        return
    if len(shape.low) != gdim:
        raise ParameterError(
            f"{type(shape).__name__} has {len(shape.low)} coordinates, the grid has {gdim}"
        )
    slack = 1e-9 * (high - low)
    if np.any(shape.low < low - slack) or np.any(shape.high > high + slack):
        raise ShapeOutsideGridError(
            f"the shape reaches from {shape.low} to {shape.high} m, the grid only from {low} to "
            f"{high} m; enlarge the grid"
        )


def _owned(grid: Mesh) -> int:
    return grid.topology.index_map(grid.topology.dim).size_local


def _divide_lattice(grid: Mesh, lattice: Lattice, shape: Shape, n: int):
    gdim = len(lattice.lines)
    ijk = lattice.cell_ijk[: _owned(grid)]
    lower = np.column_stack([lattice.lines[d][ijk[:, d]] for d in range(gdim)])
    upper = np.column_stack([lattice.lines[d][ijk[:, d] + 1] for d in range(gdim)])
    if shape.low is not None and shape.high is not None:
        near = np.all((upper >= shape.low) & (lower <= shape.high), axis=1)
    else:
        near = np.ones(len(ijk), bool)
    cells = np.flatnonzero(near).astype(np.int32)
    parts = np.array(list(itertools.product(range(n), repeat=gdim)))
    size = (upper[cells] - lower[cells])[:, None] / n
    low: Array = (lower[cells][:, None] + parts * size).reshape(-1, gdim)
    high: Array = (lower[cells][:, None] + (parts + 1) * size).reshape(-1, gdim)
    cell = np.repeat(cells, len(parts))
    if isinstance(shape, Box) and shape.low is not None and shape.high is not None:
        # what rounding left between a face of the box and a face of a part is no overlap
        slack = _SLIVER * (high - low)
        low = np.where(np.abs(low - shape.low) > slack, np.maximum(low, shape.low), low)
        high = np.where(np.abs(high - shape.high) > slack, np.minimum(high, shape.high), high)
        keep = np.all(high - low > slack, axis=1)
    else:
        keep = shape.contains(0.5 * (low + high))
    low, high, cell = low[keep], high[keep], cell[keep]
    return 0.5 * (low + high), np.prod(high - low, axis=1), 0.5 * (high - low), cell


def _divide_box(grid: Mesh, lattice: Lattice, shape: Shape, n: int):
    box = shape.box if isinstance(shape, TurnedBox) else shape
    if not isinstance(box, Box):
        raise ParameterError(
            f'aligned="body" needs a Box or a TurnedBox, got {type(shape).__name__}'
        )
    assert box.low is not None
    assert box.high is not None
    lines = []
    for low, high, size in zip(box.low, box.high, lattice.spacing):
        number = max(1, round((high - low) / (size / n)))
        lines.append(low + (np.arange(number) + 0.5) * (high - low) / number)
    half = 0.5 * (box.high - box.low) / [line.size for line in lines]
    x: Array = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(lines))
    if isinstance(shape, TurnedBox):
        x = shape.turn(x)
    # every rank makes all the points and keeps those whose cells it owns
    to = destinations(grid, x)
    mine = to.rank == grid.comm.rank
    x = x[mine]
    cell = to.cell[mine] - grid.topology.index_map(grid.topology.dim).local_range[0]
    half = np.broadcast_to(half, x.shape).copy()
    return x, np.full(len(x), np.prod(2 * half[0]) if len(x) else 0.0), half, cell


def _divide_cells(grid: Mesh, shape: Shape, n: int):
    gdim = grid.geometry.dim
    corners = grid.geometry.x[:, :gdim][geometry_dofmap(grid)[: _owned(grid)]]
    kind = kind_of(grid)
    xi = _box_parts(n, gdim) if kind == BOX else _simplex_parts(n, gdim)
    if kind == BOX:
        bits = (np.arange(2**gdim)[:, None] >> np.arange(gdim)) & 1
        N = np.prod(np.where(bits, xi[:, None], 1 - xi[:, None]), axis=2)
        slopes = np.where(bits, 1.0, -1.0)
        dN = np.empty((len(xi), 2**gdim, gdim))
        for j in range(gdim):
            others = [i for i in range(gdim) if i != j]
            factors = np.where(
                bits[:, others], xi[:, None][..., others], 1 - xi[:, None][..., others]
            )
            dN[..., j] = slopes[:, j] * np.prod(factors, axis=2)
        share = 1.0
    else:
        N = np.column_stack([1 - xi.sum(axis=1), xi])
        gradient = np.vstack([-np.ones(gdim), np.eye(gdim)])
        dN = np.broadcast_to(gradient, (len(xi), *gradient.shape))
        share = 1 / math.factorial(gdim)
    x = np.einsum("qa,cai->cqi", N, corners)
    # the volume of a part, by the Jacobian at its centre
    J = np.einsum("qaj,cai->cqij", dN, corners)
    volume = np.abs(np.linalg.det(J)) * share / len(xi)
    cell = np.repeat(np.arange(len(corners), dtype=np.int32), len(xi))
    x, volume = x.reshape(-1, gdim), volume.ravel()
    keep = shape.contains(x)
    half = np.repeat(0.5 * volume[keep, None] ** (1 / gdim), gdim, axis=1)
    return x[keep], volume[keep], half, cell[keep]


def _box_parts(n: int, gdim: int) -> Array:
    line = (np.arange(n) + 0.5) / n
    return np.stack(np.meshgrid(*[line] * gdim, indexing="ij"), axis=-1).reshape(-1, gdim)


def _simplex_parts(n: int, gdim: int) -> Array:
    """Centroids of the n^d equal parts of the reference simplex.

    The cubes of a lattice are cut along the orderings of their coordinates
    (Freudenthal 1942); those parts that lie in 1 ≥ s_1 ≥ ... ≥ s_d ≥ 0 tile it.
    """
    centroids = []
    for cube in itertools.product(range(n), repeat=gdim):
        for order in itertools.permutations(range(gdim)):
            corner = np.array(cube, float)
            total = corner.copy()
            for axis in order:
                corner[axis] += 1
                total += corner
            s = total / (gdim + 1) / n
            if np.all(np.diff(np.concatenate([[1.0], s, [0.0]])) <= 0):
                centroids.append(s - np.append(s[1:], 0.0))
    return np.array(centroids)
