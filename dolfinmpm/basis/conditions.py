"""Essential conditions: increments of nodes that are prescribed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.errors import (
    ConflictingConditionsError,
    ParameterError,
    call_together,
    raise_together,
)
from dolfinmpm.basis.space import Space

__all__ = ["Condition", "fixed", "prescribed", "rollers"]

Where = str | Callable[[npt.NDArray[np.float64]], npt.NDArray[np.bool_]]


@dataclass(frozen=True)
class Condition:
    """One component of a field prescribed at some nodes.

    Attributes:
        space: Space of the field.
        nodes: Local nodes, shape (n,).
        component: Component of the field.
        value: Increment of every step (m for a displacement): a number, a DOLFINx
            constant, or one number a node, shape (n,).
        where: What it says in messages.
    """

    space: Space
    nodes: npt.NDArray[np.int32]
    component: int
    value: float | fem.Constant | npt.NDArray[np.float64]
    where: str

    @property
    def changes(self) -> bool:
        """Whether the values may differ from zero in some step."""
        return isinstance(self.value, fem.Constant) or bool(np.any(self.increment != 0.0))

    @property
    def increment(self) -> npt.NDArray[np.float64]:
        """The values now, shape () or (n,)."""
        value = self.value.value if isinstance(self.value, fem.Constant) else self.value
        return np.asarray(value, float)


def _sides(gdim: int) -> dict[str, tuple[int, int]]:
    """Side → (axis, 0 for its lower or 1 for its upper end); bottom, top are on the last axis."""
    last = gdim - 1
    sides = {"left": (0, 0), "right": (0, 1), "bottom": (last, 0), "top": (last, 1)}
    if gdim == 3:
        sides |= {"front": (1, 0), "back": (1, 1)}
    return sides


def _node_coordinates(space: Space) -> npt.NDArray[np.float64]:
    return space.basis.node_coordinates()


def _nodes(space: Space, where: Where) -> tuple[npt.NDArray[np.int32], str]:
    x = _node_coordinates(space)
    comm, gdim = space.grid.comm, space.grid.geometry.dim
    if callable(where):
        chosen = call_together(
            comm, lambda: np.asarray(where(x.T) if len(x) else np.empty(0), dtype=bool)
        )
        name = getattr(where, "__name__", "condition")
    else:
        sides = _sides(gdim)
        if where not in sides:
            raise ParameterError(
                f"side {where!r} must be one of {', '.join(sides)}, or a function of positions"
            )
        axis, end = sides[where]
        low = min(comm.allgather(x[:, axis].min(initial=math.inf)))
        high = max(comm.allgather(x[:, axis].max(initial=-math.inf)))
        chosen = np.abs(x[:, axis] - (low, high)[end]) <= 1e-9 * (high - low)
        name = where
    nodes = np.flatnonzero(chosen).astype(np.int32)
    if comm.allreduce(nodes.size) == 0:
        raise ParameterError(f"no node of the grid lies where '{name}' says; check the coordinates")
    return nodes, name


def prescribed(
    space: Space,
    where: Where,
    component: int,
    value: float | fem.Constant | Callable[[npt.NDArray[np.float64]], npt.ArrayLike] = 0.0,
) -> list[Condition]:
    """Prescribe one component's increment in every step. Collective.

    Args:
        space: Space of the field.
        where: "left", "right" (first axis), "bottom", "top" (last axis), "front",
            "back" (second axis in 3D), or a function of node positions in DOLFINx's
            layout, shape (3, n), that returns n booleans.
        component: Component of the field.
        value: Increment a step (m for a displacement): a number, a DOLFINx constant,
            or a function of node positions like `where` that returns n numbers.
            When a step is halved, so is it.

    Raises:
        ParameterError: The side or the component is not known, or no node is there.
    """
    if not 0 <= component < space.components:
        raise ParameterError(
            f"component = {component} must be in 0 ... {space.components - 1} of this field"
        )
    nodes, name = _nodes(space, where)
    # UFL expressions are callable too
    constant = isinstance(value, fem.Constant)
    given: Any = value
    if callable(value) and not constant:
        at = _node_coordinates(space)[nodes]
        given = call_together(
            space.grid.comm, lambda: np.asarray(value(at.T) if len(at) else np.empty(0), float)
        )
    if not constant:
        given = np.asarray(given, float)
        finite = np.isfinite(given).all() and given.shape in ((), (nodes.size,))
        if not space.grid.comm.allreduce(bool(finite), op=MPI.LAND):
            raise ParameterError(
                f"prescribed increments at '{name}' must be finite, one number or one a node, got "
                f"shape {given.shape} for {nodes.size} nodes on this rank"
            )
    return [Condition(space, nodes, component, given, name)]


def fixed(space: Space, *where: Where) -> list[Condition]:
    """Hold all components. Collective; see `prescribed` for `where`."""
    return [
        condition
        for place in where
        for component in range(space.components)
        for condition in prescribed(space, place, component)
    ]


def rollers(space: Space, *sides: str) -> list[Condition]:
    """Hold the component across each side and leave those along it free. Collective.

    Args:
        space: Space of the displacement.
        sides: Names of sides of the grid; see `prescribed`.
    """
    axes = _sides(space.grid.geometry.dim)
    result = []
    for side in sides:
        component = axes[side][0] if side in axes else 0
        result += prescribed(space, side, component)
    return result


def apply_conditions(
    conditions: Sequence[Condition], spaces: Sequence[Space], fixed_, values, scale: float
) -> None:
    """Mark and set what the conditions prescribe at this rank's nodes. Collective.

    Args:
        conditions: The conditions.
        spaces: Spaces of the fields, in the order in which they are stacked.
        fixed_: Written, shape (nodes, components).
        values: Written, likewise.
        scale: Share of the step's increments.

    Raises:
        ConflictingConditionsError: An unknown is given two values.
        ParameterError: A condition is on a field that is not solved for.
    """
    starts = np.cumsum([0] + [space.components for space in spaces])
    error: Exception | None = None
    fixed_[:] = False
    owner = np.full(fixed_.shape, -1, np.int32)
    for number, condition in enumerate(conditions):
        matching = [k for k, space in enumerate(spaces) if space is condition.space]
        if not matching:
            raise ParameterError(
                f"the condition at '{condition.where}' is on a space that the problem does not "
                "solve for"
            )
        column = starts[matching[0]] + condition.component
        nodes = condition.nodes
        value = np.broadcast_to(scale * condition.increment, nodes.shape)
        differs = fixed_[nodes, column] & (values[nodes, column] != value)
        clash = nodes[differs]
        if clash.size and error is None:
            x = _node_coordinates(condition.space)[clash[0], : condition.space.grid.geometry.dim]
            other = conditions[owner[clash[0], column]]
            error = ConflictingConditionsError(
                f"component {condition.component} of the node at {x} m is prescribed as "
                f"{values[clash[0], column]} by '{other.where}' and as {value[differs][0]} by "
                f"'{condition.where}'; keep one of them"
            )
        fixed_[nodes, column] = True
        values[nodes, column] = value
        owner[nodes, column] = number
    raise_together(spaces[0].grid.comm, error)
