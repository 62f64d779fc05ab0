"""The protocol of schemes: loads, times, equations and the state at the end of a step.

A scheme is a value given to a problem. A step, or each substep of a halved step, is

    operator = scheme.system(problem, step)
    x = solver.solve(operator)
    state = scheme.finish(problem, operator, x, step)

Only then the state is written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.assembly.term import NewState
from dolfinmpm.solve.newstate import new_state
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.problemchecks import refuse_time
from dolfinmpm.solve.step import Step, StepRecord

__all__ = ["Scheme", "Static"]

Array = npt.NDArray[np.float64]


class Scheme:
    """Common part of all schemes, for implicit and explicit steps.

    Attributes:
        record: Class of the records of steps.
        in_time: Whether steps have a length in seconds.
        inertia: Whether the balance of forces has inertia.
        ties_movers: Whether nodes with little support by points are constrained to others, in
            fields that move points.
        waves: Name and velocity by time (m/s) of each wave that comes in through a side.
    """

    record: type[StepRecord] = StepRecord
    in_time: bool = False
    inertia: bool = False
    ties_movers: bool = False
    waves: Sequence[tuple[str, Any]] = ()

    def summary(self) -> list[str]:
        """Lines on the scheme for `print(problem)`."""
        return []

    def description(self) -> dict[str, str]:
        """Name → description of settings that a next stage may change."""
        return {}

    def identity(self) -> dict[str, Any]:
        """Settings that must be equal in a checkpoint and in the problem that loads it."""
        return {}

    def regrid(self) -> None:
        """Discard data that depend on the old grid lines."""

    def state(self) -> dict[str, Any]:
        """Its state from step to step, by name. Collective."""
        return {}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`. Collective."""

    def remark_on(self, step: int) -> str:
        """Remark for the message about a step that failed from its start, or "".

        Args:
            step: Number of the step, from 1.
        """
        return ""


class Static(Scheme):
    """Forces balance at the end of each step, without inertia. Steps are shares of the load."""

    def begin(self, problem: Any, t: float | None) -> None:
        """Begin a call of `step`. Collective.

        Args:
            problem: The problem.
            t: Argument of the user's call.

        Raises:
            ParameterError: A time is given.
        """
        if t is not None:
            refuse_time(t, type(problem).__name__)

    def remark_on(self, step: int) -> str:
        """See `Scheme.remark_on`."""
        if step > 1:
            return ""
        return (
            ". A first step that fails may have moduli and loads in different units: compare the "
            "modulus of the law (Pa) with the largest stress"
        )

    def adapted(self) -> None:
        """Points have followed the leaves since `begin`. Collective."""

    def substep(self, done: float, share: float) -> Step:
        """The next substep.

        Args:
            done: Converged share of the step.
            share: Share of the substep.
        """
        return Step(done + share, share, share)

    def system(self, problem: Any, step: Step) -> Operator:
        """The equations of a step. Collective."""
        if problem.bodies.all:
            problem.bodies.begin(step.dt)
        return Operator(problem.form, problem.activate(step))

    def finish(self, problem: Any, operator: Operator, x: Array, step: Step) -> NewState | str:
        """The state at the end of a step, or the reason of a failure. Collective.

        Args:
            problem: The problem.
            operator: The step's equations, at their solution.
            x: The owned unknowns, shape (owned,).
            step: The step or substep.
        """
        return new_state(problem, operator)

    def holding_forces(self, operator: Operator, held: Array) -> Array:
        """Forces of conditions on the body, after `finish` (N). Collective.

        Args:
            operator: The step's equations.
            held: Forces that hold the increments in these equations.
        """
        return held

    def add_body_work(self, work: float) -> None:
        """Add the work done by rigid bodies in a step (J)."""

    def fail(self) -> None:
        """A call of `step` ends with an error: the form gets back the time of the state."""

    def end(self, record: StepRecord | None) -> None:
        """End a call of `step`. Collective.

        Args:
            record: Record of the call, or None after an error.
        """
