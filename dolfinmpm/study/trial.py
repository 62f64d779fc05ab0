"""Trials of a strength reduction: when a body stands, and the results."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.essentialconditions import EssentialConditions
from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = ["FactorOfSafety", "Trial", "come_to_rest", "held", "largest_norm"]

# A body is at rest when a step moves it by less than this share of its elastic displacement
AT_REST = 0.01
# Field of the points: positions before a step (m)
_BEFORE = "x_before_step"


def largest_norm(comm: MPI.Intracomm, vectors: npt.NDArray[np.float64]) -> float:
    """Largest norm of the vectors of all ranks, shape (n, gdim) on each rank. Collective."""
    norms = np.linalg.norm(vectors, axis=1)
    return float(comm.allreduce(norms.max(initial=0.0), op=MPI.MAX))


@contextlib.contextmanager
def held(problem: QuasiStatic) -> Iterator[None]:
    """Set prescribed increments to zero in this context, but keep pressures. Collective."""
    prescribed = problem.essential_conditions
    still = [
        condition
        if condition.kind == "value"
        else replace(condition, value=0.0, velocity=None, function=None)
        for condition in prescribed.conditions
    ]
    problem.essential_conditions = EssentialConditions(still, problem.form.spaces)
    try:
        yield
    finally:
        problem.essential_conditions = prescribed


def come_to_rest(
    step: Callable[[], str], points: MaterialPoints, elastic: float, growth: float
) -> str:
    """Take steps under the same loads and strength until the body is at rest. Collective.

    A ghost penalty resists the increment of each step. In one step it can carry a body that fails.
    Such a body moves on in the next steps, and a body that stands comes to rest.

    Args:
        step: Takes a step. It returns the reason of a failure, or an empty string.
        points: The material points.
        elastic: Displacement of the elastic body (m).
        growth: Largest growth of the displacement that counts as standing.

    Returns:
        The reason of a failure, or an empty string for a body at rest.
    """
    most, moved = math.ceil((growth - 1.0) / AT_REST), 0.0
    for _ in range(most):
        points.fields[_BEFORE] = points["x"].copy()
        reason = step()
        moved = largest_norm(points.comm, points["x"] - points.fields.pop(_BEFORE))
        if reason or moved < AT_REST * elastic:
            return reason
    return (
        f"the body still moves by {moved:.3g} m per step after {most} steps under the same load, "
        f"more than {AT_REST:g} of the displacement of the elastic body, {elastic:.3g} m"
    )


@unchanged(FOUND)
@dataclass(frozen=True)
class Trial:
    """One trial of a strength reduction: a body with reduced strength under its load.

    Attributes:
        factor: Factor that divided the strength.
        stands: Whether the body carried the whole load.
        reason: Reason of the failure in words; empty if the body stands.
        steps: Number of converged steps of the load; or of the reduction, for a problem that was
            loaded before.
        displacement: Largest displacement of a material point in these steps (m).
        growth: Growth of the displacement, as `factor_of_safety` defines it (-).
        iterations: Number of Newton iterations in these steps.

    A trial that failed:

    >>> import dolfinmpm as mpm
    >>> from dolfinmpm.study import Trial
    >>> fails = Trial(2.0, False, "growth", steps=3, displacement=0.05, growth=5.0, iterations=20)
    >>> f"at {fails.factor}: " + ("stands" if fails.stands else f"fails by {fails.reason}")
    'at 2.0: fails by growth'
    """

    factor: float
    stands: bool
    reason: str
    steps: int
    displacement: float
    growth: float
    iterations: int


@unchanged(FOUND)
@dataclass(frozen=True)
class FactorOfSafety:
    """Result of a strength reduction.

    Attributes:
        factor: Factor of safety, the middle of the bracket.
        bracket: Largest factor at which the body stands, and smallest factor at which it fails.
        trials: The trials, by increasing factor.
        criterion: Criterion of failure, in words.

    As `factor_of_safety` returns it:

    >>> import dolfinmpm as mpm
    >>> from dolfinmpm.study import FactorOfSafety, Trial
    >>> stands = Trial(1.0, True, "", steps=5, displacement=0.01, growth=1.0, iterations=15)
    >>> fails = Trial(2.0, False, "growth", steps=3, displacement=0.05, growth=5.0, iterations=20)
    >>> found = FactorOfSafety(1.5, (1.0, 2.0), (stands, fails), "growth above 3")
    >>> found.factor, [trial.stands for trial in found.trials]
    (1.5, [True, False])
    """

    factor: float
    bracket: tuple[float, float]
    trials: tuple[Trial, ...]
    criterion: str

    def table(self) -> list[dict[str, Any]]:
        """The trials as rows for `write_table` and `draw_reduction`."""
        return [asdict(trial) for trial in self.trials]
