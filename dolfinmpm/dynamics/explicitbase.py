"""Explicit steps taken one after the other, in contrast to fused steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Set
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.dynamics.faces import Sides
from dolfinmpm.dynamics.kinks import Kinks
from dolfinmpm.dynamics.ledger import Work
from dolfinmpm.dynamics.settings import Settings
from dolfinmpm.solve.step import Step

__all__ = ["ExplicitBase"]

Array = npt.NDArray[np.float64]


class ExplicitBase(ABC):
    """Explicit steps of a problem, one after the other.

    Args:
        problem: The problem.
        settings: Settings of the steps.
        sides: Faces of the grid that act on the body.
        instead: Reason why the steps are not fused.

    Attributes:
        at_once: Largest number of steps per call.
        sides, instead: The arguments.
        kinks: Where the steps are not smooth; None unless somebody asks for it.
        keeps_speed: Whether the critical step follows from the points' fields alone. Steps that
            are not fused find the critical step in every call.
    """

    at_once, keeps_speed = 1, False

    def __init__(self, problem: Any, settings: Settings, sides: Sides, instead: str):
        self._problem, self._settings = problem, settings
        self.sides, self.instead = sides, instead
        self._work = Work()
        self.kinks: Kinks | None = None

    def work(self) -> Work:
        """Works and losses since the last call of this method."""
        done, self._work = self._work, Work()
        return done

    def renew(self) -> None:  # noqa: B027 - nothing is to be done
        """Start the next call like the first call. These steps keep nothing."""

    def start(self, rate: float, touched: Set[str]) -> None:  # noqa: B027 - nothing is to be done
        """Begin a call. These steps read the points anew in every step."""

    def release(self) -> None:  # noqa: B027 - nothing is to be done
        """End a call. These steps keep no arrays of the points."""

    def run(
        self, count: int, dt: float, kick: float, more: bool, begin: Callable[[int], Step]
    ) -> tuple[int, int, str | None]:
        """Take equal steps. Collective.

        Args:
            count: Number of steps.
            dt: Length of each step (s).
            kick: Time during which forces act in the first step (s): half of the last step and half
                of this one.
            more: Whether further steps follow without a new start.
            begin: Function from the number of a step to the `Step`. It sets the time in form and
                conditions.

        Returns:
            Number of steps taken, number of points that changed rank, and the reason of an early
            end, or None.
        """
        migrated = 0
        for k in range(count):
            found = self._take(begin(k), dt if k else kick)
            if isinstance(found, str):
                return k, migrated, found
            migrated += found
        return count, migrated, None

    @abstractmethod
    def _take(self, step: Step, kick: float) -> int | str:
        """Take one step. Collective.

        Args:
            step: The step.
            kick: Time during which forces act in the step (s).

        Returns:
            Number of points that changed rank, or the reason of a failure.
        """
