"""Calibration: parameters of an example from measurements, with their confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import (
    check_dictionary,
    check_function,
    check_names,
    coordinates,
    number,
    shown,
    whole,
)
from dolfinmpm._platform.errors import ParameterError, UnknownNameError
from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.study.derivatives import sizes_of
from dolfinmpm.study.scenerun import Scene
from dolfinmpm.study.weightedresiduals import WeightedResiduals

__all__ = ["Calibration", "calibrate"]

Array = npt.NDArray[np.float64]
Bounds = Mapping[str, tuple[float, float]]

# Relative standard deviation from which a parameter is called unknown, correlation from which two
# parameters are called one, and share of the largest singular value that counts as zero
_UNKNOWN, _ALIKE, _ZERO = 0.5, 0.95, 1e-7
# Distance from a bound within which a parameter can be called at it, as a change of its logarithm
# or as a share of its size; and share of its start below which it can be said to go towards 0
_NEAR, _SMALL = 0.05, 1e-3
# Bound of weighted measurements, far from where numbers end
_HUGE = 1e200


@unchanged(FOUND)
@dataclass
class Calibration:
    """Parameters that fit measurements best, and how well the measurements tell them.

    Attributes:
        parameters: Name → best value.
        intervals: Name → lower and upper end of its confidence interval.
        covariance: Covariance of the parameters, shape (p, p): of ln m where the start is positive,
            of m over its size elsewhere.
        correlation: Their correlation, shape (p, p).
        singular_values: Singular values of the weighted derivatives, largest first, shape (p,).
        directions: Their combinations of parameters, one per row, shape (p, p).
        misfit: Root mean square of the weighted residuals.
        figures: Name → figures of the best run after each step.
        measured: Name → measurements.
        trace: One row per run with derivatives: parameters, "misfit", and "failed", the reason of a
            run that failed, or an empty string.
        notes: Which parameters the measurements do not tell, and which end at a bound or go towards
            0, where intervals do not hold, in words.
        message: Why the iterations ended.

    Young's modulus of a bar from its stress:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> def scene(m):
    ...     grid = mpm.create_lattice(MPI.COMM_WORLD, [range(2), range(5)])
    ...     points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), per_cell=2, density=2000.0)
    ...     V = mpm.Space(grid, "gimp")
    ...     F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.0), points, V.increment, V.test)
    ...     bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, "top", 1, increment=-0.01)
    ...     problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    ...     stress = lambda: points["stress"][:, 1, 1].mean()
    ...     return mpm.study.Run(problem, [problem.step] * 3, {"stress": stress})
    >>> measured = {"stress": [-3.1e3, -6.2e3, -9.3e3]}
    >>> fit = mpm.study.calibrate(scene, {"E": 1e6}, measured)
    >>> round(fit.parameters["E"], -3), len(fit.trace) < 8
    (1231000.0, True)
    """

    parameters: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    covariance: Array
    correlation: Array
    singular_values: Array
    directions: Array
    misfit: float
    figures: dict[str, Array]
    measured: dict[str, Array]
    trace: list[dict[str, Any]]
    notes: list[str]
    message: str

    def __str__(self) -> str:
        """Parameters with their intervals, and the notes."""
        rows = [
            f"{name} = {value:.5g}, between {low:.5g} and {high:.5g}"
            for (name, value), (low, high) in zip(self.parameters.items(), self.intervals.values())
        ]
        return "\n".join([*rows, f"misfit {self.misfit:.3g}, {len(self.trace)} runs", *self.notes])

    def draw(self, axes: Any, name: str | None = None, **style: Any) -> None:
        """Draw a measurement and the figure of the best run over the steps.

        Args:
            axes: Matplotlib's axes.
            name: Name of the figure, by default the first.
            style: Further arguments of Matplotlib's `plot`, for the best run.

        Raises:
            UnknownNameError: No figure that was measured has this name.
        """
        name = next(iter(self.measured)) if name is None else name
        if name not in self.measured:
            raise UnknownNameError(
                f"there is no figure {shown(name)}; measured are {', '.join(self.measured)}"
            )
        steps = np.arange(1, len(self.measured[name]) + 1)
        flat = self.measured[name].reshape(len(steps), -1), self.figures[name]
        axes.plot(steps, flat[0], "o", mfc="none", label=f"{name}, measured")
        axes.plot(steps, flat[1].reshape(len(steps), -1), label=f"{name}, best run", **style)
        axes.set_xlabel("step")
        axes.set_ylabel(name)
        axes.legend()


def calibrate(
    scene: Scene,
    start: Mapping[str, float],
    measured: Mapping[str, npt.ArrayLike],
    *,
    bounds: Bounds | None = None,
    weights: Mapping[str, npt.ArrayLike] | None = None,
    scales: Mapping[str, float] | None = None,
    confidence: float = 0.95,
    tolerance: float = 1e-6,
    max_runs: int = 50,
    progress: Callable[[dict[str, Any]], Any] | None = None,
) -> Calibration:
    """Find the parameters of an example that fit measurements best. Collective.

    SciPy's `least_squares` takes residuals and derivatives from one call of `differentiate` each.
    Positive parameters are sought by their logarithm. A run that fails shortens the step.

    Confidence intervals follow from the derivatives at the best fit, with the variance of the
    residuals there, (Σ r²)/(n − p), and Student's distribution: see Seber & Wild (1989),
    *Nonlinear regression*, section 2.1. They hold for independent errors of the measurements.

    Args:
        scene: Function of a dictionary of parameters that returns a `Run`.
        start: Name → first value.
        measured: Name of a figure → its measured values after each step, shape (steps, ...); NaN
            where nothing was measured.
        bounds: Name → least and largest value.
        weights: Name of a figure → one over the standard deviation of its measurements, a number or
            an array of their shape. By default one over the largest measured value. Measurements
            of weight 0 do not count, as those that are NaN.
        scales: Name → size of a parameter whose start is not positive; see `differentiate`.
        confidence: Probability of the confidence intervals.
        tolerance: Relative change of the misfit, of the parameters, or size of its gradient, at
            which the iterations end.
        max_runs: Largest number of runs with derivatives.
        progress: Function that gets each new row of the trace, such as `print`.

    Returns:
        The best parameters with their intervals, and the runs.

    Raises:
        ParameterError: A name is unknown, a shape is wrong, a start is out of bounds, a measurement
            is infinite, there are fewer measurements than parameters, or a figure of the first run
            is not finite.
        ConvergenceError: The first run fails.

    See `Calibration` for an example:

    >>> import dolfinmpm as mpm
    >>> mpm.study.calibrate(lambda m: None, {"E": 1e6}, {"stress": []})
    Traceback (most recent call last):
    ...
    dolfinmpm._platform.errors.ParameterError: 0 measurements cannot tell 1 parameters: measure more
    """
    # SciPy's optimisation takes a second to import
    from scipy.optimize import least_squares

    check_function("scene", scene, "of a dictionary of parameters")
    # coordinates rise with their parameters, also where a start below zero is its own size
    sizes = {k: abs(v) for k, v in sizes_of(start, {} if scales is None else scales).items()}
    number("confidence", confidence, 0.5, 0.9999)
    number("tolerance", tolerance, 1e-14, 0.1)
    whole("max_runs", max_runs, 1)
    if progress is not None:
        check_function("progress", progress, "of a row of the trace", {})
    data, scaled = _measurements(measured, {} if weights is None else weights)
    settings = {"bounds": bounds, "confidence": confidence, "tolerance": tolerance,
                "max_runs": max_runs}  # fmt: skip
    residuals = WeightedResiduals(scene, start, sizes, data, scaled, settings, progress)
    if residuals.size < len(start):
        zero = " (those of weight 0 do not count)" * any((w == 0).any() for w in scaled.values())
        raise ParameterError(
            f"{residuals.size} measurements{zero} cannot tell {len(start)} parameters: measure more"
        )
    limits = _limits(residuals, start, {} if bounds is None else bounds)
    found = least_squares(
        lambda x: residuals.run(x)[0].copy(), np.zeros(len(start)),
        lambda x: residuals.run(x)[1].copy(), limits, ftol=tolerance, xtol=tolerance,
        gtol=1e-2 * tolerance, max_nfev=max_runs,
    )  # fmt: skip
    r, slopes, figures = residuals.run(found.x)
    fit = _judged(residuals, found, r, slopes, figures, data, confidence)
    fit.notes += _ends(residuals, found.x, r, slopes, limits)
    if found.status != 0:
        fit.notes += residuals.stopped(found.x, r, slopes, limits)
    else:
        fit.notes.append(
            f"the best of max_runs = {max_runs} runs, and no best fit: intervals do not hold; give "
            "more runs, a better start, or a larger tolerance"
        )
    return fit


def _measurements(
    measured: Mapping[str, npt.ArrayLike], weights: Mapping[str, npt.ArrayLike]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Measurements and weights as arrays of the same shapes."""
    check_dictionary("measured", measured, " of arrays", some=True)
    data = {name: coordinates(f"measured['{name}']", v) for name, v in measured.items()}
    for name, values in data.items():
        # the default weight would be zero, and would switch off the whole figure
        infinite = np.argwhere(np.isinf(np.atleast_1d(values)))
        if infinite.size:
            raise ParameterError(
                f"measured['{name}'] is infinite after step {infinite[0][0] + 1}, and must be "
                "finite: give NaN where nothing was measured"
            )
    check_dictionary("weights", weights, " of numbers or arrays")
    check_names("weights", weights, data, "measured has")
    scaled = {}
    for name, values in data.items():
        largest = np.nanmax(np.abs(values), initial=0.0)
        given = coordinates(
            f"weights['{name}']", weights.get(name, 1.0 / largest if largest else 1.0)
        )
        fits = given.ndim == 0 or given.shape == values.shape
        if not (fits and (given >= 0).all() and np.isfinite(given).all()):
            raise ParameterError(
                f"weights['{name}'] = {shown(given)} must be zero or positive, a number or an "
                f"array of the shape {values.shape} of the measurements"
            )
        largest = np.max(given, initial=0.0) * max(largest, 1.0)
        if not largest < _HUGE:
            raise ParameterError(
                f"weights['{name}'] = {shown(given)} times the measurements is {largest:.3g}, and "
                f"must be below {_HUGE:g}: weights are one over standard deviations"
            )
        scaled[name] = np.broadcast_to(given, values.shape)
    if scaled and all(w.size and not w.any() for w in scaled.values()):
        raise ParameterError("weights are all zero: let some measurement count")
    return data, scaled


