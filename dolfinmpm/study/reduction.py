"""Factors of safety by reduction of strength: at which share of its strength a body fails."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform.checks import number, shown
from dolfinmpm._platform.errors import ConvergenceError, ParameterError, PointsOutsideGridError
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.io.progress import progress
from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = ["FactorOfSafety", "Trial", "factor_of_safety", "reduced_strength"]

Loading = Callable[[float], Iterable[QuasiStatic]]


@dataclass(frozen=True)
class Trial:
    """A body with its strength reduced, under its load.

    Attributes:
        factor: What the strength was divided by.
        stands: Whether it carried the whole load.
        reason: Why not, in words; empty if it stands.
        steps: Converged steps of the load.
        displacement: Largest displacement of a material point after them (m).
        growth: That displacement over what the first step foretells.
        iterations: Newton iterations of them.
    """

    factor: float
    stands: bool
    reason: str
    steps: int
    displacement: float
    growth: float
    iterations: int


@dataclass(frozen=True)
class FactorOfSafety:
    """What a strength reduction found.

    Attributes:
        factor: Factor of safety, the middle of the bracket.
        bracket: Largest factor at which the body stands, and smallest at which it fails.
        trials: The runs, by increasing factor.
        criterion: What counts as failure, in words.
    """

    factor: float
    bracket: tuple[float, float]
    trials: tuple[Trial, ...]
    criterion: str

    def table(self) -> list[dict[str, Any]]:
        """The trials as rows for `write_table` and `draw_reduction`."""
        return [asdict(trial) for trial in self.trials]


def reduced_strength(cohesion: float, friction_angle: float, factor: float) -> tuple[float, float]:
    """Cohesion c/F (Pa) and friction angle arctan(tan φ / F) (degrees).

    Args:
        cohesion: Cohesion c (Pa).
        friction_angle: Friction angle φ (degrees), from 0 to below 90.
        factor: Factor F that both are divided by, more than 0.

    Raises:
        ParameterError: A number is outside what it may be.
    """
    number("factor", factor, 0.0)
    number("cohesion", cohesion, 0.0, unit="Pa", closed=True)
    if not 0 <= number("friction_angle", friction_angle, unit="degrees") < 90:
        raise ParameterError(
            f"friction_angle = {friction_angle} degrees must be from 0 to below 90"
        )
    tangent = math.tan(math.radians(friction_angle)) / factor
    return cohesion / factor, math.degrees(math.atan(tangent))


def factor_of_safety(
    loading: Loading,
    low: float = 1.0,
    high: float = 2.0,
    *,
    tolerance: float = 0.02,
    growth: float = 3.0,
    label: str = "strength reduction",
) -> FactorOfSafety:
    """Find the factor by which strength can be divided before a body fails. Collective.

    The body is loaded anew for every factor, and the interval between one that stands
    and one that fails is halved (Griffiths & Lane 1999, doi 10.1680/geot.1999.49.3.387).
    Their sign of failure is that the displacements rise dramatically while the iterations
    do not converge; here either is enough. The displacements are compared with those in
    proportion to the load, as the first step with strength over `low` tells them. Beyond the
    factor of safety they rise so steeply that `growth` matters little: from 2 to 10 it takes
    the slope of Griffiths & Lane from 1.40 to 1.45. A run ends with the step in which it fails.

    Args:
        loading: Function of the factor that builds the body with its strength divided by
            it, see `reduced_strength`, and then is a generator: it sets the load of each of
            at least two equal steps and yields the problem, which takes the step.
        low: A factor at which the body stands.
        high: A factor at which it fails.
        tolerance: Width of the interval at which the search ends.
        growth: Largest displacement over that in proportion to the load that still counts
            as standing, more than 1.
        label: Text beside the progress bar.

    Returns:
        The factor with its bracket and a table of all runs.

    Raises:
        ParameterError: A number is outside what it may be, the loading has fewer than two
            steps, the body fails at `low` already or stands at `high` still.
    """
    if not 0 < number("low", low) < number("high", high):
        raise ParameterError(f"low = {low} and high = {high} must be positive and increase")
    if not number("tolerance", tolerance) > 0:
        raise ParameterError(f"tolerance = {tolerance} must be a positive number")
    if not number("growth", growth, high=math.inf, closed=True) > 1:
        raise ParameterError(f"growth = {growth} must be more than 1, usually 2 to 10")

    first = _run(loading, low, growth, None)
    if not first.stands:
        raise ParameterError(f"the body fails at low = {low:g} already, {first.reason}; lower low")
    elastic = first.displacement / (first.growth * first.steps)
    last = _run(loading, high, growth, elastic)
    if last.stands:
        raise ParameterError(f"the body stands at high = {high:g} still; raise high")
    trials = [first, last]
    stands, fails = low, high
    halvings = max(math.ceil(math.log2((high - low) / tolerance)), 0)
    for _ in progress(range(halvings), label):
        trial = _run(loading, 0.5 * (stands + fails), growth, elastic)
        trials.append(trial)
        if trial.stands:
            stands = trial.factor
        else:
            fails = trial.factor
    return FactorOfSafety(
        0.5 * (stands + fails),
        (stands, fails),
        tuple(sorted(trials, key=lambda trial: trial.factor)),
        "a step of the load does not converge, however small it is made, or material points leave "
        f"the grid, or the largest displacement is more than {growth:g} times that in proportion "
        "to the load",
    )


def _run(loading: Loading, factor: float, growth: float, elastic: float | None) -> Trial:
    """One trial; `elastic` is the displacement of a step in proportion, by default its first's."""
    steps, iterations, displacement, grown, reason = 0, 0, 0.0, 1.0, ""
    for problem in _steps(loading, factor):
        if not callable(getattr(problem, "step", None)):
            raise ParameterError(
                f"the loading yields {shown(problem)}, and should yield the problem in every step"
            )
        try:
            record = problem.step()
        except (ConvergenceError, PointsOutsideGridError) as error:
            reason = f"in step {steps + 1} of the load: {error}"
            break
        steps += 1
        iterations += record.iterations
        displacement = _largest_displacement(problem.points)
        elastic = displacement if elastic is None else elastic
        if elastic <= 0:
            raise ParameterError("the first step of the load moves nothing; is its load zero?")
        grown = displacement / (steps * elastic)
        if grown > growth:
            reason = (
                f"in step {steps} of the load: the largest displacement, {displacement:.4g} m, is "
                f"{grown:.3g} times that in proportion to the load, more than {growth:g}"
            )
            break
    if steps < 2 and not reason:
        raise ParameterError(f"the loading at factor {factor:g} has {steps} steps, it needs two")
    return Trial(factor, not reason, reason, steps, displacement, grown, iterations)


def _steps(loading: Loading, factor: float) -> Iterable[QuasiStatic]:
    """The steps of a loading.

    Raises:
        ParameterError: It is no generator.
    """
    found = loading(factor) if callable(loading) else loading
    if not isinstance(found, Iterable):
        what = f"loading({factor:g}) returned {shown(found)}" if callable(loading) else "loading"
        raise ParameterError(
            f"{what} and must be a generator function of the factor: for every step of the load it "
            "sets the load and has `yield problem`, not `return problem`"
        )
    return found


def _largest_displacement(points: MaterialPoints) -> float:
    moved = np.linalg.norm(points["x"] - points["x0"], axis=1)
    return float(points.comm.allreduce(moved.max(initial=0.0), op=MPI.MAX))
