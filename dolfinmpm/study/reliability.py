"""Reliability: how likely an example fails if its parameters are random. FORM by OpenTURNS."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import number, whole
from dolfinmpm._platform.errors import ConvergenceError, ParameterError
from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.study.distributions import LogNormal, Normal, checked, openturns
from dolfinmpm.study.limitstate import LimitState
from dolfinmpm.study.scenerun import Scene

__all__ = ["Reliability", "reliability"]

Array = npt.NDArray[np.float64]

# Digits of one-sided differences: no design point is known better
_DIGITS = 1e-6
_UNCHANGED = (
    "does the scene take them from its argument? The least of several figures does not change "
    "where two of them are equal: give one of them"
)


@unchanged(FOUND)
@dataclass
class Reliability:
    """Reliability index, probability of failure, and importance of the inputs.

    Attributes:
        beta: Reliability index of Hasofer and Lind.
        probability: Probability of failure by FORM, Φ(−β).
        design: Name → value at the design point, the most likely failure.
        normal_design: The same in standard normal space.
        importance: Name → share of the variance of the margin, by its gradient in standard normal
            space at the design point; their sum is one.
        runs: Number of runs with derivatives, and without.
        notes: Where the search has stopped short of the design point, in words.

    See `reliability`:

    >>> import dolfinmpm as mpm
    >>> mpm.study.Reliability(2.0, 0.02275, {"E": 1.0}, {"E": 2.0}, {"E": 1.0}, [3, 0]).beta
    2.0
    """

    beta: float
    probability: float
    design: dict[str, float]
    normal_design: dict[str, float]
    importance: dict[str, float]
    runs: list[int]
    notes: list[str] = field(default_factory=list)
    _back: Any = field(default=None, repr=False)
    _limit: Any = field(default=None, repr=False)

    def check(self, runs: int = 200, seed: int = 1) -> tuple[float, float]:
        """Probability of failure by sampling about the design point. Collective.

        Args:
            runs: Number of runs, on all ranks each.
            seed: Seed of NumPy's generator.

        Returns:
            The probability, and its coefficient of variation; see Melchers (1989), *Importance
            sampling in structural systems*, doi 10.1016/0167-4730(89)90003-9.
        """
        ot = openturns()
        count, rng = whole("runs", runs, 2), np.random.default_rng(whole("seed", seed, 0, math.inf))
        u0 = np.array(list(self.normal_design.values()))
        found = np.zeros(count)
        for k in range(count):
            u = u0 + rng.standard_normal(u0.size)
            if self._limit(list(self._back(ot.Point(u)))) < 0:
                found[k] = math.exp(float(u0 @ u0) / 2 - float(u0 @ u))
        mean = float(found.mean())
        return mean, float(found.std(ddof=1) / math.sqrt(count) / mean) if mean else math.inf

    def draw(self, axes: Any, **style: Any) -> None:
        """Draw the importance factors and the design point.

        Args:
            axes: Matplotlib's axes.
            style: Further arguments of Matplotlib's `barh`.
        """
        names = list(self.importance)[::-1]
        axes.barh(
            [f"{k} = {self.design[k]:.4g}" for k in names],
            [self.importance[k] for k in names],
            **style,
        )
        axes.set_xlabel(f"share of the variance; β = {self.beta:.3f}")


def _made(name: str, given: Any) -> Any:
    """The distribution of OpenTURNS of a parameter.

    Raises:
        ParameterError: It is not continuous.
    """
    if isinstance(given, (Normal, LogNormal)):
        return given.made()
    if not given.isContinuous():
        raise ParameterError(
            f"distributions['{name}'] is not continuous, as FORM needs it: sample it with "
            "study.monte_carlo"
        )
    return given


def _search(ot: Any, tolerance: float, square: float, max_iterations: int) -> Any:
    """The search of Abdo and Rackwitz for the design point.

    Args:
        ot: OpenTURNS.
        tolerance, max_iterations: See `reliability`.
        square: Square of the gradient of the limit state at the medians.
    """
    ask = ot.AbdoRackwitz()
    for name in ("IterationNumber", "CallsNumber"):
        setter = getattr(ask, f"setMaximum{name}", None)
        if setter is not None:
            setter(max_iterations * (1 if name == "IterationNumber" else 5))
    ask.setMaximumAbsoluteError(tolerance)
    ask.setMaximumRelativeError(tolerance)
    ask.setMaximumResidualError(tolerance)
    ask.setMaximumConstraintError(tolerance * math.sqrt(square))
    return ask


def _first_guess(back: Any, normal: Array, limit: str, value: float) -> Any:
    """Values of the parameters at a point of standard normal space.

    Args:
        back: Transformation of OpenTURNS to values of the parameters.
        normal: The point, shape (p,).
        limit: Name of the figure.
        value: Its value at the medians.

    Raises:
        ConvergenceError: The point is out of reach of the distributions.
    """
    try:
        guess = back(openturns().Point(normal))
        reached = np.isfinite(np.array(guess)).all()
    except RuntimeError:
        reached = False
    if not reached:
        raise ConvergenceError(
            f"limit = '{limit}' is {value:g} at the medians, and by its slope there failure is "
            f"{float(np.linalg.norm(normal)):.3g} standard deviations away, out of reach of the "
            "distributions: check units and sign of the figure, which is below zero at failure"
        )
    return guess


def _shortfalls(u: Array, slope: Array, value: float, limit: str, tolerance: float) -> list[str]:
    """Which conditions of a design point do not hold, in words.

    Args:
        u: The point in standard normal space, shape (p,).
        slope: Gradient of the figure there, shape (p,).
        value: The figure there.
        limit: Its name.
        tolerance: Distance in standard normal space within which the conditions must hold.
    """
    size = float(np.linalg.norm(slope))
    notes = []
    if abs(value) > tolerance * size:
        far = f"{abs(value) / size:.2g} standard deviations away" if size else "nowhere near"
        notes.append(
            f"limit = '{limit}' is {value:.3g} at the design point, and by its slope zero is {far}"
        )
    across = float(np.linalg.norm(u - (u @ slope) * slope / size**2)) if size else 0.0
    if across > tolerance:
        notes.append(
            f"the gradient of '{limit}' is not along the design point, which is {across:.2g} "
            "standard deviations off its direction"
        )
    advice = (
        f" (tolerance {tolerance:g}): the search has not converged, and beta may be wrong. Give "
        "a smaller tolerance, more iterations, a limit that crosses zero and has no kinks, or "
        "sample it with study.monte_carlo"
    )
    return [note + advice for note in notes]


def reliability(
    scene: Scene,
    distributions: Mapping[str, Any],
    limit: str = "margin",
    *,
    tolerance: float = 1e-3,
    max_iterations: int = 30,
) -> Reliability:
    """Reliability index of an example by FORM. Collective.

    OpenTURNS seeks the design point with the algorithm of Abdo and Rackwitz (1991), doi
    10.1016/0045-7949(91)90318-7. Each iteration takes about one run with derivatives. It also
    stops where its steps become short. So `notes` tells where the design point is none: the figure
    must be zero there, and its gradient parallel to the point in standard normal space.

    Args:
        scene: Function of a dictionary of parameters that returns a `Run`.
        distributions: Name → `Normal`, `LogNormal`, or a distribution of OpenTURNS; independent.
        limit: Name of the figure whose value after the last step is below zero at failure.
        tolerance: Error of the design point in standard normal space, and of the figure there,
            in standard deviations.
        max_iterations: Largest number of iterations.

    Returns:
        Reliability index, probability of failure and design point.

    Raises:
        MissingPackageError: OpenTURNS is not installed.
        ParameterError: The figure is not among those of the scene, or there is no parameter.
        ConvergenceError: No design point is found.

    A bar whose stress is bounded:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> def scene(m):
    ...     grid = mpm.create_lattice(MPI.COMM_WORLD, [range(2), range(5)])
    ...     points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), per_cell=2, density=2000.0)
    ...     V = mpm.Space(grid, "gimp")
    ...     F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.0), points, V.increment, V.test)
    ...     bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, "top", 1, increment=-0.01)
    ...     problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    ...     margin = lambda: 3e3 + points["stress"][:, 1, 1].mean()
    ...     return mpm.study.Run(problem, [problem.step], {"margin": margin})
    >>> found = mpm.study.reliability(scene, {"E": mpm.study.Normal(1e6, 1e5)})  # doctest: +SKIP
    >>> round(found.beta, 2)  # doctest: +SKIP
    1.96
    """
    ot = openturns()
    number("tolerance", tolerance, 1e-12, 0.1)
    checked(distributions)
    whole("max_iterations", max_iterations, 1)
    each = [_made(name, given) for name, given in distributions.items()]
    sizes = {k: float(d.getStandardDeviation()[0]) for k, d in zip(distributions, each)}
    middle = [float(d.computeQuantile(0.5)[0]) for d in each]
    g = LimitState(scene, limit, sizes)
    joint = (getattr(ot, "JointDistribution", None) or ot.ComposedDistribution)(each)
    back = joint.getInverseIsoProbabilisticTransformation()
    # the first guess is the design point of the tangent at the medians: from the medians, the
    # line search of Abdo and Rackwitz takes far too short steps
    origin = ot.Point(len(each))
    slope = np.array(back.gradient(origin)) @ g.gradient(middle)
    square, value = float(slope @ slope), g(middle)
    if square == 0.0:
        raise ParameterError(
            f"limit = '{limit}' changes with none of {', '.join(distributions)} at the medians: "
            f"{_UNCHANGED}"
        )
    ask = _search(ot, tolerance, square, max_iterations)
    ask.setStartingPoint(_first_guess(back, -value / square * slope, limit, value))
    vector = ot.RandomVector(joint)
    event = ot.ThresholdEvent(
        ot.CompositeRandomVector(ot.Function(g.made(True)), vector), ot.Less(), 0.0
    )
    try:
        form = ot.FORM(ask, event)
    except TypeError:
        form = ot.FORM(ask, event, ask.getStartingPoint())
    try:
        form.run()
    except RuntimeError as error:
        raise ConvergenceError(
            f"FORM finds no design point: '{limit}' is {value:g} at the medians, and may not fall "
            "to zero within reach of the distributions, or has kinks: look at it at other "
            f"parameters, or sample it with study.monte_carlo ({error})"
        ) from error
    result = form.getResult()
    design, normal = result.getPhysicalSpaceDesignPoint(), result.getStandardSpaceDesignPoint()
    u = np.array(normal)
    # the gradient has the direction of the design point, also where this is the origin
    slope = np.array(back.gradient(normal)) @ g.gradient(design)
    notes = _shortfalls(u, slope, g(design), limit, max(tolerance, _DIGITS))
    slope = slope if slope.any() else u
    shares = slope**2 / float(slope @ slope)
    side = -1 if result.getIsStandardPointOriginInFailureSpace() else 1
    physical, standard, importance = (
        {name: float(x) for name, x in zip(distributions, values)}
        for values in (design, normal, shares)
    )
    probability = float(result.getEventProbability())
    beta = side * float(np.linalg.norm(u))
    return Reliability(beta, probability, physical, standard, importance, g.runs, notes, back, g)
