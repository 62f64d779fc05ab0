"""Explicit steps that are taken one after the other, as opposed to fused ones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence, Set
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.assembly.term import NewState
from dolfinmpm.cut.held import Held
from dolfinmpm.dynamics.faces import Sides
from dolfinmpm.dynamics.ledger import Work
from dolfinmpm.dynamics.settings import Settings
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.solve.advance import advance
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.step import Step

__all__ = ["ExplicitBase"]

Array = npt.NDArray[np.float64]


class ExplicitBase(ABC):
    """Explicit steps of a problem, one after the other.

    Args:
        problem: The problem.
        held: Its essential conditions.
        updates: Fields of the points that a step sets to UFL expressions.
        settings: How steps are taken.
        sides: Faces of the grid that act on the body.
        instead: Why these steps are taken and not fused ones.

    Attributes:
        at_once: Steps that one call may take.
        instead: The argument.
        keeps_speed: Whether the critical step follows from the points' fields alone; other than
            fused steps find it in every call.
    """

    at_once, keeps_speed = 1, False

    def __init__(
        self,
        problem: Any,
        held: Held,
        updates: Sequence,
        settings: Settings,
        sides: Sides,
        instead: str,
    ):
        self._problem, self._held, self._updates = problem, held, updates
        self._settings, self._sides, self.instead = settings, sides, instead
        self._work = Work()

    def work(self) -> Work:
        """Works and losses since last asked."""
        done, self._work = self._work, Work()
        return done

    def renew(self) -> None:  # noqa: B027 - nothing is to be done
        """Begin the next call as the first one; nothing is kept from step to step."""

    def start(self, rate: float, touched: Set[str]) -> None:  # noqa: B027 - nothing is to be done
        """Begin a call; the points are taken as they are in every step."""

    def release(self) -> None:  # noqa: B027 - nothing is to be done
        """End a call; no arrays of the points are kept."""

    def run(
        self, count: int, dt: float, kick: float, more: bool, begin: Callable[[int], Step]
    ) -> tuple[int, int, str | None]:
        """Take equal steps. Collective.

        Args:
            count: How many.
            dt: Their length (s).
            kick: For how long forces act in the first of them (s), see `Explicit`.
            more: Whether others follow without a new start.
            begin: Gives form and conditions the time of a step by its number, and the step.

        Returns:
            Steps taken, points that changed rank, and why it ended before the last, or None.
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
        """One step; how many points changed rank, or why there is no state. Collective.

        Args:
            step: The step.
            kick: For how long forces act in it (s).
        """

    def _advanced(self, operator: Operator, moves: bool, x: Array | None = None) -> NewState | str:
        """The state with the increments at the points, or why there is none; see `advance`."""
        points = self._problem.points
        number = len(self._problem.history) + 1
        return advance(operator, self._updates, moves, largest_cell(points.grid), number, x)
