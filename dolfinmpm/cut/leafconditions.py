"""Essential conditions at the nodes of leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from dolfinx import fem

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis import LeafBasis
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.grid.sides import side_of
from dolfinmpm.grid.userfunctions import call_function, choose

__all__ = ["on_leaves"]


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
    else:
        _, axis, end = side_of(condition.chooses, x.shape[1])
        line = basis.lattice.lines[axis]
        chosen = np.abs(x[:, axis] - line[-end]) <= 1e-9 * (line[-1] - line[0])
    nodes = np.flatnonzero(chosen).astype(np.int32)
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
