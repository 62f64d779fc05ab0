"""The state of a problem, in a checkpoint file and in memory: saved, and restored."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm._platform.errors import CheckpointError, raise_together
from dolfinmpm.assembly.state import Local
from dolfinmpm.cut.essentialconditions import EssentialConditions
from dolfinmpm.cut.pattern import KeptCouplings
from dolfinmpm.io import checkpoint
from dolfinmpm.solve.description import describe, warn_of_differences
from dolfinmpm.solve.linearsolver import WORKSPACE
from dolfinmpm.solve.loads import values_of

if TYPE_CHECKING:
    from dolfinmpm.solve.problem import Problem

__all__ = ["SavedState", "SolverState", "load", "save"]

Arrays = dict[str, npt.NDArray[Any]]


def save(problem: Problem, path: str | os.PathLike[str]) -> None:
    """Write a checkpoint; see `Problem.save`. Collective."""
    history = [dataclasses.asdict(record) for record in problem.history]
    state = {**_identity(problem), **problem.state()}
    state["description"] = [list(pair) for pair in _description(problem).items()]
    checkpoint.write(path, problem.points, state, history, _laws(problem))


def load(problem: Problem, path: str | os.PathLike[str]) -> None:
    """Read a checkpoint; see `Problem.load`. Collective."""
    found = checkpoint.read(path, problem.points, _laws(problem))
    raise_together(problem.comm, _mismatch(problem, os.fspath(path), found.state))
    before = dict(found.state.get("description", ()))
    warn_of_differences(problem.comm, os.fspath(path), before, _description(problem))
    found.put(problem.points)
    problem.set_state(found.state)
    of_step = problem.scheme.record
    names = {f.name for f in dataclasses.fields(of_step)}
    problem.history = [
        of_step(**{k: v for k, v in row.items() if k in names}) for row in found.history
    ]


def _description(problem: Problem) -> dict[str, str]:
    """Settings that a next stage may change, in words. Collective."""
    own = describe(problem.fields, problem.form, problem.bcs)
    return {**own, **problem.scheme.description()}


def _laws(problem: Problem) -> list[str]:
    """Laws with their strain formulations; a next stage may have other parameters."""
    declared = problem.form.parts.declarations
    return sorted({f"{type(d.law).__name__} under {d.strain} strain" for d in declared})


def _identity(problem: Problem) -> dict[str, Any]:
    """Properties that a checkpoint and the problem must share."""
    form = problem.form
    constants = [bc.value for bc in problem.bcs if isinstance(bc.value, fem.Constant)]
    return {
        "solver": type(problem).__name__,
        "unknown fields": str([space.increment.ufl_shape for space in form.spaces]),
        "loads": str([load.ufl_shape for load, _ in problem.loads.converged()]),
        "prescribed": len(constants),
        "boundaries": str([of.boundary.markers.total for of in form.boundaries]),
        "rigid bodies": len(problem.bodies.all),
        **problem.scheme.identity(),
    }


def _mismatch(problem: Problem, path: str, state: dict[str, Any]) -> CheckpointError | None:
    """The first property that the file and the problem do not share, or None."""
    for what, here in _identity(problem).items():
        found = state.get(what, "[]" if what == "boundaries" else None)
        if found != here:
            return CheckpointError(
                f"{path} is of another problem: its {what} is {found}, that of this "
                f"one {here}; build the same problem before you load"
            )
    named = problem.form.named_terms()
    needed = [f"{k}: {name}" for k, term in named for name in term.needed()]
    absent = [name for name in needed if name not in state]
    if absent and problem.configuration == "total":
        return CheckpointError(
            f"{path} is of a problem in the updated configuration: it lacks '{absent[0]}', "
            'where boundaries were at first; load it into one with configuration="updated"'
        )
    return None


class SavedState:
    """A copy of a problem's state in memory, with points and rigid bodies. Collective.

    Trials restore the state afterwards, and so leave no trace.

    Args:
        problem: The problem, between steps.
    """

    def __init__(self, problem: Problem):
        self._problem, points = problem, problem.points
        self._fields: Arrays = {name: points.fields.read(name).copy() for name in points.fields}
        self._of_markers = [set(markers.fields) for markers in self._markers]
        self._partition = points.partition
        self._state = problem.state()
        self._history = list(problem.history)
        # values set by the user since the last step
        self._set = [(item, np.array(values_of(item))) for item in problem.loads.items]
        self._set += [(u, u.x.array.copy()) for u in self._increments]
        self._dt = float(points.dt.value)

    @property
    def _markers(self) -> list[Any]:
        return [of.boundary.markers for of in self._problem.form.boundaries]

    @property
    def _increments(self) -> list[Any]:
        return [space.increment for space in self._problem.form.spaces]

    def restore(self) -> None:
        """Restore the state. Points go back to their ranks. Collective."""
        problem, points = self._problem, self._problem.points
        for name in [*points.fields]:
            if name not in self._fields:
                del points.fields[name]
        for name, values in self._fields.items():
            points.fields[name] = values.copy()
        points.partition = self._partition
        points.recount()
        for markers, names in zip(self._markers, self._of_markers):
            for name in [*markers.fields]:
                if name not in names:
                    del markers.fields[name]
        problem.set_state(self._state)
        problem.history[:] = self._history
        for item, values in self._set:
            values_of(item)[...] = values
        points.dt.value = self._dt


class SupportForces:
    """Forces of the supports in the last step, for `dolfinmpm.solve.reactions`.

    Other ranks, and a problem that has taken no step, do without them.

    Args:
        conditions: The conditions of the problem.
    """

    def __init__(self, conditions: EssentialConditions):
        self._conditions = conditions

    def state(self) -> dict[str, Any]:
        """The forces, by name; see `dolfinmpm.assembly.state`."""
        return {name: Local(values) for name, values in self._conditions.forces().items()}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`."""
        local = {name: one.values for name, one in values.items() if isinstance(one, Local)}
        self._conditions.set_forces(local)


class SolverState:
    """Share of the next step, line search, workspace, first guess and couplings of a problem.

    A restarted run then gives the same figures. Most of this state changes only the last bits of
    results. For example, the couplings kept by the matrix decide the order of its factorisation.

    Args:
        problem: The problem, with Newton's method.
    """

    def __init__(self, problem: Any):
        self._problem = problem

    def state(self) -> dict[str, Any]:
        """The state, by name; see `dolfinmpm.assembly.state`."""
        problem, newton = self._problem, self._problem.newton
        found: dict[str, Any] = {
            "share": problem.share,
            "search": newton.search if newton.searches else None,
            "workspace": newton.linear.mumps.get(WORKSPACE),
        }
        if problem.here is not None:
            kept = KeptCouplings.of(problem.here)
            for name in ("active", "rows", "columns"):
                found[name] = Local(getattr(kept, name))
        return found | {name: Local(values) for name, values in newton.guess.state().items()}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`, and discard later data. Collective."""
        problem, newton = self._problem, self._problem.newton
        newton.linear.forget()
        problem.share = values["share"]
        if newton.searches and values["search"]:
            newton.search = values["search"]
        if values["workspace"]:
            newton.linear.mumps[WORKSPACE] = values["workspace"]
        local = {name: one.values for name, one in values.items() if isinstance(one, Local)}
        newton.guess.set_state(local, problem.points.partition)
        for space in problem.form.spaces:
            space.increment.x.array[:] = 0.0
        problem.kept = None
        if "active" in local:
            problem.kept = KeptCouplings(local["active"], local["rows"], local["columns"])
