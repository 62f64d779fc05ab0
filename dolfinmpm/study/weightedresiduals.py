"""Weighted residuals of measurements, and their derivatives, from one run each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import (
    ConvergenceError,
    ParameterError,
    PointsOutsideGridError,
    StateError,
)
from dolfinmpm.study.derivatives import differentiate
from dolfinmpm.study.scenerun import Run, Scene

__all__ = ["WeightedResiduals"]

Array = npt.NDArray[np.float64]


class WeightedResiduals:
    """Weighted residuals and their derivatives; both come from one run.

    Args:
        scene: The example.
        start: First values of the parameters.
        sizes: Sizes of the parameters.
        measured: Name → measurements after each step; NaN where there is none.
        weights: Name → weights, of the same shapes.
        say: Function of a row of the trace, or None.

    Attributes:
        trace: Rows of the trace.
    """

    def __init__(
        self, scene: Scene, start: Mapping[str, float], sizes: Mapping[str, float],
        measured: dict[str, Array], weights: dict[str, Array],
        say: Callable[[dict[str, Any]], Any] | None,
    ):  # fmt: skip
        self._scene, self._start, self._sizes, self._say = scene, dict(start), dict(sizes), say
        self._measured, self._weights = measured, weights
        self.trace: list[dict[str, Any]] = []
        self._comm: MPI.Intracomm = MPI.COMM_SELF
        self._known: dict[bytes, tuple[Array, Array, dict[str, Array]]] = {}

    def at(self, x: Array) -> dict[str, float]:
        """Parameters at coordinates: ln (m / start) of positive ones, (m − start) / size."""
        return {
            name: value * float(np.exp(q)) if value > 0 else value + float(q) * self._sizes[name]
            for (name, value), q in zip(self._start.items(), x)
        }

    def coordinate(self, name: str, value: float) -> float:
        """Coordinate of a value of a parameter; the inverse of `at`."""
        start = self._start[name]
        if start > 0:
            return float(np.log(value / start)) if value > 0 else -np.inf
        return (value - start) / self._sizes[name]

    def _built(self, m: dict[str, float]) -> Run:
        run = self._scene(m)
        if isinstance(run, Run):
            self._comm = run.problems[0].comm
        return run

    def run(self, x: Array) -> tuple[Array, Array, dict[str, Array]]:
        """Residuals, their derivatives, and figures, of a run at coordinates. Collective."""
        # all ranks must take the same way to the last bit
        x = np.asarray(self._comm.bcast(x))
        if x.tobytes() not in self._known:
            self._known = {x.tobytes(): self._new(x)}
        return self._known[x.tobytes()]

    def _new(self, x: Array) -> tuple[Array, Array, dict[str, Array]]:
        m, failed, figures = self.at(x), "", {}
        scales = {k: self._sizes[k] for k, value in self._start.items() if value <= 0}
        count = sum(int(np.isfinite(values).sum()) for values in self._measured.values())
        residuals, slopes = np.full(count, np.inf), np.full((count, x.size), np.nan)
        try:
            found = differentiate(self._built, m, scales=scales, central=False)
        except (ConvergenceError, PointsOutsideGridError, StateError) as error:
            if not self.trace:
                raise
            failed = str(error)
        else:
            figures = found.figures
            self._check(figures)
            keep = {k: np.isfinite(values) for k, values in self._measured.items()}
            residuals = np.concatenate([
                (self._weights[k] * (figures[k] - values))[keep[k]]
                for k, values in self._measured.items()
            ])  # fmt: skip
            slopes = np.concatenate([
                np.stack([(w * found.derivatives[k][p])[keep[k]] for p in m], axis=-1)
                for k, w in self._weights.items()
            ])  # fmt: skip
            residuals, slopes = self._comm.bcast((residuals, slopes))
        misfit = float(np.sqrt(np.mean(residuals**2)))
        row = {**m, "misfit": misfit, "failed": failed}
        self.trace.append(row)
        if self._say is not None:
            self._say(row)
        return residuals, slopes, figures

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
