"""Cells of ParaView's grid files: those of the background grid, or leaves of a refined space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem, plot
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.location import bounds
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.leaves import Leaves
from dolfinmpm.io.vtkfiles import Arrays, vtk_cells, vtk_points

__all__ = ["GridMesh", "leaf_mesh", "padded"]

# VTK's numbers of an interval, a quadrilateral and a hexahedron, and its order of their corners
_KINDS = {1: 3, 2: 9, 3: 12}
_ORDERS = {1: [0, 1], 2: [0, 2, 3, 1], 3: [0, 4, 6, 2, 1, 5, 7, 3]}


class GridMesh:
    """This rank's own cells with the nodes of the increments, or else the nodes of the grid.

    Raises:
        ParameterError: The increments have no nodes, or different nodes.
    """

    def __init__(self, grid, functions: Sequence[fem.Function]):
        # collective calls come before errors, because only some ranks may have an error
        self.box = bounds(grid)
        self.cells = grid.topology.index_map(grid.topology.dim).size_local
        nodal = [f.function_space for f in functions if not _cellwise(f)]
        space = nodal[0] if nodal else fem.functionspace(grid, ("Lagrange", 1))
        try:
            topology, types, x = plot.vtk_mesh(space)
        except RuntimeError as cause:
            raise ParameterError(f"the increments cannot be written: {cause}") from cause
        for function in functions:
            other = function.function_space
            if not _cellwise(function) and not np.array_equal(other.dofmap.list, space.dofmap.list):
                raise ParameterError(
                    f"'{function.name}' has other nodes than '{functions[0].name}'; interpolate "
                    "it, or write it with a ParaView of its own"
                )
        rows = topology.reshape(self.cells, -1)[:, 1:] if self.cells else np.empty((0, 1), int)
        # nodes that only ghost cells have would appear as loose points
        self._nodes, connectivity = np.unique(rows, return_inverse=True)
        self._connectivity = connectivity.reshape(rows.shape)
        self._x = np.ascontiguousarray(x[self._nodes])
        self._type = int(types[0]) if self.cells else 0

    def vtk(self):
        """The mesh as a VTK object, without data."""
        return _unstructured(self._x, self._type, self._connectivity)

    def data(self, functions: Sequence[fem.Function]) -> tuple[Arrays, Arrays]:
        """Nodal and cell-wise values of the functions."""
        nodal: Arrays = {}
        constant: Arrays = {}
        for function in functions:
            dofmap, whole = function.function_space.dofmap, _cellwise(function)
            values = function.x.array.reshape(-1, dofmap.index_map_bs)
            rows = dofmap.list[: self.cells, 0] if whole else self._nodes
            target = constant if whole else nodal
            target[function.name] = padded(values[rows].reshape(-1, *function.ufl_shape))
        return nodal, constant


def leaf_mesh(leaves: Leaves, points: MaterialPoints) -> tuple[Any, Arrays]:
    """This rank's share of a refined space's cells, their `active` and `level`. Collective.

    The cells fill the grid: also parts of a cell without points are there.

    Args:
        leaves: Leaves, the same on all ranks.
        points: Material points of the space.
    """
    tree, comm = leaves.tree, points.comm
    every = np.flatnonzero(tree.child < 0)
    x = points.placement("updated").x
    _, found = leaves.overlapped(x, np.zeros_like(x))
    active = np.zeros(len(tree.low), np.uint8)
    active[leaves.node[found[found >= 0]]] = 1
    if comm.size > 1:
        comm.Allreduce(MPI.IN_PLACE, active, op=MPI.MAX)
    own = np.array_split(every, comm.size)[comm.rank]
    gdim = tree.low.shape[1]
    corners = np.array(list(np.ndindex(*(2,) * gdim)), np.int32)[_ORDERS[gdim]]
    fine = tree.low[own][:, None] + corners * tree.size[own][:, None, None]
    nodes, connectivity = np.unique(fine.reshape(-1, gdim), axis=0, return_inverse=True)
    mesh = _unstructured(
        padded(tree.coordinates(nodes)), _KINDS[gdim], connectivity.reshape(own.size, -1)
    )
    level = tree.levels - np.log2(tree.size[own]).astype(np.int8)
    return mesh, {"active": active[own][:, None], "level": level[:, None]}


def _unstructured(x: npt.NDArray[np.float64], kind: int, connectivity: npt.NDArray[np.int64]):
    """Cells of one kind as a VTK object."""
    from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid

    result = vtkUnstructuredGrid()
    result.SetPoints(vtk_points(x))
    result.SetCells(kind, vtk_cells(connectivity))
    return result


def _cellwise(function: fem.Function) -> bool:
    """Whether a function is piecewise constant."""
    return function.function_space.ufl_element().degree == 0


def padded(values: npt.NDArray[Any], zz: float = 0.0) -> npt.NDArray[Any]:
    """Values in ParaView's layout, shape (n, components): vectors of 3, tensors of 9."""
    n, shape = len(values), values.shape[1:]
    size = math.prod(shape)
    if len(shape) in (1, 2) and max(shape) <= 3 and len(set(shape)) == 1:
        full = np.zeros((n, *(3,) * len(shape)), values.dtype)
        if len(shape) == 2 and shape[0] < 3:
            full[:, range(shape[0], 3), range(shape[0], 3)] = zz
        full[(slice(None), *map(slice, shape))] = values
        values, size = full, 3 ** len(shape)
    return np.ascontiguousarray(values.reshape(n, size))
