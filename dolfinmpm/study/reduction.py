"""Factors of safety by strength reduction."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from dolfinmpm._platform.argumentchecks import number, shown
from dolfinmpm._platform.collective import check_same_call
from dolfinmpm._platform.errors import (
    ConvergenceError,
    ParameterError,
    PointsOutsideGridError,
)
from dolfinmpm._platform.units import warn_of_radians
from dolfinmpm.io.progress import progress
from dolfinmpm.materials.strength import reduced_angle
from dolfinmpm.solve.problem import Problem
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.study.fromstate import FromState
from dolfinmpm.study.trial import FactorOfSafety, Trial, come_to_rest, held, largest_norm

__all__ = ["factor_of_safety", "reduced_strength"]

Loading = Callable[[float], Iterable[QuasiStatic]]


def reduced_strength(cohesion: float, friction_angle: float, factor: float) -> tuple[float, float]:
    """Reduced cohesion c/F (Pa) and friction angle arctan(tan φ / F) (degrees).

    Args:
        cohesion: Cohesion c (Pa).
        friction_angle: Friction angle φ (degrees), from 0 to below 90.
        factor: Factor F that divides the strength, more than 0.

    Raises:
        ParameterError: A number is out of range.

    Warns:
        DegreesWarning: The angle looks like an angle in radians.

    >>> import dolfinmpm as mpm
    >>> c, phi = mpm.study.reduced_strength(cohesion=10e3, friction_angle=20.0, factor=1.4)
    >>> round(c, 1), round(phi, 2)
    (7142.9, 14.57)
    """
    number("factor", factor, 0.0)
    number("cohesion", cohesion, 0.0, unit="Pa", closed=True)
    if not 0 <= number("friction_angle", friction_angle, unit="degrees") < 90:
        raise ParameterError(
            f"friction_angle = {friction_angle} degrees must be from 0 to below 90"
        )
    warn_of_radians("friction_angle", friction_angle)
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
    """Factor of safety: the largest factor that can divide the strength before a body fails.

    There are two ways. The first is a problem in its present state, with its initial stress, stages
    and water. The second is a function that loads a new body for every factor. Bisection halves
    the interval between a factor at which the body stands and a factor at which it fails
    (Griffiths & Lane 1999, doi 10.1680/geot.1999.49.3.387). For Griffiths and Lane, a body fails if
    displacements rise dramatically and iterations do not converge. Here one of the two is enough.
    Displacements rise steeply above the factor of safety, so that `growth` matters little: with 2
    to 10, the slope of Griffiths and Lane has factors of 1.40 and 1.41. A trial ends with the step
    in which the body fails. A body stands when it comes to rest: a trial goes on under the whole
    load and the reduced strength until a step moves it by less than 1 % of the elastic displacement
    under the loads. A ghost penalty resists the increment of each step, so that it can hold a body
    that fails in one step, but not in the next ones. Collective.

    Ground without cohesion is different. It fails at its surface, in a layer that is thinner than
    the cells. A few points then move ahead of the body, and displacements rise gradually. The
    factor depends on `growth` and on the cells, and may be above or below tan φ/tan β, that of an
    infinite slope of the angle β. Compare several of both, or give a small cohesion.

    First way: trials start from the present state of the problem, and the problem has this state
    again at the end. Loads stay, and prescribed increments are zero. The factor divides the
    cohesion and the tangent of the friction angle of each law, see `Law`. A dilation angle stays
    as long as it is not larger than the friction angle. Stresses outside the yield surface return
    to it. Growth is 1 + d/d_e, with the largest displacement d in the trial, and the largest
    displacement d_e of the elastic body under the loads.

    A body that fails at its own strength has no such state: it has flowed, and the factor is that
    of the flatter body. Take the second way.

    Second way: growth is the largest displacement over a displacement in proportion to the load.
    The first step at the factor `low` defines the proportion.

    Args:
        loading: A problem between steps, `mpm.QuasiStatic` or `mpm.Transient`. Or a generator
            function of the factor. The function builds the body with reduced strength, see
            `reduced_strength`. For each of at least two equal steps, it sets the load and yields
            the problem, an `mpm.QuasiStatic`. `factor_of_safety` then takes the step.
        low: A factor at which the body stands.
        high: A factor at which the body fails.
        tolerance: Width of the interval at which the search ends.
        growth: Largest growth of displacements that counts as standing, more than 1.
        steps: For a problem: number of steps in which a trial reduces the strength. A step that
            does not converge is halved up to three times.
        over: For an `mpm.Transient`, and only there: time (s) in which a trial reduces the
            strength and water flows; short for undrained, long for drained.
        label: Text next to the progress bar.

    Returns:
        The factor with its bracket and a table of all trials.

    Raises:
        ParameterError: A number is out of range; the loading is no generator of problems or has
            fewer than two steps; no law has a strength, or a law does not tell its strength; the
            body fails already at `low`, or still stands at `high`.

    An undrained block under its own weight, in coarse steps:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> import ufl
    >>> F = mpm.momentum(mpm.materials.Tresca(1e6, 0.3, 15e3), points, V.increment, V.test)
    >>> F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), V.test) * points.dX
    >>> bcs = mpm.fixed(V, "bottom")
    >>> problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    >>> record = problem.step()
    >>> found = mpm.study.factor_of_safety(problem, 1.0, 4.0, tolerance=0.5, steps=2)
    >>> found.bracket, [(t.factor, t.stands) for t in found.trials]
    ((2.125, 2.5), [(1.0, True), (1.75, True), (2.125, True), (2.5, False), (4.0, False)])
    """
    if not 0 < number("low", low) < number("high", high):
        raise ParameterError(f"low = {low} and high = {high} must be positive and increase")
    number("tolerance", tolerance, 0.0)
    if not number("growth", growth, high=math.inf, closed=True) > 1:
        raise ParameterError(f"growth = {growth} must be more than 1, usually 2 to 10")
    if isinstance(loading, QuasiStatic):
        limits = {"low": low, "high": high, "tolerance": tolerance, "growth": growth}
        check_same_call(loading.comm, "factor_of_safety", **limits, steps=steps, over=over)
        with FromState(loading, growth, steps, over) as attempt:
            found = _search(attempt, low, high, tolerance, label)
        failure = (
            "a step of the reduction does not converge, also after halvings; or material points "
            f"leave the grid; or 1 + d/d_e is more than {growth:g}, with the largest displacement "
            "d since the state, and the displacement d_e of the elastic body under the loads; or "
            "the body does not come to rest at the reduced strength"
        )
        return FactorOfSafety(*found, failure)
    if not callable(loading):
        raise ParameterError(
            f"loading = {shown(loading)} must be an mpm.QuasiStatic or mpm.Transient, or a "
            "function of the factor that yields such a problem for each step"
        )
    if over is not None:
        raise ParameterError(
            f"over = {over!r} is for an mpm.Transient, not for a function of the factor: leave "
            "it out"
        )
    found = _search(_FromStart(loading, growth), low, high, tolerance, label)
    failure = (
        "a step of the load does not converge, also after halvings; or material points leave the "
        f"grid; or the largest displacement is more than {growth:g} times the displacement in "
        "proportion to the load; or the body does not come to rest under the whole load"
    )
    return FactorOfSafety(*found, failure)


def _search(
    attempt: Callable[[float], Trial], low: float, high: float, tolerance: float, label: str
) -> tuple[float, tuple[float, float], tuple[Trial, ...]]:
    """The factor, its bracket, and the trials by increasing factor."""
    first = attempt(low)
    if not first.stands:
        raise ParameterError(
            f"the body fails at low = {low:g} already, {first.reason}; give a smaller low"
        )
    last = attempt(high)
    if last.stands:
        raise ParameterError(f"the body stands at high = {high:g} still; give a larger high")
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


class _FromStart:
    """Trials of a new body for every factor, which is loaded from the start.

    Args:
        loading: Function of a factor that yields the problem of each step.
        growth: Largest growth of displacements that counts as standing.
    """

    def __init__(self, loading: Loading, growth: float):
        self._loading, self._growth = loading, growth
        # displacement per step in proportion to the load, from the first step of the first trial
        self._elastic = 0.0

    def __call__(self, factor: float) -> Trial:
        problems = self._loading(factor)
        if not isinstance(problems, Iterable):
            raise ParameterError(
                f"loading({factor:g}) returned {shown(problems)} and must be a generator function "
                "of the factor: for every step of the load it sets the load and has `yield "
                "problem`, not `return problem`"
            )
        way = _Way(self._elastic, self._growth)
        reason, problem = "", None
        for problem in problems:
            if isinstance(problem, Problem) and problem.scheme.in_time:
                raise ParameterError(
                    f"the loading yields an mpm.{type(problem).__name__}, whose steps take time, "
                    "and should yield an mpm.QuasiStatic. For soil with water give "
                    "factor_of_safety the mpm.Transient itself, and over=, or a QuasiStatic with "
                    "the pressure of the water as a field"
                )
            if not callable(getattr(problem, "step", None)):
                raise ParameterError(
                    f"the loading yields {shown(problem)}, and should yield the problem in every "
                    "step"
                )
            reason = way.step(problem, f"in step {way.loads + 1} of the load", loads=1)
            if reason:
                break
        if way.loads < 2 and not reason:
            raise ParameterError(
                f"the loading at factor {factor:g} has {way.loads} steps, but needs at least two"
            )
        # a rigid body with an increment moves in every step
        rests = isinstance(problem, QuasiStatic) and problem.bodies.driven(1.0) is None
        if rests and not reason:
            with held(problem):
                reason = come_to_rest(
                    lambda: way.step(problem, "under the whole load"),
                    problem.points, way.loads * way.elastic, self._growth,
                )  # fmt: skip
        if not reason:
            self._elastic = way.elastic
        return Trial(factor, not reason, reason, way.loads, way.moved, way.grown, way.iterations)


class _Way:
    """Steps of a trial, and how far they have moved the body.

    Args:
        elastic: Displacement per step in proportion to the load (m); zero for that of the first
            step.
        growth: Largest growth of displacements that counts as standing.

    Attributes:
        elastic: The argument, or the displacement of the first step.
        loads: Number of converged steps of the load.
        iterations: Newton iterations.
        moved: Largest displacement of a point (m).
        grown: The same over the displacement in proportion to the load.
    """

    def __init__(self, elastic: float, growth: float):
        self.elastic, self._growth = elastic, growth
        self.loads, self.iterations = 0, 0
        self.moved, self.grown = 0.0, 1.0

    def step(self, problem: QuasiStatic, when: str, loads: int = 0) -> str:
        """Take a step; the reason of a failure, or an empty string. Collective.

        Args:
            problem: The problem.
            when: The step in words, for the reason.
            loads: Number of steps of the load that it is.
        """
        try:
            record = problem.step()
        except (ConvergenceError, PointsOutsideGridError) as error:
            return f"{when}: {error}"
        self.iterations += record.iterations
        self.loads += loads
        self.moved = largest_norm(problem.points.comm, problem.points["x"] - problem.points["x0"])
        self.elastic = self.elastic or self.moved
        if self.elastic <= 0:
            raise ParameterError(
                "the first step of the load moves nothing: check that the load is not zero"
            )
        self.grown = self.moved / (self.loads * self.elastic)
        if self.grown <= self._growth:
            return ""
        return (
            f"{when}: the largest displacement, {self.moved:.4g} m, is {self.grown:.3g} times the "
            f"displacement in proportion to the load, more than {self._growth:g}"
        )