def _limits(
    residuals: WeightedResiduals, start: Mapping[str, float], bounds: Bounds
) -> tuple[Array, Array]:
    """Bounds of the coordinates."""
    low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
    names = list(start)
    check_dictionary("bounds", bounds, " of pairs, such as {'E': (1e6, 1e8)}")
    check_names("bounds", bounds, names, "the parameters are")
    for name, ends in bounds.items():
        pair = coordinates(f"bounds['{name}']", ends)
        if pair.shape != (2,):
            raise ParameterError(f"bounds['{name}'] = {shown(ends)} must be (least, largest)")
        least, most = (number(f"bounds['{name}']", float(end)) for end in pair)
        if not least < most:
            raise ParameterError(
                f"bounds['{name}'] = ({least:g}, {most:g}) must be (least, largest), with the "
                "least below the largest"
            )
        if not least < start[name] < most:
            raise ParameterError(
                f"the start {name} = {start[name]:g} must be between its bounds {least:g} and "
                f"{most:g}"
            )
        at = names.index(name)
        low[at], high[at] = (residuals.coordinate(name, end) for end in (least, most))
    return low, high


def _judged(
    residuals: WeightedResiduals, found: Any, r: Array, slopes: Array, figures: dict[str, Array],
    data: dict[str, Array], confidence: float,
) -> Calibration:  # fmt: skip
    """The result, with its covariance and with what the measurements do not tell."""
    from scipy.stats import t as student

    parameters = residuals.at(found.x)
    n, p = slopes.shape
    _, values, directions = np.linalg.svd(slopes, full_matrices=False)
    told = values > _ZERO * max(float(values[0]), np.finfo(float).tiny)
    # with as many measurements as parameters there is no variance to see
    variance = float(r @ r) / (n - p) if n > p else np.inf
    with np.errstate(divide="ignore"):
        inverse = np.where(told, 1.0 / np.where(told, values, 1.0) ** 2, np.inf)
    # infinite along a combination that is not told, and zero beside it
    parts = np.where(np.abs(directions) > _ZERO, directions, 0.0)
    with np.errstate(invalid="ignore"):
        spread = np.array([[_sum(inverse * parts[:, i] * parts[:, j]) for j in range(p)]
                           for i in range(p)])  # fmt: skip
    # without a variance, covariances that are zero stay so; what is not told is so in any case
    covariance = np.where(spread == 0, 0.0, np.where(np.isinf(spread), 1.0, variance)) * spread
    width = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore"):
        correlation = spread / np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    reach = student.ppf(0.5 + confidence / 2, max(n - p, 1)) * width
    ends = [residuals.at(found.x + sign * reach) for sign in (-1, 1)]
    intervals = {k: (ends[0][k], ends[1][k]) for k in parameters}
    notes = _words(list(parameters), width, correlation, told, directions)
    if n == p:
        notes.append(f"{n} measurements for {p} parameters leave no variance to see: measure more")
    return Calibration(
        parameters, intervals, covariance, correlation, residuals.unit * values, directions,
        residuals.unit * float(np.sqrt(np.mean(r**2))), figures, data, residuals.trace, notes,
        found.message,
    )  # fmt: skip


