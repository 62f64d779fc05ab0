"""Essential conditions: increments or values of nodes that are prescribed."""

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

from dolfinmpm._platform.argumentchecks import floats, number, shown, truth, whole
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import (
    ParameterError,
    call_together,
    raise_together,
)
from dolfinmpm._platform.uncopied import unchanged
from dolfinmpm.basis.space import Space
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.linecells import coordinate_rounding
from dolfinmpm.grid.sides import side_of
from dolfinmpm.grid.userfunctions import VelocityByTime, call_function, choose
from dolfinmpm.grid.widecomparisons import warn_of_wide_comparison

__all__ = [
    "Condition",
    "fixed",
    "moving",
    "node_coordinates",
    "prescribed",
    "rollers",
]

Where = str | Callable[[npt.NDArray[np.float64]], npt.NDArray[np.bool_]]
Given = float | fem.Constant | Callable[[npt.NDArray[np.float64]], npt.ArrayLike]

# Default of arguments for which None is a bad value
_NOT_GIVEN: Any = object()
_REMEDY = "Give prescribed a dolfinx.fem.Constant, whose value you set, or make a new problem"


@unchanged(_REMEDY)
@dataclass(frozen=True)
class Condition:
    """One component of a field, prescribed at some nodes.

    Attributes:
        space: Space of the field.
        nodes: Local nodes, shape (n,).
        component: Component of the field.
        value: Prescribed value, see `kind`: a number, a DOLFINx constant, or one number per
            node, shape (n,).
        where: Its place in messages.
        velocity: Velocity that it is to have (m/s) at a time (s), or None; steps in time then set
            the value, a constant.
        kind: "increment" of every step, of which parts of a step have a share; "value" of the
            field itself, which parts of a step have in full; or "zero", which is both.
        place: Function of positions that says where in every step anew, or None.
        chooses: Side, or function of positions, that chose the nodes.
        function: Function of positions that gave the values, or None.
    """

    space: Space
    nodes: npt.NDArray[np.int32]
    component: int
    value: float | fem.Constant | npt.NDArray[np.float64]
    where: str
    velocity: VelocityByTime | None = None
    kind: str = "zero"
    place: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.bool_]] | None = None
    chooses: Where = ""
    function: Callable[[npt.NDArray[np.float64]], npt.ArrayLike] | None = None

    @property
    def changes(self) -> bool:
        """Whether the values may differ from zero in some step."""
        return isinstance(self.value, fem.Constant) or bool(np.any(self.values != 0.0))

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """The values now, shape () or (n,)."""
        value = self.value.value if isinstance(self.value, fem.Constant) else self.value
        return np.asarray(value, float)

    def now(self) -> Condition:
        """The condition at the nodes that its place holds now. Collective.

        The condition itself is returned where the nodes stay the same.
        """
        if self.place is None:
            return self
        place, space = self.place, self.space
        nodes = call_together(space.grid.comm, lambda: _chosen(space, place))
        changed = not np.array_equal(nodes, self.nodes)
        if not space.grid.comm.allreduce(changed, op=MPI.LOR):
            return self
        return replace(self, nodes=nodes)


def node_coordinates(space: Space) -> npt.NDArray[np.float64]:
    """Positions of the nodes (m), in the numbering of conditions, shape (nodes, gdim)."""
    return space.basis.node_coordinates()[:, : space.grid.geometry.dim]


def _check_space(space: Any) -> None:
    if not isinstance(space, Space):
        raise ParameterError(
            f"space = {shown(space)} must be a dolfinmpm.Space; give the space of the increment, "
            "and not the increment"
        )


def _chosen(space: Space, where: Callable) -> npt.NDArray[np.int32]:
    """Nodes at which a function of positions is true."""
    chosen = choose("the function of places", where, node_coordinates(space))
    return np.flatnonzero(chosen).astype(np.int32)


def _extent(comm: MPI.Intracomm, x: npt.NDArray[np.float64]) -> tuple[Any, Any]:
    """Lowest and highest coordinates on all ranks (m). Collective."""
    low = np.min(comm.allgather(x.min(axis=0, initial=math.inf)), axis=0)
    high = np.max(comm.allgather(x.max(axis=0, initial=-math.inf)), axis=0)
    return low, high


def _between_lines(space: Space) -> str:
    """What to know of the nodes of quadratic splines, for messages."""
    if getattr(space.basis, "degree", 1) != 2:
        return ""
    return (
        ". Within the grid, nodes of quadratic splines are in the middles of cells, and none is on "
        "a grid line; hold a line with mpm.dirichlet on a Boundary"
    )


