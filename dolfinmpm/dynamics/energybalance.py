"""Whether more energy comes in explicit steps than is brought."""

from __future__ import annotations

import math

from dolfinmpm.dynamics.ledger import Ledger

__all__ = ["EnergyBalance"]


class EnergyBalance:
    """What energy there was and is in explicit steps.

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
        """What is wrong if energy comes from nowhere, or None. Collective.

        What moves may lose energy to the grid and gain a little in "usf"; more than half of all
        that there ever was in any form comes from a step that is too long.

        Args:
            begins: Whether a call of `step` begins: what the user gave the points before it
                does not come from nowhere.
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
        """Begin anew from the next state, as the first one."""
        self._first, self._last, self._most = None, 0.0, 0.0
