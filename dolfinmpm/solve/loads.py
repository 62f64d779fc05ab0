"""Loads of a step: DOLFINx constants and functions between their old and new values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms import extract_coefficients
from ufl.algorithms.analysis import extract_constants

from dolfinmpm._platform.argumentchecks import cut
from dolfinmpm._platform.errors import CheckpointError, ParameterError, raise_together
from dolfinmpm.assembly.state import OfCells
from dolfinmpm.cut.essentialconditions import EssentialConditions
from dolfinmpm.grid.constants import is_own, reached, take_reached

__all__ = ["Loads", "check_loads", "load_name", "loads_of"]


class Loads:
    """The constants and functions of a form that carry loads.

    The user sets them to their values at the end of the next step. In a substep they have a share
    of the change since the last converged step.

    Args:
        items: Constants and functions; repeated ones count once.
        increments: The unknown functions, which carry no load.

    Attributes:
        items: The constants and functions.
        change: Change of each in the step of the last call of `jumps`.
    """

    def __init__(self, items: Sequence[Any], increments: Sequence[fem.Function]):
        self.items: list[Any] = []
        for item in items:
            if not any(item is known for known in (*self.items, *increments)):
                self.items.append(item)
        values = self._read()
        known = [reached(item) for item in self.items]
        self._start = [v if k is None else np.array(k) for v, k in zip(values, known)]
        # steps take those on that move something, see `begin_at_zero`
        self._moving = [item for item, k in zip(self.items, known) if k is not None]
        self._target = values
        self.change: list[float] = []
        self._last_change: list[float] = []

    def _read(self) -> list[npt.NDArray[np.float64]]:
        return [np.array(values_of(item), copy=True) for item in self.items]

    def set_target(self) -> None:
        """Take the present values as the values at the end of the step."""
        self._target = self._read()

    def set(self, share: float, moved: float | None = None) -> None:
        """Set the values at a share of the step.

        Args:
            share: The share.
            moved: The share of constants that move something, which never jump; `share` by default.
        """
        for item, start, target in zip(self.items, self._start, self._target):
            moving = moved is not None and any(item is one for one in self._moving)
            at = moved if moving and moved is not None else share
            values_of(item)[...] = target if at >= 1 else start + at * (target - start)

    def accept(self, whole: bool = True) -> None:
        """Take the present values as the values of a converged state.

        Args:
            whole: False after an error, when the changes found by `jumps` were not made.
        """
        self._start = self._read()
        if not whole:
            self.change = self._last_change
        self._last_change = self.change
        for item in self._moving:
            take_reached(item)

    def converged(self) -> list[tuple[Any, npt.NDArray[np.float64]]]:
        """Each constant and function, with its values in the last converged state."""
        return list(zip(self.items, self._start))

    def state(self) -> dict[str, Any]:
        """Values of the last converged state, of functions per cell, and the last change."""
        found: dict[str, Any] = {"change": np.array(self.change)}
        for k, (item, value) in enumerate(self.converged()):
            function = isinstance(item, fem.Function)
            found[f"load {k}"] = OfCells(_values_of_cells(item, value)) if function else value
        return found

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`. Collective."""
        for k, (item, _) in enumerate(self.converged()):
            own = values[f"load {k}"]
            if isinstance(own, OfCells):
                _set_values(item, own.values)
            else:
                item.value = own
        self.change = values["change"].tolist()
        self.accept()

    def jumps(self) -> bool:
        """Whether a load jumps between the last converged state and its present value.

        A load jumps if it changes by more than half of the larger of the two values, and the
        change in the step before was less than a tenth of this change. `change` has the changes.
        What moves something is no load: it goes on evenly from one step to the next.
        """
        before, self.change = self._last_change, []
        jumped = False
        for k, (start, target) in enumerate(zip(self._start, self._read())):
            change = float(np.abs(target - start).max(initial=0.0))
            size = max(np.abs(start).max(initial=0.0), np.abs(target).max(initial=0.0))
            self.change.append(change)
            if reached(self.items[k]) is None:
                jumped |= change > 0.5 * size > 0 and (not before or before[k] < 0.1 * change)
        return bool(jumped)

    def describe(self) -> str:
        """The constants' present values, for messages."""
        values = [
            f"{load_name(item)} = {item.value}"
            for item in self.items
            if isinstance(item, fem.Constant) and not is_own(item)
        ]
        return "constants " + ", ".join(values) if values else "no constants"