def _nodes(space: Space, where: Where, empty: str = "") -> tuple[npt.NDArray[np.int32], str]:
    """Nodes at a place, and the name of the place. Collective.

    Args:
        space, where: See `prescribed`.
        empty: Name of a place without a name that may hold no node of the grid, or "".
    """
    x = node_coordinates(space)
    comm, gdim = space.grid.comm, space.grid.geometry.dim
    if not callable(where):
        name, axis, end = side_of(where, gdim)
        low, high = _extent(comm, x[:, axis])
        chosen = np.abs(x[:, axis] - (low, high)[end]) <= coordinate_rounding(low, high)
        return np.flatnonzero(chosen).astype(np.int32), name
    nodes = call_together(comm, lambda: _chosen(space, where))
    low, high = _extent(comm, x[nodes])
    if np.isfinite(low).all():
        warn_of_wide_comparison(comm, where, low, high)
    name = getattr(where, "__name__", "<lambda>")
    if empty and name == "<lambda>":
        return nodes, empty
    if not empty and not np.isfinite(low).all():
        low, high = _extent(comm, x)
        raise ParameterError(
            f"'{name}' chooses no node of the grid; the nodes lie from {low} to {high} m: check "
            f"the coordinates, and compare them with np.isclose{_between_lines(space)}"
        )
    # a function without a name is described by the positions of its nodes
    return nodes, name if name != "<lambda>" else f"nodes from {low} to {high} m"


@collective(local=("increment", "value"))
def prescribed(
    space: Space,
    where: Where,
    component: int,
    *,
    increment: Given = _NOT_GIVEN,
    value: Given = _NOT_GIVEN,
    follows: bool = False,
) -> list[Condition]:
    """Prescribe the increment of one component in every step, or its value. Collective.

    Without an increment and a value the component is held at zero.

    Args:
        space: Space of the field.
        where: A side, by its axis, "x-", "x+", "y-", ..., or by its name: "left", "right" (first
            axis), "bottom", "top" (last axis), "front", "back" (second axis in 3D); or a function
            of node positions (m), shape (gdim, n), that returns n booleans; see
            `dolfinmpm.grid.userfunctions`. Within the grid, quadratic splines have their nodes in
            the middles of cells and hold no grid line: take `mpm.dirichlet` there.
        component: Component of the field, from 0; 0 for a scalar field.
        increment: For a displacement: increment per step (m), a number, a scalar DOLFINx constant,
            or a function of node positions like `where` that returns n numbers. When a step is
            halved, so is the increment.
        value: For a field that the form carries from step to step, such as the pressure of
            `poromechanics`: its value (Pa), given as an increment is. A step that is halved keeps
            the value.
        follows: Whether the function `where` is called again in every step, such as for the part
            of a plane of symmetry that a tool has not opened yet. Then it may find no node.

    Raises:
        ParameterError: The space, the side, the component, the increment or the value is not
            valid, both an increment and a value are given, or no node is there. Problems refuse
            an increment of a field that is carried, and a value of a field that moves points.

    Two millimetres down in every step:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> V = mpm.Space(grid, "gimp")
    >>> (down,) = mpm.prescribed(V, "top", 1, increment=-0.002)
    >>> down.where, down.component, float(down.value)
    ('top', 1, -0.002)
    """
    _check_space(space)
    truth("follows", follows)
    both = {"increment": increment, "value": value}
    told = [kind for kind, given in both.items() if given is not _NOT_GIVEN]
    if len(told) == 2:
        raise ParameterError(
            f"increment = {shown(increment)} and value = {shown(value)} are both given; give "
            "increment=... for a field that moves points, value=... for one that is carried"
        )
    kind, given = (told[0], both[told[0]]) if told else ("zero", 0.0)
    if isinstance(component, str) or whole("component", component, 0) >= space.components:
        raise ParameterError(
            f"component = {shown(component)} must be in 0 ... {space.components - 1} of this "
            "field: 0 is along x[0]"
        )
    constant = isinstance(given, fem.Constant) or np.isscalar(given)
    if follows and not (callable(where) and constant):
        raise ParameterError(
            "follows=True goes with a function of positions as where, and with a number or a "
            f"constant as {kind}: the number of nodes may change from step to step"
        )
    # a place may lie between the nodes of the grid, where leaves have nodes
    leaves = "" if space.refinement is None else "<lambda>"
    nodes, name = _nodes(space, where, "a place that follows" if follows else leaves)
    what = f"the {'increment' if kind == 'zero' else kind} prescribed at '{name}'"
    checked = _checked(space, nodes, what, given)
    place = where if follows and callable(where) else None
    function = given if callable(given) and not isinstance(given, fem.Constant) else None
    return [
        Condition(space, nodes, int(component), checked, name, None, kind, place, where, function)
    ]


