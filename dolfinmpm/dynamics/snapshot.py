"""The last good state of a run, to which one that turns out unstable goes back."""

from __future__ import annotations

import math
from collections.abc import Sequence, Set

import numpy as np
import numpy.typing as npt

from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.bodies import Bodies
from dolfinmpm.dynamics.ledger import Work

__all__ = ["Snapshot"]

# Fields that no step changes
_FIXED = frozenset(("id", "tag", "x0", "V0", "l0", "density"))


class Snapshot:
    """A copy of the points' fields, in memory that is used again for the next one.

    Args:
        points: Material points.
        bodies: Rigid bodies.
        markers: Those of boundaries that do not fit the grid.

    Attributes:
        time: Time that it is of (s).
    """

    def __init__(
        self, points: MaterialPoints, bodies: Bodies, markers: Sequence[MaterialPoints] = ()
    ):
        self.time = math.nan
        self._bodies, self._of_bodies = bodies, bodies.state()
        self._sets, self._work = [points, *markers], Work().values()
        self._revision = -1
        self._fields: list[dict[str, npt.NDArray]] = [{} for _ in self._sets]

    def take(self, time: float, work: Work, touched: Set[str]) -> None:
        """Copy what points and bodies have at a time (s), and the work done until then (J).

        Args:
            touched: Fields of the points that others may have changed since the last copy.
        """
        revision = self._sets[0].revision
        still = _FIXED - touched if revision == self._revision else frozenset()
        self._revision = revision
        self.time, self._of_bodies = time, self._bodies.state()
        self._work = work.values()
        for k, (points, kept) in enumerate(zip(self._sets, self._fields)):
            self._fields[k] = {}
            for name in points.fields:
                values, own = points.fields.read(name), kept.get(name)
                if k == 0 and name in still and own is not None:
                    self._fields[k][name] = own
                    continue
                if own is None or own.shape != values.shape:
                    own = np.empty_like(values)
                np.copyto(own, values)
                self._fields[k][name] = own

    def put(self, work: Work) -> None:
        """Give all back what it had, points on the ranks that had them. Collective."""
        self._bodies.set_state(self._of_bodies)
        work.take(self._work)
        for points, fields in zip(self._sets, self._fields):
            for name, values in fields.items():
                points.fields[name] = values.copy()
            points.recount()
            points.locate()
