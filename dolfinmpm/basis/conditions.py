"""Essential conditions: increments of nodes that are prescribed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import at_time, choice, number, shown, truth, whole
from dolfinmpm._platform.errors import (
    IdleConditionWarning,
    ParameterError,
    call_together,
    raise_together,
    warn,
)
from dolfinmpm._platform.together import together
from dolfinmpm.basis.space import Space
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.positions import ask, choose

__all__ = [
    "Condition",
    "fixed",
    "free_motions",
    "idle",
    "moving",
    "prescribed",
    "rollers",
    "side_of",
    "warn_idle",
]

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
        velocity: Velocity that it is to have (m/s) at a time (s), or None; steps in time then set
            the value, a constant.
        whole: Whether the value is that of the field itself, which parts of a step have in full.
        place: Function of positions that says where in every step anew, or None.
    """

    space: Space
    nodes: npt.NDArray[np.int32]
    component: int
    value: float | fem.Constant | npt.NDArray[np.float64]
    where: str
    velocity: Callable[[float], float] | None = None
    whole: bool = False
    place: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.bool_]] | None = None

    @property
    def changes(self) -> bool:
        """Whether the values may differ from zero in some step."""
        return isinstance(self.value, fem.Constant) or bool(np.any(self.increment != 0.0))

    @property
    def increment(self) -> npt.NDArray[np.float64]:
        """The values now, shape () or (n,)."""
        value = self.value.value if isinstance(self.value, fem.Constant) else self.value
        return np.asarray(value, float)

    def now(self) -> Condition:
        """The condition at the nodes where its place is now; itself if these stay. Collective."""
        if self.place is None:
            return self
        place, space = self.place, self.space
        nodes = call_together(space.grid.comm, lambda: _chosen(space, place))
        changed = not np.array_equal(nodes, self.nodes)
        if not space.grid.comm.allreduce(changed, op=MPI.LOR):
            return self
        return replace(self, nodes=nodes)


def _sides(gdim: int) -> dict[str, tuple[int, int]]:
    """Side → (axis, 0 for its lower or 1 for its upper end); bottom, top are on the last axis."""
    last = gdim - 1
    sides = {"left": (0, 0), "right": (0, 1), "bottom": (last, 0), "top": (last, 1)}
    if gdim == 3:
        sides |= {"front": (1, 0), "back": (1, 1)}
    return sides


def side_of(where: str, gdim: int) -> tuple[str, int, int]:
    """Name, axis and end (0: lower, 1: upper) of a side of the grid.

    Raises:
        ParameterError: There is no such side.
    """
    name = _side(where, gdim)
    return (name, *_sides(gdim)[name])


def _side(where: str, gdim: int) -> str:
    try:
        return choice("side", where, _sides(gdim))
    except ParameterError as error:
        raise ParameterError(f"{error}; or a function of positions") from None


def _node_coordinates(space: Space) -> npt.NDArray[np.float64]:
    return space.basis.node_coordinates()[:, : space.grid.geometry.dim]


def _check_space(space: Any) -> None:
    if not isinstance(space, Space):
        raise ParameterError(
            f"space = {shown(space)} must be a dolfinmpm.Space; an increment is held by the space "
            "that it is of"
        )


def _chosen(space: Space, where: Callable) -> npt.NDArray[np.int32]:
    """Nodes at which a function of positions holds."""
    chosen = choose("the function of places", where, _node_coordinates(space))
    return np.flatnonzero(chosen).astype(np.int32)


def _nodes(space: Space, where: Where, none: bool = False) -> tuple[npt.NDArray[np.int32], str]:
    """Nodes at a place, and its name; `none` says whether there may be no node. Collective."""
    x = _node_coordinates(space)
    comm, gdim = space.grid.comm, space.grid.geometry.dim
    if not callable(where):
        name = _side(where, gdim)
        axis, end = _sides(gdim)[name]
        low = min(comm.allgather(x[:, axis].min(initial=math.inf)))
        high = max(comm.allgather(x[:, axis].max(initial=-math.inf)))
        chosen = np.abs(x[:, axis] - (low, high)[end]) <= 1e-9 * (high - low)
        return np.flatnonzero(chosen).astype(np.int32), name
    nodes = call_together(comm, lambda: _chosen(space, where))
    low = np.min(comm.allgather(x[nodes].min(axis=0, initial=math.inf)), axis=0)
    high = np.max(comm.allgather(x[nodes].max(axis=0, initial=-math.inf)), axis=0)
    name = getattr(where, "__name__", "<lambda>")
    if none and name == "<lambda>":
        return nodes, "a place that follows"
    if not none and not np.isfinite(low).all():
        corners = x.min(axis=0, initial=math.inf), x.max(axis=0, initial=-math.inf)
        low = np.min(comm.allgather(corners[0]), axis=0)
        high = np.max(comm.allgather(corners[1]), axis=0)
        raise ParameterError(
            f"no node of the grid lies where '{name}' says; they lie from {low} to {high} m: check "
            "the coordinates, and compare them with np.isclose"
        )
    # a function without a name of its own is told by where it holds
    return nodes, name if name != "<lambda>" else f"nodes from {low} to {high} m"


