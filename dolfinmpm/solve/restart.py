"""Checkpoints of problems: what is written, and what must agree where it is read."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING, Any

from dolfinx import fem

from dolfinmpm._platform.errors import CheckpointError, raise_together
from dolfinmpm.io import checkpoint
from dolfinmpm.solve.description import describe, warn_of_differences

if TYPE_CHECKING:
    from dolfinmpm.solve.problem import Problem

__all__ = ["load", "save"]


def save(problem: Problem, path: str | os.PathLike[str]) -> None:
    """Write a checkpoint; see `Problem.save`. Collective."""
    history = [dataclasses.asdict(record) for record in problem.history]
    state = {**_identity(problem), **problem.state()}
    state["description"] = [list(pair) for pair in _description(problem).items()]
    checkpoint.write(path, problem.points, state, history, _laws(problem))


def load(problem: Problem, path: str | os.PathLike[str]) -> None:
    """Go on from a checkpoint; see `Problem.load`. Collective."""
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
    """What the problem is, in words, of which a next stage may change some. Collective."""
    own = describe(problem.fields, problem.form, problem.bcs)
    return {**own, **problem.scheme.description()}


def _laws(problem: Problem) -> list[str]:
    """Laws with their strain formulations; a next stage may have other parameters."""
    declared = problem.form.parts.declarations
    return sorted({f"{type(d.law).__name__} under {d.strain} strain" for d in declared})


def _identity(problem: Problem) -> dict[str, Any]:
    """What a checkpoint must have in common with the problem."""
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
    """What the state of a file has not in common with the problem, or None."""
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
