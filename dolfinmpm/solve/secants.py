"""Shares of Newton's steps where contact comes and goes, by secants."""

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

# Share of the residual's component along a step that may be left of it, and how often it is looked
# for where there is less
_LEFT, _MOST = 0.5, 5
# Where that is looked for: up to twice the step, and no nearer than a tenth of it
_FURTHEST, _NEAREST = 2.0, 0.1
# How often a step is halved that ends where some strain has no stress
_HALVINGS = 9
# To what share, and how often, a step is shortened along which the residual grows at first
_SHORTER, _SHORTENINGS = 0.4, 3
# A share that brings nothing on, and how many of these in a row are the end
_NOTHING, _ENOUGH = 0.05, 2


class Place(NamedTuple):
    """A place along a step.

    Attributes:
        share: Share of the step.
        found: The residual there.
        along: Its component along the step (J).
    """

    share: float
    found: Residual
    along: float


class Secants:
    """Looks for the share of a step where the residual has no component along it.

    A step is taken whole where it leaves at most half of the component that there was, so that
    Newton's method converges as it does without; else secants look for where none is left
    (Matthies & Strang 1979, doi 10.1002/nme.1620141104, with the Illinois variant of the false
    position, Dowell & Jarratt 1971, doi 10.1007/BF01934364). Where the component does not fall
    along the step, since the tangent is not definite, the residual's norm counts.

    Args:
        comm: Communicator of the problem.
        residual: The residual as a function of the owned unknowns. Collective.

    Attributes:
        idle: How many steps in a row have brought nothing on.
    """

    def __init__(self, comm: MPI.Intracomm, residual: Callable[[Array], Residual]):
        self._comm, self._residual = comm, residual
        self.idle = 0

    @property
    def stuck(self) -> bool:
        """Whether steps bring nothing on any more."""
        return self.idle >= _ENOUGH

    def find(self, x: Array, step: Array, now: Residual) -> tuple[float, Residual]:
        """Share of a step to be taken, and the residual there, which was found last. Collective.

        Args:
            x: Owned unknowns, shape (owned,).
            step: Newton's step from there, likewise.
            now: The residual there.
        """
        looked: list[Place] = []

        def at(share: float) -> Place:
            found = self._residual(x + share * step)
            looked.append(Place(share, found, self._along(step, found)))
            return looked[-1]

        start, end = Place(0.0, now, self._along(step, now)), at(1.0)
        for _ in range(_HALVINGS):
            if math.isfinite(end.found.norm):
                break
            end = at(0.5 * end.share)
        grows = start.along > 0.0
        best = end
        if math.isfinite(end.found.norm):
            best = (_shorten if grows else _false_position)(at, start, end)
        self.idle = self.idle + 1 if grows or best.share < _NOTHING else 0
        if best is not looked[-1]:
            best = at(best.share)
        return best.share, best.found

    def _along(self, step: Array, found: Residual) -> float:
        return self._comm.allreduce(float(step @ found.values), op=MPI.SUM)


def _false_position(at: Callable[[float], Place], start: Place, end: Place) -> Place:
    """Where the component is small enough, or the last place looked at. Collective."""
    enough, nearest = _LEFT * abs(start.along), _NEAREST * end.share
    other, along = start, start.along
    for _ in range(_MOST):
        if abs(end.along) <= enough or end.along == along:
            break
        share = end.share - end.along * (end.share - other.share) / (end.along - along)
        share = min(max(share, nearest), _FURTHEST)
        if share == end.share:
            # the nearest or the furthest, where it has been looked at
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


def _shorten(at: Callable[[float], Place], start: Place, end: Place) -> Place:
    """The place of the least norm on ever shorter steps, until it has fallen. Collective."""
    best = end
    for k in range(_SHORTENINGS):
        if best.found.norm < start.found.norm:
            break
        there = at(_SHORTER ** (k + 1) * end.share)
        if there.found.norm < best.found.norm:
            best = there
    return best
