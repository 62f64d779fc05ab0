"""Essential conditions on the leaves of a refined space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis import LeafBasis
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.grid.linecells import coordinate_rounding
from dolfinmpm.grid.sides import side_of
from dolfinmpm.grid.userfunctions import call_function, choose

__all__ = ["nodes_at_side", "on_leaves"]


def nodes_at_side(basis: LeafBasis, axis: int, end: int) -> npt.NDArray[np.int32]:
    """Nodes of leaves at a side of the grid, among all nodes that this rank knows, shape (n,).

    For splines these are the functions that do not vanish at the side.

    Args:
        basis: The basis on the leaves.
        axis, end: Direction of the side's normal, and 0 for its lower or 1 for its upper end.
    """
    line, x = basis.lattice.lines[axis], basis.node_coordinates()[:, axis]
    chosen = np.abs(x - line[-end]) <= coordinate_rounding(line[0], line[-1])
    return np.flatnonzero(chosen).astype(np.int32)


def on_leaves(condition: Condition, basis: LeafBasis) -> Condition:
    """The condition with its nodes and values on the present leaves.

    Args:
        condition: A condition of a refined space.
        basis: The basis on the leaves.

    Raises:
        ParameterError: Its values were given as one number per node of the grid.
    """
    x = basis.node_coordinates()[:, : basis.grid.geometry.dim]
    if callable(condition.chooses):
        chosen = choose("the function of places", condition.chooses, x)
        nodes = np.flatnonzero(chosen).astype(np.int32)
    else:
        nodes = nodes_at_side(basis, *side_of(condition.chooses, x.shape[1])[1:])
    value = condition.value
    if condition.function is not None:
        what = f"the {condition.kind} prescribed at '{condition.where}'"
        value = call_function(what, condition.function, x[nodes])
    elif not isinstance(value, fem.Constant) and np.ndim(value) > 0:
        raise ParameterError(
            f"the {condition.kind} prescribed at '{condition.where}' is one number per node of the "
            "grid, and the nodes of a refined space change: give a function of positions"
        )
    return replace(condition, nodes=nodes, value=value)
