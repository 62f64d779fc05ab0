"""Values of a DOLFINx function, cell by cell: a layout that can move from rank to rank."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm._platform.errors import CheckpointError

__all__ = ["set_values", "values_of_cells"]

Array = npt.NDArray[np.float64]


def _nodes(function: fem.Function) -> tuple[npt.NDArray[np.int32], Array, int]:
    """Nodes of the owned cells, positions of all nodes on this rank, and values per node."""
    space = function.function_space
    grid = space.mesh
    try:
        x = space.tabulate_dof_coordinates()
    except RuntimeError as cause:
        raise CheckpointError(
            f"the function '{function.name}' of the element {space.ufl_element()} has no values "
            "at nodes; interpolate it into a Lagrange or a discontinuous Lagrange space"
        ) from cause
    owned = grid.topology.index_map(grid.topology.dim).size_local
    return space.dofmap.list[:owned], x[:, : grid.geometry.dim], space.dofmap.bs


def values_of_cells(function: fem.Function, array: Array) -> Array:
    """Positions (m) of the nodes of every owned cell, and the values at the nodes.

    Args:
        function: A function of a space with values at nodes.
        array: Degrees of freedom of the function on this rank.

    Returns:
        Positions and values, shape (owned cells, nodes per cell, gdim + values per node).

    Raises:
        CheckpointError: The space of the function has no values at nodes.
    """
    nodes, x, each = _nodes(function)
    return np.concatenate([x[nodes], array.reshape(-1, each)[nodes]], axis=2)


def set_values(function: fem.Function, rows: Array) -> None:
    """Set a function to values that `values_of_cells` returned. Collective.

    The values may come from another rank, or from another run. The order of the nodes in a cell
    can therefore differ. Nodes are matched by their positions.

    Args:
        function: The function; its space has the same element as the space of the values.
        rows: Positions and values of the owned cells, see `values_of_cells`, in the order of the
            cells of `function`.
    """
    nodes, x, each = _nodes(function)
    gdim = x.shape[1]
    apart = np.abs(rows[:, None, :, :gdim] - x[nodes][:, :, None, :]).max(axis=3)
    nearest = np.argmin(apart, axis=2)
    values = np.take_along_axis(rows[:, :, gdim:], nearest[:, :, None], axis=1)
    function.x.array.reshape(-1, each)[nodes] = values
    function.x.scatter_forward()
