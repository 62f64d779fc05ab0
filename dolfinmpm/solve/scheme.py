"""The protocol of schemes: how loads, times, equations and the state at the end hang together.

A problem is given a scheme as a value. A step, or each part of one that is halved, is

    operator = scheme.system(problem, step)
    x = solver.solve(operator)
    state = scheme.finish(problem, operator, x, step)

and only then the state is written.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.assembly.term import NewState
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.solve.advance import advance
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.step import Step, StepRecord
from dolfinmpm.solve.timeless import refuse_time

if TYPE_CHECKING:
    from dolfinmpm.solve.problem import Problem

__all__ = ["Scheme", "Static"]

Array = npt.NDArray[np.float64]


class Scheme:
    """What is common to all schemes; implicit and explicit steps add what they need.

    Attributes:
        record: Class of the records of steps.
        in_time: Whether steps have a length in seconds.
        inertia: Whether forces balance with inertia at their level.
        ties_movers: Whether nodes that move points are tied where points hardly support them.
    """

    record: type[StepRecord] = StepRecord
    in_time: bool = False
    inertia: bool = False
    ties_movers: bool = False

    def summary(self) -> list[str]:
        """Lines on the scheme for `print(problem)`."""
        return []

    def description(self) -> dict[str, str]:
        """What a next stage may change, in words."""
        return {}

    def identity(self) -> dict[str, Any]:
        """What a checkpoint must have in common with the problem that loads it."""
        return {}

    def regrid(self) -> None:
        """Forget what belongs to where the grid's lines were."""

    def state(self) -> dict[str, Any]:
        """What it keeps from step to step, by name. Collective."""
        return {}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Take what `state` returned. Collective."""


class Static(Scheme):
    """Forces balance at the end of each step, without inertia; a step goes a share of the load."""

    def begin(self, problem: Any, t: float | None) -> None:
        """Begin a call of `step`. Collective.

        Args:
            problem: The problem.
            t: What the user gave.

        Raises:
            ParameterError: A time is given.
        """
        refuse_time(t, type(problem).__name__)

    def part(self, done: float, share: float) -> Step:
        """What is asked for of a part of a step.

        Args:
            done: Share of the step that is done.
            share: Share that is asked for.
        """
        return Step(done + share, share, share)

    def system(self, problem: Any, step: Step) -> Operator:
        """The equations of a step. Collective."""
        problem.bodies.begin(step.dt)
        return Operator(problem.form, problem.activate(step))

    def finish(self, problem: Any, operator: Operator, x: Array, step: Step) -> NewState | str:
        """The state at the end of a step, or why there is none. Collective.

        Args:
            problem: The problem.
            operator: The step's equations, moved to their solution.
            x: The owned unknowns, shape (owned,).
            step: What was asked for.
        """
        return ended(problem, operator)

    def count(self, work: float) -> None:
        """Take note of the work (J) that rigid bodies have done in a step."""

    def end(self, record: StepRecord | None) -> None:
        """End a call of `step`. Collective.

        Args:
            record: What the call did, or None if it ended with an error.
        """


def ended(
    problem: Problem, operator: Operator, kept: Mapping[str, Array] | None = None
) -> NewState | str:
    """The state that goes with the increments that equations were moved to; see `advance`.

    Args:
        problem: The problem.
        operator: The equations.
        kept: Fields that the form carries, where they are known already.
    """
    cell, number = largest_cell(problem.points.grid), len(problem.history) + 1
    return advance(operator, problem.form.updates, problem.moves, cell, number, kept=kept)
