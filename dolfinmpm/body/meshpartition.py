"""Where the cells of a mesh go, so that every rank has its share of the body."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import CellType, Mesh
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import coordinates
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.compat import adjacency_list
from dolfinmpm._platform.errors import ImbalanceWarning, ParameterError, raise_together, warn
from dolfinmpm.body.loadbalance import imbalance
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.shapes import Shape
from dolfinmpm.grid.lattice import lattice_of
from dolfinmpm.grid.partition import bisected

__all__ = ["partitioner", "warn_of_imbalance"]

Array = npt.NDArray[np.float64]

# What a cell without the body counts by one that it fills: it costs memory, and no time.
EMPTY = 1e-3
# Points of a rank by the mean beyond which they are worth a warning.
SPREAD = 2.0

# Local vertices of the facets, in DOLFINx's order
_FACETS = {
    CellType.interval: ((0,), (1,)),
    CellType.triangle: ((1, 2), (0, 2), (0, 1)),
    CellType.quadrilateral: ((0, 1), (0, 2), (1, 3), (2, 3)),
    CellType.tetrahedron: ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)),
    CellType.hexahedron: (
        (0, 1, 2, 3), (0, 1, 4, 5), (0, 2, 4, 6), (1, 3, 5, 7), (2, 3, 6, 7), (4, 5, 6, 7)
    ),
}  # fmt: skip


@collective(local=("vertices",))
def partitioner(shape: Shape, vertices: Mesh | npt.ArrayLike) -> Callable[..., Any]:
    """A cell partitioner for DOLFINx's meshes that gives every rank its share of a body.

    It is for grids that are not rectangular. Every rank gets the same number of cells that the
    shape overlaps, in one piece. Cells beyond facets to other ranks are ghosts.

    DOLFINx gives the cells to a partitioner, but not the positions of their vertices. A mesh
    that was made in the same way before has these positions:

        first = dolfinx.mesh.create_rectangle(comm, corners, cells)
        grid = dolfinx.mesh.create_rectangle(
            comm, corners, cells, partitioner=mpm.partitioner(slope, first))

    Every rank sees the vertices of the whole mesh while it is partitioned.

    Args:
        shape: The body.
        vertices: A mesh that was made of the same cells, or the coordinates (m) that this rank
            gives to `dolfinx.mesh.create_mesh`, shape (n, gdim).

    Returns:
        The argument `partitioner` of `dolfinx.mesh.create_mesh`, `create_rectangle` and others.
        This call is collective.

    Raises:
        ParameterError: `shape` is no shape.

    >>> import dolfinmpm as mpm
    >>> from dolfinx.mesh import create_unit_square
    >>> from mpi4py import MPI
    >>> first = create_unit_square(MPI.COMM_WORLD, 4, 4)
    >>> share = mpm.partitioner(mpm.Box((0, 0), (1, 0.5)), first)
    >>> grid = create_unit_square(MPI.COMM_WORLD, 4, 4, partitioner=share)
    >>> grid.topology.index_map(2).size_global
    32
    """
    if not isinstance(shape, Shape):
        raise ParameterError(f"shape = {shape!r} must be a shape, such as mpm.Box or mpm.Polygon")

    if not isinstance(vertices, Mesh):
        x = coordinates("vertices", vertices)
        d = x.shape[1] if x.ndim == 2 else 0
        if not 1 <= d <= 3 or (len(x) and shape.low is not None and len(shape.low) != d):
            raise ParameterError(
                f"vertices have the shape {x.shape} and must be a mesh, or coordinates (m) in the "
                "space of the shape, a row each"
            )
    # DOLFINx asks for the partition of a box on the first rank alone, which has all its cells:
    # what others know of the mesh is gathered here
    known = _vertices_of(vertices) if isinstance(vertices, Mesh) else None

    def partition(comm: MPI.Comm, parts: int, kinds: Any, cells: Any) -> Any:
        (kind,), (given,) = kinds, cells
        facets = np.array(_FACETS[kind])
        corners = int(facets.max()) + 1
        own = np.asarray(given, np.int64).reshape(-1, corners)
        counts = comm.allgather(len(own))
        whole = np.concatenate(comm.allgather(own))
        x, error = known, None
        if x is None:
            x = np.concatenate(comm.allgather(np.asarray(vertices, float)))
        if not np.isfinite(x).all():
            error = ParameterError("partitioner was given vertices that are not finite (m)")
        elif whole.max(initial=-1) >= len(x):
            error = ParameterError(
                f"the mesh has a vertex {whole.max()}, and partitioner was given {len(x)} of them: "
                "give it the coordinates that create_mesh gets, or a mesh of the same cells"
            )
        raise_together(comm, error)
        part = bisected(x[whole].mean(axis=1), _weights(shape, x, whole), parts)
        first = sum(counts[: comm.rank])
        return _destinations(part, whole, facets, first, len(own))

    return partition


def _vertices_of(grid: Mesh) -> Array:
    """Coordinates of all vertices (m), in the order of the mesh's input. Collective."""
    geometry = grid.geometry
    own = np.asarray(geometry.x[:, : geometry.dim])
    pieces = grid.comm.allgather((np.asarray(geometry.input_global_indices), own))
    x = np.empty((1 + max(int(i.max(initial=-1)) for i, _ in pieces), geometry.dim))
    for index, values in pieces:
        x[index] = values
    return x


