"""Data that explicit steps keep from call to call, with a copy of the last good state."""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.rigidbodies import RigidBodies
from dolfinmpm.dynamics.ledger import Work

__all__ = ["CallMemory", "Snapshot"]

# Fields that no step changes
_FIXED = frozenset(("id", "tag", "x0", "V0", "l0", "density"))


class Snapshot:
    """A copy of the state of points and bodies. The next copy uses the same memory.

    Args:
        points: Material points.
        bodies: Rigid bodies.
        markers: Markers of boundaries that do not fit the grid.

    Attributes:
        time: Time of the copy (s).
    """

    def __init__(
        self, points: MaterialPoints, bodies: RigidBodies, markers: Sequence[MaterialPoints] = ()
    ):
        self.time = math.nan
        self._bodies, self._of_bodies = bodies, bodies.state()
        self._sets, self._work = [points, *markers], Work().values()
        self._revision = -1
        self._fields: list[dict[str, npt.NDArray]] = [{} for _ in self._sets]

    def take(self, time: float, work: Work, touched: Set[str]) -> None:
        """Copy the present state.

        Args:
            time: Time of the state (s).
            work: Works until this time.
            touched: Fields of the points that the user may have changed since the last copy.
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

    def restore(self, work: Work) -> None:
        """Restore the state and the works. Points go back to their ranks. Collective."""
        self._bodies.set_state(self._of_bodies)
        work.take(self._work)
        for points, fields in zip(self._sets, self._fields):
            for name, values in fields.items():
                points.fields[name] = values.copy()
            points.recount()
            points.locate()


@dataclass
class CallMemory:
    """Data that explicit steps keep from call to call.

    Attributes:
        state: Copy of the state to which a failed run goes back.
        moment: End of the last call, to find fields changed later; see `FieldArrays`. None if all
            fields count as changed.
        critical: The last critical step (s).
        steps_since: Number of steps since the critical step was found.
        single: Whether the last call took one step. Calls with one step share a critical step. A
            call with several steps finds its own.
    """

    state: Snapshot
    moment: int | None = None
    critical: float = math.nan
    steps_since: int = 0
    single: bool = False

    def touched(self, points: MaterialPoints) -> Set[str]:
        """Fields that may have been changed since the last call, on any rank. Collective."""
        fields, comm = points.fields, points.comm
        touched, self.moment = fields.touched(self.moment), None
        if comm.size == 1:
            return touched
        names = sorted(fields)
        flags = np.array([name in touched for name in names], np.uint8)
        comm.Allreduce(MPI.IN_PLACE, flags, op=MPI.MAX)
        return {name for name, flag in zip(names, flags) if flag}
