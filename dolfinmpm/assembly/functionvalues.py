"""Values of DOLFINx functions at material points, on any distribution of the points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from dolfinmpm._platform.compat import interpolation_points
from dolfinmpm.body.exchange import exchange
from dolfinmpm.body.location import destinations
from dolfinmpm.body.points import MaterialPoints

__all__ = ["function_values"]

Array = npt.NDArray[np.float64]


def function_values(function: fem.Function, gradient: bool, points: MaterialPoints) -> Array:
    """Values of a DOLFINx function, or of its gradient, at the points. Collective.

    Args:
        function: The function.
        gradient: Whether the gradient is wanted.
        points: Material points.

    Returns:
        Values, shape (points, size).
    """
    if gradient:
        shape = (*function.ufl_shape, points.gdim)
        degree = max(function.function_space.ufl_element().embedded_superdegree, 1)
        space = fem.functionspace(points.grid, ("DG", degree, shape))
        slope = fem.Function(space)
        expression = fem.Expression(ufl.grad(function), interpolation_points(space.element))
        slope.interpolate(expression)
        function = slope
    if points.partition is None:
        return _values(function, points["x"], points["cell"])
    # ask the ranks that own the cells in DOLFINx's mesh
    comm, to = points.comm, destinations(points.grid, points["x"], points["cell"])
    first = points.grid.topology.index_map(points.gdim).local_range[0]
    row = np.arange(len(points), dtype=np.int64)
    asked = {"x": points["x"], "cell": to.cell, "row": row, "of": np.full(len(points), comm.rank)}
    asked = exchange(comm, asked, to.rank)
    found = _values(function, asked["x"], (asked["cell"] - first).astype(np.int32))
    back = exchange(comm, {"value": found, "row": asked["row"]}, asked["of"].astype(np.int32))
    result = np.empty_like(back["value"])
    result[back["row"]] = back["value"]
    return result


def _values(function: fem.Function, positions: Array, cells) -> Array:
    """Values of a DOLFINx function at positions in cells of this rank, shape (n, size)."""
    if len(positions) == 0:
        return np.empty((0, int(np.prod(function.ufl_shape, dtype=int))))
    x = np.zeros((len(positions), 3))
    x[:, : positions.shape[1]] = positions
    return np.ascontiguousarray(function.eval(x, cells)).reshape(len(positions), -1)
