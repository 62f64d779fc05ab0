"""Factors of safety by reduction of strength: at which share of its strength a body fails."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform.checks import number, shown
from dolfinmpm._platform.errors import (
    ConvergenceError,
    DegreesWarning,
    ParameterError,
    PointsOutsideGridError,
    warn,
)
from dolfinmpm._platform.together import meet
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.io.progress import progress
from dolfinmpm.materials.strength import reduced_angle
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.study.fromstate import FromState
from dolfinmpm.study.trial import FactorOfSafety, Trial

__all__ = ["factor_of_safety", "reduced_strength"]

Loading = Callable[[float], Iterable[QuasiStatic]]


def reduced_strength(cohesion: float, friction_angle: float, factor: float) -> tuple[float, float]:
    """Cohesion c/F (Pa) and friction angle arctan(tan φ / F) (degrees).

    Args:
        cohesion: Cohesion c (Pa).
        friction_angle: Friction angle φ (degrees), from 0 to below 90.
        factor: Factor F that both are divided by, more than 0.

    Raises:
        ParameterError: A number is outside what it may be.

    Warns:
        DegreesWarning: The angle looks like one in radians.
    """
    number("factor", factor, 0.0)
    number("cohesion", cohesion, 0.0, unit="Pa", closed=True)
    if not 0 <= number("friction_angle", friction_angle, unit="degrees") < 90:
        raise ParameterError(
            f"friction_angle = {friction_angle} degrees must be from 0 to below 90"
        )
    if math.radians(1.0) <= friction_angle < 1.0:
        warn(
            MPI.COMM_WORLD,
            f"friction_angle = {friction_angle:g} degrees is below 1 degree; if radians were meant "
            f"give {math.degrees(friction_angle):.4g}",
            DegreesWarning,
        )
    return cohesion / factor, float(reduced_angle(friction_angle, factor))


def factor_of_safety(
    loading: QuasiStatic | Loading,
    low: float = 1.0,
    high: float = 2.0,
    *,
    tolerance: float = 0.02,
    growth: float = 3.0,
    steps: int = 5,
    over: float | None = None,
    label: str = "strength reduction",
) -> FactorOfSafety:
    """Find the factor by which strength can be divided before a body fails. Collective.

    Of a problem in the state that it has come to, whatever led there: initial stress, stages,
    water; or of a body that is loaded anew for every factor. The interval between a factor at
    which it stands and one at which it fails is halved (Griffiths & Lane 1999, doi
    10.1680/geot.1999.49.3.387). Their sign of failure is that the displacements rise dramatically
    while the iterations do not converge; here either is enough. Beyond the factor of safety they
    rise so steeply that `growth` matters little: from 2 to 10 it takes the slope of Griffiths &
    Lane from 1.40 to 1.45. A run ends with the step in which it fails.

    Trials of a problem start from its present state, which it has again in the end. Loads stay,
    prescribed increments rest, and its laws' strength is divided, see `Law`: a cohesion by the
    factor, the tangent of a friction angle too; a dilation angle stays as long as it is not
    larger. Stresses that are too large then return to the yield surface. Displacements are those
    since the state, and are compared with those by which the loads would move the elastic body,
    which count as there already.

    Of a body that is loaded anew they are compared with those in proportion to the load, as the
    first step with strength over `low` tells them.

    Args:
        loading: A problem between steps, `mpm.QuasiStatic` or `mpm.Transient`. Or a function of the
            factor that builds the body with its strength divided by it, see `reduced_strength`,
            and then is a generator: it sets the load of each of at least two equal steps and
            yields the problem, which takes the step.
        low: A factor at which the body stands.
        high: A factor at which it fails.
        tolerance: Width of the interval at which the search ends.
        growth: Largest displacement over that in proportion to the load that still counts
            as standing, more than 1.
        steps: Of a problem: steps in which a trial reduces the strength; one that does not
            converge is halved up to three times.
        over: Of an `mpm.Transient`, which needs it: time (s) in which a trial reduces the strength,
            and water flows: short for undrained, long for drained.
        label: Text beside the progress bar.

    Returns:
        The factor with its bracket and a table of all runs.

    Raises:
        ParameterError: A number is outside what it may be, the loading is no generator of problems
            or has fewer than two steps, no law has a strength or one does not tell it, the body
            fails at `low` already or stands at `high` still.
    """
    if not 0 < number("low", low) < number("high", high):
        raise ParameterError(f"low = {low} and high = {high} must be positive and increase")
    if not number("tolerance", tolerance) > 0:
        raise ParameterError(f"tolerance = {tolerance} must be a positive number")
    if not number("growth", growth, high=math.inf, closed=True) > 1:
        raise ParameterError(f"growth = {growth} must be more than 1, usually 2 to 10")
    if isinstance(loading, QuasiStatic):
        limits = {"low": low, "high": high, "tolerance": tolerance, "growth": growth}
        meet(loading.comm, "factor_of_safety", **limits, steps=steps, over=over)
        with FromState(loading, growth, steps, over) as attempt:
            found = _search(attempt, low, high, tolerance, label)
        failure = (
            "a step of the reduction does not converge, however small it is made, or material "
            "points leave the grid, or the largest displacement since the state and that by which "
            f"the loads would move the elastic body are more than {growth:g} times the latter"
        )
        return FactorOfSafety(*found, failure)
    if not callable(loading):
        raise ParameterError(
            f"loading = {shown(loading)} must be an mpm.QuasiStatic or mpm.Transient, or a "
            "function of the factor that yields one for each step"
        )
    found = _search(_Anew(loading, growth), low, high, tolerance, label)
    failure = (
        "a step of the load does not converge, however small it is made, or material points leave "
        f"the grid, or the largest displacement is more than {growth:g} times that in proportion "
        "to the load"
    )
    return FactorOfSafety(*found, failure)


def _search(
    attempt: Callable[[float], Trial], low: float, high: float, tolerance: float, label: str
) -> tuple[float, tuple[float, float], tuple[Trial, ...]]:
    """The factor, its bracket and the trials that led there."""
    first = attempt(low)
    if not first.stands:
        raise ParameterError(f"the body fails at low = {low:g} already, {first.reason}; lower low")
    last = attempt(high)
    if last.stands:
        raise ParameterError(f"the body stands at high = {high:g} still; raise high")
    trials = [first, last]
    stands, fails = low, high
    halvings = max(math.ceil(math.log2((high - low) / tolerance)), 0)
    for _ in progress(range(halvings), label):
        trial = attempt(0.5 * (stands + fails))
        trials.append(trial)
        if trial.stands:
            stands = trial.factor
        else:
            fails = trial.factor
    ordered = tuple(sorted(trials, key=lambda trial: trial.factor))
    return 0.5 * (stands + fails), (stands, fails), ordered


class _Anew:
    """Trials of a body that is loaded anew for every factor.

    Args:
        loading: Generator of the problem's steps, for a factor.
        growth: Largest displacement over that in proportion that counts as standing.
    """

    def __init__(self, loading: Loading, growth: float):
        self._loading, self._growth = loading, growth
        # displacement of a step in proportion, which the first one tells
        self._elastic: float | None = None

    def __call__(self, factor: float) -> Trial:
        growth, elastic = self._growth, self._elastic
        steps, iterations, displacement, grown, reason = 0, 0, 0.0, 1.0, ""
        for problem in _steps(self._loading, factor):
            if not callable(getattr(problem, "step", None)):
                raise ParameterError(
                    f"the loading yields {shown(problem)}, and should yield the problem in every "
                    "step"
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
                    f"in step {steps} of the load: the largest displacement, {displacement:.4g} m, "
                    f"is {grown:.3g} times that in proportion to the load, more than {growth:g}"
                )
                break
        if steps < 2 and not reason:
            raise ParameterError(
                f"the loading at factor {factor:g} has {steps} steps, it needs two"
            )
        if self._elastic is None and not reason:
            self._elastic = displacement / (grown * steps)
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
