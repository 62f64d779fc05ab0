"""Weighted residuals of measurements, and their derivatives, from one run each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_takes
from dolfinmpm._platform.collective import check_same_call
from dolfinmpm._platform.errors import (
    ConvergenceError,
    ParameterError,
    PointsOutsideGridError,
    StateError,
)
from dolfinmpm.study.derivatives import Derivatives, differentiate
from dolfinmpm.study.scenerun import Run, Scene

__all__ = ["WeightedResiduals"]

Array = npt.NDArray[np.float64]

# Distance of a coordinate from its bound that counts as none, share of the largest singular value
# that counts as zero, and fall of the sum of squares that a best fit does not leave: as a share of
# the sum, and per residual that is exact but for rounding
_AT_BOUND, _UNTOLD, _FALL, _EXACT = 0.05, 1e-7, 0.01, 1e-10


class WeightedResiduals:
    """Weighted residuals and their derivatives; both come from one run.

    Args:
        scene: The example.
        start: First values of the parameters.
        sizes: Sizes of the parameters.
        measured: Name → measurements after each step; NaN where there is none.
        weights: Name → weights, of the same shapes; measurements of weight zero do not count.
        settings: What else all ranks must have in common, by name, such as bounds.
        say: Function of a row of the trace, or None.

    Attributes:
        trace: Rows of the trace.
        size: Number n of the measurements that count, which have residuals.
        unit: Unit of the residuals: the largest weighted measurement, or the largest weighted
            figure of the first run if all measurements are zero. So weights have no effect on
            where iterations end.
    """

    def __init__(
        self, scene: Scene, start: Mapping[str, float], sizes: Mapping[str, float],
        measured: dict[str, Array], weights: dict[str, Array], settings: Mapping[str, Any],
        say: Callable[[dict[str, Any]], Any] | None,
    ):  # fmt: skip
        self._scene, self._start, self._sizes, self._say = scene, dict(start), dict(sizes), say
        self._measured, self._weights = measured, weights
        self._compared = {"measured": measured, "weights": weights, **settings}
        # a residual of weight zero would be a degree of freedom that tells nothing
        self._keep = {k: np.isfinite(v) & (weights[k] > 0) for k, v in measured.items()}
        self.size = sum(int(keep.sum()) for keep in self._keep.values())
        self.unit = self._largest(measured)
        self.trace: list[dict[str, Any]] = []
        self._comm: MPI.Intracomm = MPI.COMM_SELF
        self._last: dict[bytes, tuple[Array, Array, dict[str, Array]]] = {}

    def _largest(self, values: Mapping[str, Array]) -> float:
        """Largest weighted value where a measurement counts."""
        sizes = [(self._weights[k] * np.abs(values[k]))[keep] for k, keep in self._keep.items()]
        return max(float(one.max(initial=0.0)) for one in sizes)

    def at(self, x: Array) -> dict[str, float]:
        """Parameters at coordinates: ln (m / start) of positive ones, (m − start) / size."""
        with np.errstate(over="ignore"):
            factors = np.exp(x)
        return {
            name: value * float(factor) if value > 0 else value + float(q) * self._sizes[name]
            for (name, value), q, factor in zip(self._start.items(), x, factors)
        }

    def positive(self, name: str) -> bool:
        """Whether the coordinate of a parameter is its logarithm, so that it stays above 0."""
        return self._start[name] > 0

    def coordinate(self, name: str, value: float) -> float:
        """Coordinate of a value of a parameter; the inverse of `at`."""
        start = self._start[name]
        if self.positive(name):
            return float(np.log(value / start)) if value > 0 else -np.inf
        return (value - start) / self._sizes[name]

    def _built(self, m: dict[str, float]) -> Run:
        check_takes("scene", self._scene, m)
        run = self._scene(m)
        if isinstance(run, Run):
            self._comm = run.problems[0].comm
            check_same_call(self._comm, "study.calibrate", **self._compared)
        return run

    def run(self, x: Array) -> tuple[Array, Array, dict[str, Array]]:
        """Residuals, their derivatives, and figures, of a run at coordinates. Collective.

        Returns:
            Residuals over `unit`, shape (n,), their derivatives by the coordinates, shape (n, p),
            and name → figures. Residuals of a run that failed are inf, and its derivatives NaN.

        Raises:
            ParameterError: A figure that was measured is missing or has another shape, or a figure
                of the first run is not finite.
            ConvergenceError: The first run fails.
        """
        # all ranks must take the same way to the last bit
        x = np.asarray(self._comm.bcast(x))
        if x.tobytes() not in self._last:
            self._last = {x.tobytes(): self._new(x)}
        return self._last[x.tobytes()]

    def _new(self, x: Array) -> tuple[Array, Array, dict[str, Array]]:
        m, failed, figures = self.at(x), "", {}
        scales = {k: self._sizes[k] for k, value in self._start.items() if value <= 0}
        residuals, slopes = np.full(self.size, np.inf), np.full((self.size, x.size), np.nan)
        try:
            found = differentiate(self._built, m, scales=scales)
        except (ConvergenceError, PointsOutsideGridError, StateError) as error:
            if not self.trace:
                raise
            failed = str(error)
        else:
            figures = found.figures
            self._check(figures)
            # all ranks must take the words of rank 0, too: they decide whether the run failed
            failed = self._comm.bcast(self._undefined(found))
            if failed and not self.trace:
                raise ParameterError(
                    f"{failed} in the first run: return a finite number there, or give NaN as the "
                    "measurement"
                )
            if not failed:
                self.unit = self.unit or self._largest(figures) or 1.0
                residuals, slopes = self._comm.bcast(self._weighted(found))
        misfit = self.unit * float(np.sqrt(np.mean(residuals**2)))
        row = {**m, "misfit": misfit, "failed": failed}
        self.trace.append(row)
        if self._say is not None:
            self._say(row)
        return residuals, slopes, figures

    def stopped(self, x: Array, r: Array, slopes: Array, limits: tuple[Array, Array]) -> list[str]:
        """Note about a run that is the best one only because runs beside it fail, in words.

        SciPy's iterations shorten the step until it is too small to count. Then the misfit would
        still fall by the derivatives, as it does at no best fit.

        Args:
            x: Coordinates of the best run, shape (p,).
            r: Its residuals over `unit`, shape (n,).
            slopes: Their derivatives by the coordinates, shape (n, p).
            limits: Least and largest coordinates, shape (p,) each.
        """
        failed = [row["failed"] for row in self.trace if row["failed"]]
        # a parameter at its bound is held there
        free = np.minimum(x - limits[0], limits[1] - x) > _AT_BOUND
        if not failed or not free.any():
            return []
        step = np.linalg.lstsq(slopes[:, free], -r, rcond=_UNTOLD)[0]
        left, square = r + slopes[:, free] @ step, float(r @ r)
        fall = square - float(left @ left)
        if not fall > max(_FALL * square, _EXACT * r.size):
            return []
        misfits = [self.unit * float(np.sqrt(np.mean(values**2))) for values in (r, left)]
        return [
            f"runs beside the best one fail, the last with '{failed[-1]:.100}', and by its "
            f"derivatives the misfit {misfits[0]:.3g} would fall to {misfits[1]:.3g} beyond: this "
            "is no best fit, and intervals do not hold; give another start or bounds, or compare "
            "figures from before the failure"
        ]

    def _weighted(self, found: Derivatives) -> tuple[Array, Array]:
        """Residuals over `unit`, shape (n,), and their derivatives, shape (n, p)."""
        weights = {k: w / self.unit for k, w in self._weights.items()}
        residuals = [
            (weights[k] * (found.figures[k] - values))[self._keep[k]]
            for k, values in self._measured.items()
        ]
        slopes = [
            np.stack([(w * d)[self._keep[k]] for d in found.derivatives[k].values()], axis=-1)
            for k, w in weights.items()
        ]
        return np.concatenate(residuals), np.concatenate(slopes)

    def _undefined(self, found: Derivatives) -> str:
        """The first figure that counts and is not finite, or whose derivative is not, in words."""
        for name, keep in self._keep.items():
            # the derivatives come second, because a figure that is nan has none
            of = {f"the derivative of the figure '{name}' by {p}": values
                  for p, values in found.derivatives[name].items()}  # fmt: skip
            for what, values in {f"the figure '{name}'": found.figures[name], **of}.items():
                bad = keep & ~np.isfinite(values)
                if bad.any():
                    step = int(np.argwhere(bad)[0][0]) + 1
                    return f"{what} is {values[bad][0]:g} after step {step}"
        return ""

    def _check(self, figures: Mapping[str, Array]) -> None:
        """Raise ParameterError unless the run has all that was measured."""
        for name, values in self._measured.items():
            if name not in figures:
                raise ParameterError(
                    f"measured has '{name}', and the figures of the scene are {', '.join(figures)}"
                )
            if figures[name].shape != values.shape:
                raise ParameterError(
                    f"measured['{name}'] has the shape {values.shape}, and the figure has "
                    f"{figures[name].shape}: one row per step, NaN where nothing was measured"
                )
