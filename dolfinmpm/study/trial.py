"""Results of a strength reduction."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

__all__ = ["FactorOfSafety", "Trial", "largest_norm"]


def largest_norm(comm: MPI.Intracomm, vectors: npt.NDArray[np.float64]) -> float:
    """Largest norm of the vectors of all ranks, shape (n, gdim) on each rank. Collective."""
    norms = np.linalg.norm(vectors, axis=1)
    return float(comm.allreduce(norms.max(initial=0.0), op=MPI.MAX))


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
