"""Values of a DOLFINx function cell by cell, in which they can go from rank to rank."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm._platform.errors import FormError

__all__ = ["set_values", "values_of_cells"]

Array = npt.NDArray[np.float64]


def _nodes(function: fem.Function) -> tuple[npt.NDArray[np.int32], Array, int]:
    """Nodes of the owned cells, positions of all nodes here, and values per node."""
    space = function.function_space
    grid = space.mesh
    try:
        x = space.tabulate_dof_coordinates()
    except RuntimeError as cause:
        raise FormError(
            f"the function '{function.name}' of the element {space.ufl_element()} has no values "
            "at nodes; interpolate it into a Lagrange or a discontinuous Lagrange space"
        ) from cause
    owned = grid.topology.index_map(grid.topology.dim).size_local
    return space.dofmap.list[:owned], x[:, : grid.geometry.dim], space.dofmap.bs


def values_of_cells(function: fem.Function, array: Array) -> Array:
    """Positions of the nodes of every owned cell, and the values there.

    Args:
        function: A function of a space with values at nodes.
        array: Its degrees of freedom on this rank.

    Returns:
        Shape (owned cells, nodes of a cell, gdim + values per node).

    Raises:
        FormError: Its space has no values at nodes.
    """
    nodes, x, each = _nodes(function)
    return np.concatenate([x[nodes], array.reshape(-1, each)[nodes]], axis=2)


def set_values(function: fem.Function, rows: Array) -> None:
    """Set a function to what `values_of_cells` returned for one like it. Collective.

    The nodes of a cell are told by their positions, for their order may be another.

    Args:
        function: The function.
        rows: Nodes and values of the owned cells, in the order of the cells.
    """
    nodes, x, each = _nodes(function)
    gdim = x.shape[1]
    apart = np.abs(rows[:, None, :, :gdim] - x[nodes][:, :, None, :]).max(axis=3)
    nearest = np.argmin(apart, axis=2)
    values = np.take_along_axis(rows[:, :, gdim:], nearest[:, :, None], axis=1)
    function.x.array.reshape(-1, each)[nodes] = values
    function.x.scatter_forward()
