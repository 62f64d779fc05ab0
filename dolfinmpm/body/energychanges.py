"""Energies that points gain and lose between steps, where they come, go, split or merge."""

from __future__ import annotations

import contextlib
import weakref
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["EnergyChanges", "counted"]

Array = npt.NDArray[np.float64]


class EnergyChanges:
    """Changes of the energies of points between steps, which an account of energies asks for.

    Ranks count on their own, because an account may have ended on some of them only.

    Args:
        points: Material points.
        energies: Function that returns kinetic energy, elastic energy and the energy of contact of
            this rank (J), shape (3,).
    """

    def __init__(self, points: MaterialPoints, energies: Callable[[], Array]):
        self._comm, self._energies = points.comm, energies
        self._sums: Array = np.zeros((2, 4))
        points.__dict__.setdefault("_energy_changes", []).append(weakref.ref(self))

    def found(self) -> bool:
        """Whether a rank has changes that have not been taken. Collective."""
        return self._comm.allreduce(bool(self._sums.any()), op=MPI.LOR)

    def taken(self) -> Array:
        """Changes since the last call, on all ranks (J), shape (2, 4). Collective.

        The first row is of points that came and went, the second of points that split and merged.
        The last column has the number of changes.
        """
        sums, self._sums = self._sums, np.zeros((2, 4))
        return self._comm.allreduce(sums, op=MPI.SUM)

    def since(self, before: Array | None, merging: bool) -> Array:
        """The energies of this rank, whose change is kept if former energies are given."""
        now = self._energies()
        if before is not None:
            # the elastic energy is no number where a law has none
            self._sums[int(merging)] += [*np.nan_to_num(now - before), 1.0]
        return now


@contextlib.contextmanager
def counted(points: MaterialPoints, *, merging: bool = False) -> Iterator[None]:
    """Tell the accounts of the points' energies what changes within.

    Args:
        points: Material points.
        merging: Whether points split or merge; otherwise points come or go.
    """
    kept = points.__dict__.setdefault("_energy_changes", [])
    accounts = [account for reference in kept if (account := reference()) is not None]
    kept[:] = [weakref.ref(account) for account in accounts]
    before = [account.since(None, merging) for account in accounts]
    yield
    for account, energies in zip(accounts, before):
        account.since(energies, merging)