def _sum(terms: Array) -> float:
    """Sum of terms, where infinity times zero is zero."""
    return float(np.sum(terms[~np.isnan(terms)]))


def _words(
    names: list[str], width: Array, correlation: Array, told: Any, directions: Array
) -> list[str]:
    """What the measurements do not tell, in words."""
    notes = []
    for direction in directions[~told]:
        parts = [
            f"{name}^{share:+.2f}" for name, share in zip(names, direction) if abs(share) > 0.01
        ]
        notes.append(f"the measurements do not depend on {' '.join(parts)}")
    for name, deviation in zip(names, width):
        if np.isfinite(deviation) and deviation > _UNKNOWN:
            notes.append(f"{name} is hardly told: its standard deviation is {deviation:.0%}")
    for i, one in enumerate(names):
        for j in range(i):
            r = correlation[i, j]
            if abs(r) > _ALIKE:
                how = "product" if r < 0 else "ratio"
                notes.append(
                    f"{names[j]} and {one} are told together, rather by their {how}: their "
                    f"correlation is {r:.3f}"
                )
    return notes


def _ends(
    residuals: WeightedResiduals, x: Array, r: Array, slopes: Array, limits: tuple[Array, Array]
) -> list[str]:
    """Which parameters end at a bound, or go towards 0, in words.

    Args:
        residuals: The residuals, with the names and values of the parameters.
        x: Coordinates of the best fit, shape (p,).
        r: Its residuals, shape (n,).
        slopes: Their derivatives by the coordinates, shape (n, p).
        limits: Least and largest coordinates, shape (p,) each.
    """
    notes, of = [], residuals.at(x)
    for i, (name, value) in enumerate(of.items()):
        gradient, square = float(slopes[:, i] @ r), float(slopes[:, i] @ slopes[:, i])
        # the change of this coordinate alone that would give the least misfit; without influence
        # on the figures there is none
        step = -gradient / square if square > 0 else 0.0
        low, high = float(limits[0][i]), float(limits[1][i])
        # SciPy's iterations stay within the bounds, and come near them only
        if (x[i] + step <= low and x[i] - low < _NEAR) or (
            x[i] + step >= high and high - x[i] < _NEAR
        ):
            bound = residuals.at(np.where(np.arange(x.size) == i, low if step < 0 else high, x))
            notes.append(
                f"{name} ends at its bound {bound[name]:.5g}: the measurements ask for more, and "
                "intervals do not hold there"
            )
            continue
        # a change of the logarithm by -1 is one of the parameter down to 0; half of it is enough
        fallen = residuals.positive(name) and x[i] < np.log(_SMALL)
        lost = square <= (_ZERO * float(np.abs(slopes).max())) ** 2
        if fallen and (step <= -0.5 or lost):
            notes.append(
                f"{name} = {value:.3g} goes towards 0, which its logarithm does not reach, and "
                "intervals do not hold there: give a bound, or leave the parameter out; if it may "
                f"be negative, give a start of at most 0 and scales={{'{name}': ...}}"
            )
    return notes