@together(own=("value",))
def prescribed(
    space: Space,
    where: Where,
    component: int,
    value: float | fem.Constant | Callable[[npt.NDArray[np.float64]], npt.ArrayLike] = 0.0,
    *,
    increment: bool = True,
    follows: bool = False,
) -> list[Condition]:
    """Prescribe one component's increment in every step, or its value. Collective.

    Args:
        space: Space of the field.
        where: "left", "right" (first axis), "bottom", "top" (last axis), "front",
            "back" (second axis in 3D), or a function of node positions (m), shape
            (gdim, n), that returns n booleans; see `dolfinmpm.grid.positions`.
        component: Component of the field.
        value: Increment a step (m for a displacement): a number, a scalar DOLFINx
            constant, or a function of node positions like `where` that returns n numbers.
            When a step is halved, so is it.
        increment: False for a field that is no increment, such as the pressure of `poromechanics`:
            the value is the field's own, also in parts of a step that is halved.
        follows: Whether `where`, a function, is asked anew in every step, such as for the part of
            a plane of symmetry that a tool has not opened yet; there may be no node then.

    Raises:
        ParameterError: The space, the side, the component or the value is not what it
            may be, or no node is there.
    """
    _check_space(space)
    truth("increment", increment), truth("follows", follows)
    if whole("component", component, 0) >= space.components:
        raise ParameterError(
            f"component = {component} must be in 0 ... {space.components - 1} of this field"
        )
    constant = isinstance(value, fem.Constant) or np.isscalar(value)
    if follows and not (callable(where) and constant):
        raise ParameterError(
            "follows=True goes with a function of positions as where, and with a number or a "
            "constant as value: how many nodes there are may change"
        )
    nodes, name = _nodes(space, where, follows)
    given = _value(space, nodes, name, value)
    place = where if follows and callable(where) else None
    return [Condition(space, nodes, int(component), given, name, None, not increment, place)]


@together
def moving(
    space: Space, where: Where, component: int, velocity: float | Callable[[float], float]
) -> list[Condition]:
    """Prescribe the velocity of one component in time, for steps in time. Collective.

    Args:
        space: Space of the displacement.
        where: See `prescribed`.
        component: Component of the displacement.
        velocity: Velocity (m/s): a number, or a function of the time (s) that returns one.

    Raises:
        ParameterError: See `prescribed`; or the velocity is no number.
    """
    given = velocity if callable(velocity) else number("velocity", velocity, unit="m/s")

    def at(t: float) -> float:
        return number("velocity", at_time("velocity", given, t), unit="m/s")

    at(0.0)
    (condition,) = prescribed(space, where, component, own_constant(space.grid, 0.0))
    return [replace(condition, velocity=at)]


def _value(space: Space, nodes, name: str, value: Any) -> Any:
    """What is prescribed, checked."""
    what = f"the increment prescribed at '{name}'"
    if isinstance(value, fem.Constant):
        if value.ufl_shape != ():
            raise ParameterError(
                f"{what} is a constant of shape {value.ufl_shape} and must be a scalar one; give "
                "each component a condition of its own"
            )
        return value
    # UFL expressions are callable too
    if isinstance(value, Expr):
        raise ParameterError(
            f"{what} is a UFL expression ('{str(value)[:100]}') and must be a number, a scalar "
            "dolfinx.fem.Constant or a function of positions"
        )
    comm = space.grid.comm
    if callable(value):
        at = _node_coordinates(space)[nodes]
        given = call_together(comm, lambda: ask(what, value, at))
    elif np.ndim(value) == 0:
        return np.asarray(number(what, value))
    else:
        given = call_together(comm, lambda: _one_a_node(what, value, nodes.size))
    error = None
    if not np.isfinite(given).all():
        k = int(np.flatnonzero(~np.isfinite(given))[0])
        at = _node_coordinates(space)[nodes[k]]
        error = ParameterError(f"{what} is {given[k]} at the node at {at} m and must be finite")
    raise_together(comm, error)
    return given


def _one_a_node(what: str, value: Any, size: int) -> npt.NDArray[np.float64]:
    try:
        given = np.asarray(value, float)
    except (TypeError, ValueError):
        given = np.empty((0, 0))
    if given.shape != (size,):
        raise ParameterError(
            f"{what} is {shown(value)} and must be one number, or one for each of {size} nodes on "
            "this rank; give each component a condition of its own"
        )
    return given


@together
def fixed(space: Space, *where: Where) -> list[Condition]:
    """Hold all components. Collective; see `prescribed` for `where`.

    Raises:
        ParameterError: A place is not what it may be.
    """
    _check_space(space)
    _check_places("fixed", where)
    return [
        condition
        for place in where
        for component in range(space.components)
        for condition in prescribed(space, place, component)
    ]