def values_of(item: Any) -> npt.NDArray[np.float64]:
    """The values of a DOLFINx constant or function."""
    return item.x.array if isinstance(item, fem.Function) else item.value


def loads_of(items: Iterable[Any]) -> list[Any]:
    """Constants and functions of a form, without the library's own that do not change."""
    return [item for item in items if not is_own(item) or reached(item) is not None]


def load_name(item: Any) -> str:
    """Name of a constant or a function in messages: its `name`, if the user gave one.

    A DOLFINx constant has no name, but accepts one: `gravity.name = "gravity"`.
    """
    return str(getattr(item, "name", None) or item)


def check_loads(
    items: Sequence[Any], form: ufl.Form, essential: EssentialConditions, comm: MPI.Comm
) -> None:
    """Raise on all ranks if a load or a prescribed increment is not finite. Collective.

    Args:
        items: Constants and functions of the form.
        form: The form; the message names the term with the load.
        essential: Essential conditions.
        comm: The ranks.

    Raises:
        ParameterError: A value is not finite; the message has its name, value and term. Or the
            user's list of conditions has changed.
    """
    error = _changed_list(*essential.read)
    for item in items:
        values = values_of(item)
        if error is None and not np.isfinite(values).all():
            function = isinstance(item, fem.Function)
            kind, value = ("function", "") if function else ("constant", f" = {values}")
            error = ParameterError(
                f"the {kind} {load_name(item)}{value} is not finite{_where(item, form)}; set it to "
                "the load that the step is to reach"
            )
    for condition in essential.conditions:
        # numbers have been checked before
        if not isinstance(condition.value, fem.Constant):
            continue
        if error is None and not np.isfinite(condition.values).all():
            error = ParameterError(
                f"the {condition.kind} prescribed at '{condition.where}' is {condition.values} and "
                "must be finite"
            )
    raise_together(comm, error)


def _changed_list(given: list[Any], read: tuple[Any, ...]) -> ParameterError | None:
    """An error if a list of conditions has changed since a problem has read it, or None.

    Args:
        given: The user's list, as it is now.
        read: Its entries when the problem was made.
    """
    if len(given) == len(read) and all(a is b for a, b in zip(given, read)):
        return None
    return ParameterError(
        f"bcs, the list of conditions, has {len(given)} entries now, and the problem has read it "
        f"when it had {len(read)}; the change would have no effect. Make a new problem of the same "
        "points with the new list, which goes on from their state. If the change is for another "
        "problem, change a copy of the list, list(bcs)"
    )


def _where(item: Any, form: ufl.Form) -> str:
    """The first term that contains a constant or function, for messages."""
    for integral in form.integrals():
        integrand = integral.integrand()
        terms = [integrand]
        while isinstance(terms[0], ufl.classes.Sum):
            terms = [*terms[0].ufl_operands, *terms[1:]]
        for term in terms:
            if any(item is c for c in (*extract_constants(term), *extract_coefficients(term))):
                return f" in the term '{cut(str(term))}'"
    return ""


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


def _values_of_cells(function: fem.Function, array: Array) -> Array:
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


def _set_values(function: fem.Function, rows: Array) -> None:
    """Set a function to values that `_values_of_cells` returned. Collective.

    The values may come from another rank, or from another run. The order of the nodes in a cell
    can therefore differ. Nodes are matched by their positions.

    Args:
        function: The function; its space has the same element as the space of the values.
        rows: Positions and values of the owned cells, see `_values_of_cells`, in the order of the
            cells of `function`.
    """
    nodes, x, each = _nodes(function)
    gdim = x.shape[1]
    apart = np.abs(rows[:, None, :, :gdim] - x[nodes][:, :, None, :]).max(axis=3)
    nearest = np.argmin(apart, axis=2)
    values = np.take_along_axis(rows[:, :, gdim:], nearest[:, :, None], axis=1)
    function.x.array.reshape(-1, each)[nodes] = values
    function.x.scatter_forward()
