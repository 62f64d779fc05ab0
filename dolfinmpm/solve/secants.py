"""Length of Newton steps by secants, for contact that opens and closes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.solve.operator import Residual

__all__ = ["Secants"]

Array = npt.NDArray[np.float64]

# Share of the residual's component along the step that may remain, and most trials to reach it
_LEFT, _MOST = 0.5, 5
# Longest and shortest step in these trials, as shares of Newton's step
_FURTHEST, _NEAREST = 2.0, 0.1
# Most halvings of a step at whose end a law has no stress
_HALVINGS = 9
# Factor, and most uses of it, to shorten a step along which the residual grows at first
_SHORTER, _SHORTENINGS = 0.4, 3
# A step of less than this share is useless; this number of useless steps in a row is a failure
_USELESS, _ENOUGH = 0.05, 2


class TrialState(NamedTuple):
    """A trial state along a step.

    Attributes:
        share: Share of the step.
        found: The residual in this state.
        along: Component of the residual along the step (J).
    """

    share: float
    found: Residual
    along: float


class Secants:
    """Search of the share of a step at which the residual has no component along the step.

    The whole step is taken if it leaves at most half of the component. So Newton's method keeps its
    convergence. Else secants look for a component of zero (Matthies & Strang 1979, doi
    10.1002/nme.1620141104, with the Illinois variant of the false position, Dowell & Jarratt 1971,
    doi 10.1007/BF01934364). With an indefinite tangent the component may grow along the step. Then
    the norm of the residual is reduced instead.

    Args:
        comm: Communicator of the problem.
        residual: The residual as a function of the owned unknowns. Collective.
        displacements: 1 for owned unknowns that are displacements, 0 for others, such as pressures;
            None if all are. The component is the work of the displacements alone. It may grow along
            the step as long as the pressures do not fulfil their equations. Then the whole step is
            taken.
        nearest: Shortest step in the trials, as a share of Newton's step.

    Attributes:
        useless: Number of useless steps in a row.
        whole: Whether the last step was a whole one.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        residual: Callable[[Array], Residual],
        displacements: Array | None = None,
        nearest: float = _NEAREST,
    ):
        self._comm, self._residual, self._displacements = comm, residual, displacements
        self._nearest = nearest
        self.useless, self.whole = 0, True

    @property
    def stuck(self) -> bool:
        """Whether the last steps were useless."""
        return self.useless >= _ENOUGH

    def find(self, x: Array, step: Array, now: Residual) -> tuple[float, Residual]:
        """Share of a step to take, and the residual there, evaluated last. Collective.

        Args:
            x: Owned unknowns, shape (owned,).
            step: Newton's step from x, shape (owned,).
            now: The residual at x.
        """
        trials: list[TrialState] = []

        def at(share: float) -> TrialState:
            found = self._residual(x + share * step)
            trials.append(TrialState(share, found, self._along(step, found)))
            return trials[-1]

        start, end = TrialState(0.0, now, self._along(step, now)), at(1.0)
        for _ in range(_HALVINGS):
            if math.isfinite(end.found.norm):
                break
            end = at(0.5 * end.share)
        mixed, grows, best = self._displacements is not None, start.along > 0.0, end
        if math.isfinite(end.found.norm) and not (mixed and grows):
            best = _shorten(at, start, end) if grows else self._false_position(at, start, end)
        grows = grows and not mixed
        self.useless = self.useless + 1 if grows or best.share < _USELESS else 0
        self.whole = best.share == 1.0
        if best is not trials[-1]:
            best = at(best.share)
        return best.share, best.found

    def _false_position(
        self, at: Callable[[float], TrialState], start: TrialState, end: TrialState
    ) -> TrialState:
        """The trial state with a small enough component, or the last trial state. Collective."""
        enough, nearest = _LEFT * abs(start.along), self._nearest * end.share
        other, along = start, start.along
        for _ in range(_MOST):
            if abs(end.along) <= enough or end.along == along:
                break
            share = end.share - end.along * (end.share - other.share) / (end.along - along)
            share = min(max(share, nearest), _FURTHEST)
            if share == end.share:
                # the shortest or longest step has been tried already
                break
            there = at(share)
            if not math.isfinite(there.found.norm):
                break
            if there.along * end.along < 0.0:
                other, along = end, end.along
            else:
                along *= 0.5
            end = there
        return end

    def _along(self, step: Array, found: Residual) -> float:
        moved = step if self._displacements is None else self._displacements * step
        return self._comm.allreduce(float(moved @ found.values), op=MPI.SUM)


def _shorten(at: Callable[[float], TrialState], start: TrialState, end: TrialState) -> TrialState:
    """The trial state with the smallest norm, on shorter and shorter steps. Collective."""
    best = end
    for k in range(_SHORTENINGS):
        if best.found.norm < start.found.norm:
            break
        there = at(_SHORTER ** (k + 1) * end.share)
        if there.found.norm < best.found.norm:
            best = there
    return best