@together
def rollers(space: Space, *sides: str) -> list[Condition]:
    """Hold the component across each side and leave those along it free. Collective.

    Args:
        space: Space of the displacement.
        sides: Names of sides of the grid; see `prescribed`.

    Raises:
        ParameterError: A side is not known, or the field is no vector of
            the dimension of space.
    """
    _check_space(space)
    gdim = space.grid.geometry.dim
    if space.increment.ufl_shape != (gdim,):
        raise ParameterError(
            f"rollers hold the component of a displacement across a side; the field has shape "
            f"{space.increment.ufl_shape}, not {(gdim,)}: use mpm.prescribed"
        )
    _check_places("rollers", sides)
    result = []
    for side in sides:
        if callable(side):
            raise ParameterError(
                "rollers take names of sides, whose axis they hold; at a function of positions "
                "use mpm.prescribed(space, function, component)"
            )
        name = _side(side, gdim)
        result += prescribed(space, name, _sides(gdim)[name][0])
    return result


def _check_places(what: str, places: Sequence[Any]) -> None:
    for place in places:
        if not callable(place) and not isinstance(place, str):
            raise ParameterError(
                f"{what}: {shown(place)} is no place; give the places one by one, as in "
                f'mpm.{what}(space, "left", "bottom")'
            )


def idle(
    conditions: Sequence[Condition],
    spaces: Sequence[Space],
    active: Sequence[npt.NDArray[np.int32]],
) -> list[str]:
    """Places at which no condition holds an active node, on any rank. Collective.

    Args:
        conditions: The conditions.
        spaces: Spaces of the fields.
        active: For each space its active nodes, as the conditions number them.

    Returns:
        Names of the places, each once, but for those that follow something.
    """
    conditions = [condition for condition in conditions if condition.place is None]
    if not conditions:
        return []
    holds = np.zeros(len(conditions), np.int32)
    for space, nodes in zip(spaces, active):
        moved = np.zeros(space.basis.nodes.size, bool)
        moved[nodes] = True
        for k, condition in enumerate(conditions):
            if condition.space is space:
                holds[k] = moved[condition.nodes].any()
    spaces[0].grid.comm.Allreduce(MPI.IN_PLACE, holds, op=MPI.MAX)
    return list(dict.fromkeys(c.where for c, held in zip(conditions, holds) if not held))


def warn_idle(
    conditions: Sequence[Condition],
    spaces: Sequence[Space],
    active: Sequence[npt.NDArray[np.int32]],
) -> None:
    """Warn on rank 0 of conditions that hold nothing; see `idle`. Collective."""
    names = idle(conditions, spaces, active)
    if names:
        places = ", ".join(f"'{name}'" for name in names)
        warn(
            spaces[0].grid.comm,
            f"the conditions at {places} hold no node that the body moves: it does not reach there "
            "now, and they do nothing until it does. Names of sides mean those of the grid; give a "
            "function of positions to hold the body elsewhere",
            IdleConditionWarning,
        )


def free_motions(
    conditions: Sequence[Condition],
    space: Space,
    active: npt.NDArray[np.int32],
    axisymmetric: bool = False,
) -> list[str]:
    """Rigid motions that no condition holds, in words. Collective.

    Args:
        conditions: The conditions.
        space: Space of the displacement.
        active: Its active nodes.
        axisymmetric: Whether the body is one of revolution, which along its axis alone moves rigidly.
    """
    x, gdim, comm = _node_coordinates(space), space.grid.geometry.dim, space.grid.comm
    moved = np.zeros(len(x), bool)
    moved[active] = True
    sums = comm.allreduce(np.append(x[moved].sum(axis=0), moved.sum()), op=MPI.SUM)
    middle = sums[:-1] / max(sums[-1], 1.0)
    spread = np.abs(x[moved] - middle).max(initial=0.0)
    size = max(comm.allreduce(spread, op=MPI.MAX), np.finfo(float).tiny)
    turns = [(i, j) for i in range(gdim) for j in range(i + 1, gdim)]
    square = np.zeros((gdim + len(turns),) * 2)
    for condition in conditions:
        if condition.space is not space:
            continue
        held = condition.nodes[moved[condition.nodes]]
        rows = np.zeros((held.size, len(square)))
        k, r = condition.component, (x[held] - middle) / size
        rows[:, k] = 1.0
        for at, (i, j) in enumerate(turns):
            if k in (i, j):
                rows[:, gdim + at] = -r[:, j] if k == i else r[:, i]
        square += rows.T @ rows
    square = comm.allreduce(square, op=MPI.SUM)
    if axisymmetric:
        return ["along y"] if square[1, 1] == 0.0 else []
    values, vectors = np.linalg.eigh(square)
    free = vectors[:, values <= 1e-12 * max(values.max(), 1.0)].T
    if not len(free):
        return []
    # axes along which a free motion can go without another
    along = [f"along {'xyz'[i]}" for i in range(gdim) if abs(np.linalg.norm(free[:, i]) - 1) < 1e-9]
    turning = len(free) - len(along)
    return along + ([f"{turning} with a turn"] if turning else [])