@collective
def moving(
    space: Space, where: Where, component: int, *, velocity: float | Callable[[float], float]
) -> list[Condition]:
    """Prescribe the velocity of one component, for steps in time. Collective.

    Args:
        space: Space of the displacement.
        where: See `prescribed`.
        component: Component of the displacement.
        velocity: Velocity (m/s): a number, or a function of the time (s) that returns a number.

    Raises:
        ParameterError: The velocity is no number; or see `prescribed`.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> V = mpm.Space(grid, "gimp")
    >>> (push,) = mpm.moving(V, "left", 0, velocity=lambda t: min(t, 0.1))
    >>> push.where, push.velocity(0.05)
    ('left', 0.05)
    """
    by_time = VelocityByTime.of("velocity", velocity)
    by_time(0.0)
    (condition,) = prescribed(space, where, component, increment=own_constant(space.grid, 0.0))
    return [replace(condition, velocity=by_time)]


def _checked(space: Space, nodes, what: str, value: Any) -> Any:
    """What is prescribed, checked."""
    if isinstance(value, fem.Constant):
        if value.ufl_shape != ():
            raise ParameterError(
                f"{what} is a constant of shape {value.ufl_shape} and must be a scalar constant; "
                "give each component its own condition"
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
        at = node_coordinates(space)[nodes]
        given = call_together(comm, lambda: call_function(what, value, at))
    elif np.ndim(value) == 0:
        return np.asarray(number(what, value))
    else:
        given = call_together(comm, lambda: _one_per_node(what, value, nodes.size))
    error = None
    if not np.isfinite(given).all():
        k = int(np.flatnonzero(~np.isfinite(given))[0])
        at = node_coordinates(space)[nodes[k]]
        error = ParameterError(f"{what} is {given[k]} at the node at {at} m and must be finite")
    raise_together(comm, error)
    return given


def _one_per_node(what: str, value: Any, size: int) -> npt.NDArray[np.float64]:
    given = floats(value)
    if given is None or given.shape != (size,):
        raise ParameterError(
            f"{what} is {shown(value)} and must be one number, or one for each of {size} nodes on "
            "this rank; give each component its own condition"
        )
    return given


@collective
def fixed(space: Space, *where: Where) -> list[Condition]:
    """Set the increments of all components to zero at some places. Collective.

    Args:
        space: Space of the field.
        where: Places; see `prescribed`.

    Raises:
        ParameterError: The space or a place is not valid; see `prescribed`.

    Sides, or any place:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> V = mpm.Space(grid, "gimp")
    >>> [(c.where, c.component) for c in mpm.fixed(V, "bottom")]
    [('bottom', 0), ('bottom', 1)]
    >>> len(mpm.fixed(V, lambda x: x[0] > 3.5))
    2
    """
    _check_space(space)
    _check_places("fixed", where)
    return [
        condition
        for place in where
        for component in range(space.components)
        for condition in prescribed(space, place, component)
    ]


@collective
def rollers(space: Space, *sides: str) -> list[Condition]:
    """Constrain the displacement normal to each side, and leave it free along the side. Collective.

    Args:
        space: Space of the displacement.
        sides: Names of sides of the grid; see `prescribed`.

    Raises:
        ParameterError: A side is not known, or the field is no vector of
            the dimension of space.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> V = mpm.Space(grid, "gimp")
    >>> [(c.where, c.component) for c in mpm.rollers(V, "left", "right", "bottom")]
    [('left', 0), ('right', 0), ('bottom', 1)]
    """
    _check_space(space)
    gdim = space.grid.geometry.dim
    if space.increment.ufl_shape != (gdim,):
        raise ParameterError(
            f"rollers constrain the displacement normal to a side; the field has shape "
            f"{space.increment.ufl_shape}, not {(gdim,)}: use mpm.prescribed"
        )
    _check_places("rollers", sides)
    result = []
    for side in sides:
        if callable(side):
            raise ParameterError(
                "rollers take names of sides, which have a normal; at a function of positions "
                "use mpm.prescribed(space, function, component)"
            )
        name, axis, _ = side_of(side, gdim)
        result += prescribed(space, name, axis)
    return result


def _check_places(what: str, places: Sequence[Any]) -> None:
    for place in places:
        if not callable(place) and not isinstance(place, str):
            raise ParameterError(
                f"{what}: {shown(place)} is no place; give the places one by one, as in "
                f'mpm.{what}(space, "left", "bottom")'
            )
