"""A figure of an example as function of its parameters, with gradient, for any library."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import (
    check_dictionary,
    check_function,
    check_kind,
    coordinates,
    number,
    shown,
)
from dolfinmpm._platform.errors import ParameterError, call_together
from dolfinmpm.study.derivatives import Derivatives, differentiate
from dolfinmpm.study.distributions import openturns
from dolfinmpm.study.scenerun import Run, Scene, built, last_number, last_value, take_steps

__all__ = ["LimitState"]

Array = npt.NDArray[np.float64]

# Least size of a parameter's changes in derivatives, as a share of its value
_LEAST = 0.01


class LimitState:
    """A figure of an example after its last step, as function of the parameters, with gradient.

    Args:
        scene: Function of a dictionary of parameters that returns a `Run`.
        limit: Name of the figure. Its value after the last step counts; below zero the example
            counts as failed.
        sizes: Name → size of the parameter's changes, in its unit, such as a standard deviation.

    Attributes:
        names: Names of the parameters, in their order.
        runs: Number of runs with derivatives, and without.

    A bar whose stress is bounded, for any library of reliability:

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
    >>> g = mpm.study.LimitState(scene, "margin", {"E": 1e5})
    >>> round(g([1e6])), (1e3 * g.gradient([1e6])).round(2).tolist()
    (491, [-2.51])
    """

    def __init__(self, scene: Scene, limit: str, sizes: Mapping[str, float]):
        check_function("scene", scene, "of a dictionary of parameters")
        check_dictionary("sizes", sizes, " of numbers, such as {'E': 1e5}", some=True)
        for name, size in sizes.items():
            number(f"sizes['{name}']", size, 0.0)
        check_kind("limit", limit, str, 'the name of a figure of the scene, such as "margin"')
        self._scene, self._limit, self._sizes = scene, limit, dict(sizes)
        self.names, self.runs = list(sizes), [0, 0]
        self._comm: MPI.Intracomm = MPI.COMM_SELF
        self._runs: dict[bytes, tuple[float, Array | None]] = {}

    def _built(self, m: dict[str, float]) -> Run:
        run = built(self._scene, m, limit=self._limit)
        self._comm = run.problems[0].comm
        return run

    def __call__(self, values: npt.ArrayLike) -> float:
        """The figure at values of the parameters, from a run without derivatives. Collective.

        Args:
            values: One value per parameter, shape (p,), each in its unit.

        Raises:
            ParameterError: A value is not finite, the figure is not one number or NaN, or the scene
                returns no `Run`.
        """
        x = self._shared(values)
        if x.tobytes() not in self._runs:
            run = self._built(self._named(x))
            take_steps(run)
            found = last_value(run, self._limit, self._named(x))
            self._keep(x, found, None)
            self.runs[1] += 1
        return self._runs[x.tobytes()][0]

    def gradient(self, values: npt.ArrayLike) -> Array:
        """Derivatives by the parameters, shape (p,), per unit of each. Collective.

        Args:
            values: One value per parameter, shape (p,), each in its unit.

        Raises:
            ParameterError: As `LimitState.__call__`, or a derivative is not finite.
        """
        x = self._shared(values)
        former = self._runs.get(x.tobytes())
        if former is None or former[1] is None:
            m = self._named(x)
            # a small deviation of a large value would be lost in its rounding
            scales = {k: max(abs(size), _LEAST * abs(m[k])) for k, size in self._sizes.items()}
            found = differentiate(self._built, m, scales=scales)
            self._keep(x, *call_together(self._comm, lambda: self._last(found)))
            self.runs[0] += 1
        slopes = self._runs[x.tobytes()][1]
        assert slopes is not None
        return slopes

    def _last(self, found: Derivatives) -> tuple[float, Array]:
        """The figure after the last step, and its derivatives, shape (p,), per unit of each."""
        m, by = found.parameters, found.derivatives[self._limit]
        value = last_number(self._limit, found.figures[self._limit][-1], m)
        slopes = np.array([by[k][-1].item() / found.scales[k] for k in self.names])
        for name, slope in zip(self.names, slopes):
            if not np.isfinite(slope):
                raise ParameterError(
                    f"the derivative of the figure '{self._limit}' by {name} is {slope:g} at {m}: "
                    "return a figure that is finite beside these parameters, too"
                )
        return value, slopes

    def _named(self, x: Array) -> dict[str, float]:
        return {name: float(value) for name, value in zip(self.names, x)}

    def _shared(self, values: npt.ArrayLike) -> Array:
        """The values of rank 0: all ranks must take the same way to the last bit."""
        x = np.asarray(self._comm.bcast(coordinates("values", values)))
        if x.shape != (len(self.names),):
            raise ParameterError(
                f"values = {shown(values)} must be one number for each of {', '.join(self.names)}"
            )
        for name, value in self._named(x).items():
            number(name, value)
        return x

    def _keep(self, x: Array, value: float, slopes: Array | None) -> None:
        # only the last few: a long simulation must not grow
        if len(self._runs) > 8:
            self._runs.clear()
        self._runs[x.tobytes()] = self._comm.bcast((value, slopes))

    def made(self, derivatives: bool) -> Any:
        """The function of OpenTURNS.

        Args:
            derivatives: Whether each run is one with derivatives, because its gradient follows.
        """

        def value(x: Any) -> list[float]:
            if derivatives:
                self.gradient(x)
            return [self(x)]

        return openturns().PythonFunction(
            len(self.names), 1, value, gradient=lambda x: [[float(g)] for g in self.gradient(x)]
        )