def _weights(shape: Shape, x: Array, cells: npt.NDArray[np.int64]) -> Array:
    """Share of cells that the shape fills, by some places in them; next to nothing of others."""
    corner = x[cells]
    middle = corner.mean(axis=1)
    inside = np.zeros(len(cells))
    # corners, but a little within the cell; midway to them; and the middle
    for k in range(corner.shape[1]):
        for share in (0.01, 0.5):
            inside += shape.contains(corner[:, k] + share * (middle - corner[:, k]))
    inside += shape.contains(middle)
    return EMPTY + inside / (1 + 2 * corner.shape[1])


def _destinations(
    part: npt.NDArray[np.int32],
    cells: npt.NDArray[np.int64],
    facets: npt.NDArray[np.intp],
    first: int,
    count: int,
) -> Any:
    """Ranks of this rank's cells, the owner first and then those that have it as a ghost."""
    number, per_cell = len(cells), len(facets)
    corners = np.sort(cells[:, facets].reshape(number * per_cell, -1), axis=1)
    order = np.lexsort(corners.T)
    same = np.flatnonzero(np.all(corners[order[1:]] == corners[order[:-1]], axis=1))
    a, b = order[same] // per_cell, order[same + 1] // per_cell
    cell, rank = np.concatenate([a, b]), np.concatenate([part[b], part[a]])
    ghost = (part[cell] != rank) & (cell >= first) & (cell < first + count)
    pairs = np.unique(np.stack([cell[ghost] - first, rank[ghost]], axis=1), axis=0)
    owner = np.stack([np.arange(count), part[first : first + count]], axis=1)
    every = np.concatenate([owner, pairs])
    order = np.argsort(every[:, 0], kind="stable")
    offsets = np.zeros(count + 1, np.int32)
    np.cumsum(np.bincount(every[:, 0], minlength=count), out=offsets[1:])
    return adjacency_list(every[order, 1].astype(np.int32), offsets)


def warn_of_imbalance(points: MaterialPoints) -> None:
    """Warn where points on a mesh that is no lattice are spread badly. Collective."""
    comm, total = points.comm, points.total
    if lattice_of(points.grid) is not None:
        return
    most = imbalance(points)
    if most > SPREAD:
        warn(
            comm,
            f"a rank has {most:.2f} times the mean number of material points, {total} on "
            f"{comm.size} ranks, and others wait for it; make the mesh with "
            "partitioner=mpm.partitioner(shape, mesh), which gives every rank its share of the "
            "body's cells",
            ImbalanceWarning,
        )
