"""Incomplete factors, or what else solves: by what each has cost so far."""

from __future__ import annotations

import math

__all__ = ["SolverChoice"]

# Up to so many iterations per solution nothing else is tried
_FEW = 50
# Attachments of a matrix until the one that lost is tried again, at first and at most
_FIRST, _MOST = 8, 128


class SolverChoice:
    """Whether incomplete factors precondition, or a problem's other method solves.

    Incomplete factors cost next to nothing where inertia or a short way to the supports leaves a
    handful of iterations, and too many of those elsewhere. They come first. Where iterations are
    many the other method has a turn, and from then on the one that cost less a solution, its
    set-up included, is taken; the other one has another turn from time to time. What fails has
    lost, for longer each time.

    Attributes:
        incomplete: Whether incomplete factors are to precondition now.
    """

    def __init__(self) -> None:
        self.incomplete = True
        # ns per solution, see `dolfinmpm.solve.costs`, of incomplete factors and of the other
        # method
        self._cost = {True: math.nan, False: math.nan}
        # attachments until the other one has a turn, and the next time
        self._wait, self._next = 0, _FIRST

    def weigh(self, cost: float, iterations: float) -> None:
        """Take what solutions with the present one cost, and decide on the next ones.

        Args:
            cost: Their mean cost with all set-ups, the same on all ranks.
            iterations: Their mean number of iterations.
        """
        present = self.incomplete
        self._cost[present] = cost
        if present and iterations <= _FEW:
            return
        mine, other = self._cost[present], self._cost[not present]
        self._wait = max(self._wait - 1, 0)
        if mine > other:
            self.incomplete = not present
            self._wait, self._next = self._next, min(2 * self._next, _MOST)
        elif self._wait == 0:
            self.incomplete = not present
            # whatever it cost once, it is to cost less now
            self._cost[not present] = math.nan
            self._wait = self._next

    def failed(self) -> None:
        """Take that incomplete factors found no solution."""
        self.incomplete, self._cost[True] = False, math.inf
        self._wait, self._next = self._next, min(2 * self._next, _MOST)
