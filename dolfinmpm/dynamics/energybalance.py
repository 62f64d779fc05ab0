"""Check of the energy balance of explicit steps, to find instability."""

from __future__ import annotations

import math

from dolfinmpm.dynamics.ledger import Ledger

__all__ = ["EnergyBalance"]


class EnergyBalance:
    """Energy balance of explicit steps.

    Args:
        ledger: The energies of the problem.

    Attributes:
        ledger: The argument.
    """

    def __init__(self, ledger: Ledger):
        self.ledger = ledger
        self._first: float | None = None
        self._last = self._most = 0.0

    def fault(self, begins: bool = False) -> str | None:
        """Message about energy gained without a cause, or None. Collective.

        A stable run may lose energy to the grid, and may gain a little in "usf". The gain is
        compared with the first energy and with the largest work of loads so far. A gain of more
        than half of the larger one shows that the step is too long.

        Args:
            begins: Whether a call of `step` begins. The user may have changed energy of the points
                before the call. This change is no fault.
        """
        ledger, work = self.ledger, self.ledger.work
        total = ledger.moving() + work.internal - work.external
        if self._first is None:
            self._first = self._last = total
            # of a body under stress: its work in an increment is that of a large stress
            stored = ledger.energies().strain
            self._most = abs(stored) if math.isfinite(stored) else 0.0
        if begins:
            self._first += total - self._last
        self._last = total
        self._most = max(self._most, abs(self._first), abs(work.external))
        gained = total - self._first
        if math.isfinite(total) and not gained > 0.5 * self._most > 0.0:
            return None
        return (
            f"{gained:.4g} J have come from nowhere beside {self._most:.4g} J of first energy "
            "and work of loads"
        )

    def forget(self) -> None:
        """Discard the history: the next state is the new first state."""
        self._first, self._last, self._most = None, 0.0, 0.0
