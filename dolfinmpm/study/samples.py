"""Runs at many values of the parameters, side by side on groups of ranks."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_function, check_kind, choice, whole
from dolfinmpm._platform.errors import (
    ConvergenceError,
    ParameterError,
    PointsOutsideGridError,
    raise_together,
)
from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.study.distributions import checked
from dolfinmpm.study.scenerun import Run, built, last_value, take_steps

__all__ = ["MonteCarlo", "last_figures", "monte_carlo"]

Array = npt.NDArray[np.float64]
# of parameters, or of parameters and a communicator
AnyScene = Callable[..., Run]


def last_figures(
    scene: AnyScene, samples: Sequence[Mapping[str, float]], limit: str, *,
    ranks: int | None = None, unconverged: str = "raise",
) -> Array:  # fmt: skip
    """A figure after the last step, at each sample, shape (samples,). Collective.

    Args:
        scene: Function of a dictionary of parameters that returns a `Run`. With `ranks`, its second
            argument is the communicator of the run.
        samples: Parameters by name.
        limit: Name of the figure.
        ranks: Number of ranks per run; groups of ranks take samples side by side. None takes all
            ranks for each run.
        unconverged: "raise", or "failure": a run without a solution has the figure −inf.

    Raises:
        ParameterError: The figure is unknown or not a number, or the scene takes no communicator.
        ConvergenceError: A run finds no solution, with unconverged="raise".
    """
    unconverged = choice("unconverged", unconverged, ("raise", "failure"))
    world = MPI.COMM_WORLD
    if ranks is None:
        return np.array([_figure(scene, (m,), limit, unconverged) for m in samples])
    whole("ranks", ranks, 1)
    if len(inspect.signature(scene).parameters) < 2:
        raise ParameterError(
            f"ranks = {ranks} needs a scene of two arguments, scene(parameters, comm), which makes "
            "its grid on the communicator comm"
        )
    groups = max(world.size // ranks, 1)
    group = min(world.rank // ranks, groups - 1)
    comm = world.Split(group, world.rank)
    found, error = np.zeros(len(samples)), None
    try:
        for k in range(group, len(samples), groups):
            value = _figure(scene, (samples[k], comm), limit, unconverged)
            # each sample counts once, from the first rank of its group
            found[k] = value if comm.rank == 0 else 0.0
    except Exception as caught:
        error = caught
    raise_together(world, error)
    comm.Free()
    return np.asarray(world.allreduce(found))


def _figure(scene: AnyScene, arguments: tuple[Any, ...], limit: str, unconverged: str) -> float:
    """The figure of one run after its last step. Collective on the ranks of the run."""
    run = built(scene, *arguments, limit=limit)
    try:
        take_steps(run)
    except (ConvergenceError, PointsOutsideGridError):
        if unconverged == "raise":
            raise
        return -math.inf
    return last_value(run, limit, arguments[0])


@unchanged(FOUND)
@dataclass
class MonteCarlo:
    """A probability of failure from runs at random parameters.

    Attributes:
        values: The figure after the last step of each run, shape (runs,).
        samples: Parameters of each run.

    See `monte_carlo`:

    >>> import numpy as np
    >>> import dolfinmpm as mpm
    >>> found = mpm.study.MonteCarlo(np.array([1.0, -1.0]), [{"a": 0.0}, {"a": 1.0}])
    >>> found.probability, found.beta
    (0.5, 0.0)
    """

    values: Array
    samples: list[dict[str, float]] = field(repr=False)

    @property
    def probability(self) -> float:
        """Share of the runs that fail."""
        return float(np.mean(self.values < 0))

    @property
    def variation(self) -> float:
        """Coefficient of variation of the probability; inf if no run fails."""
        p = self.probability
        return math.sqrt((1 - p) / (p * self.values.size)) if p else math.inf

    @property
    def beta(self) -> float:
        """Reliability index, −Φ⁻¹(probability)."""
        from scipy.special import ndtri

        return 0.0 - float(ndtri(self.probability))


def monte_carlo(
    scene: AnyScene,
    distributions: Mapping[str, Any],
    limit: str = "margin",
    *,
    runs: int = 1000,
    seed: int = 1,
    ranks: int | None = None,
    unconverged: str = "raise",
) -> MonteCarlo:
    """Probability of failure by plain Monte Carlo sampling. Collective.

    The samples depend on the seed only, so that they are equal on any number of ranks.

    Args:
        scene: Function of a dictionary of parameters that returns a `Run`. With `ranks`, its second
            argument is the communicator on which it makes its grid.
        distributions: Name → `Normal`, `LogNormal`, or a distribution of OpenTURNS; independent.
        limit: Name of the figure whose value after the last step is below zero at failure.
        runs: Number of runs.
        seed: Seed of NumPy's generator.
        ranks: Number of ranks per run; groups of ranks take runs side by side. None takes all ranks
            for each run.
        unconverged: "raise", or "failure" to count a run without a solution as a failure.

    Returns:
        The figures of all runs; `probability` is the share of the runs that fail.

    Raises:
        ParameterError: An argument is not valid.
        ConvergenceError: A run finds no solution, with unconverged="raise".

    The stress in a bar that may be too stiff:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> def scene(m, comm):
    ...     grid = mpm.create_lattice(comm, [range(2), range(5)])
    ...     points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), per_cell=2, density=2000.0)
    ...     V = mpm.Space(grid, "gimp")
    ...     F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.0), points, V.increment, V.test)
    ...     bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, "top", 1, increment=-0.01)
    ...     problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    ...     margin = lambda: 3e3 + points["stress"][:, 1, 1].mean()
    ...     return mpm.study.Run(problem, [problem.step], {"margin": margin})
    >>> given = {"E": mpm.study.Normal(1e6, 2e5)}
    >>> found = mpm.study.monte_carlo(scene, given, runs=20, seed=2, ranks=1)
    >>> found.probability
    0.15
    """
    check_function("scene", scene, "of a dictionary of parameters")
    check_kind("limit", limit, str, 'the name of a figure of the scene, such as "margin"')
    places = checked(distributions)
    whole("runs", runs, 2)
    z = np.random.default_rng(whole("seed", seed, 0, math.inf)).standard_normal((runs, len(places)))
    columns = {name: place(z[:, k]) for k, (name, place) in enumerate(places.items())}
    samples = [{name: float(x[k]) for name, x in columns.items()} for k in range(runs)]
    values = last_figures(scene, samples, limit, ranks=ranks, unconverged=unconverged)
    return MonteCarlo(values, samples)
