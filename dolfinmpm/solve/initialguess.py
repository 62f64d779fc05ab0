"""First guess of the increments, from those of the last steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.basis import LeafBasis
from dolfinmpm.grid.partition import Partition
from dolfinmpm.solve.operator import Operator

__all__ = ["InitialGuess"]

Array = npt.NDArray[np.float64]


# A first guess must reduce the forces out of balance to this share of those at zero increments
_USEFUL = 0.1
# The last change of the increments is added again if it would have left at most this share of the
# difference between the increments of two steps
_NEARER = 0.5
# Most steps without a trial, after guesses were of no use
_MOST_WAIT = 16


@dataclass(frozen=True)
class _Kept:
    """Increments of a field in a step, on this rank.

    Attributes:
        nodes: Owned nodes, sorted.
        values: Increments in a step of length 1, or per step where values are carried, shape
            (nodes, components).
        leaves: The basis of a refined field, whose nodes change with its leaves; else None.
    """

    nodes: npt.NDArray[np.int32]
    values: Array
    leaves: LeafBasis | None = None


class InitialGuess:
    """The increments of the last steps, as a first guess of the next increments.

    Where loads grow evenly, increments hardly change from step to step, and one or two iterations
    of Newton's method are saved. A guess that leaves more than a tenth of the forces out of balance
    is not taken. The next guess is then tried after some steps, twice as many each time.

    The change from the last step but one to the last step goes on if this would have been a good
    guess of the last step: if it had left less than half of its change. Else the guess is the
    increments of the last step.

    Material flows past a rigid body in much the same way from step to step. With the last
    increments, the points touch the body at its new place, and points that yield are found to
    yield. From zero increments, all points are elastic at first. So with contact each guess is
    tried, and taken if it is nearer to balance than zero increments.

    The guess is zero at nodes that were not active.

    Attributes:
        length: Length of the present step, in time or load.
    """

    def __init__(self) -> None:
        self.length = 1.0
        # steps before the next trial, and after the next guess without use
        self._wait, self._next = 0, 1
        # iterations of the last solution from zero increments; a guess does not save a single one
        self.plain = 2
        # per field, in the last step and in the step before, and the lengths of these steps
        self._last: list[_Kept] = []
        self._former: list[_Kept] = []
        self._lengths = 1.0, 1.0
        # per field: whether changes go on
        self._goes_on: list[bool] = []
        # ranks of the nodes
        self._partition: Partition | None = None

    @staticmethod
    def allowed_share(contact: bool) -> float:
        """Largest share of the forces at zero increments that a useful guess leaves."""
        return 1.0 if contact else _USEFUL

    def tried(self, contact: bool) -> bool:
        """Whether a guess is tried in this solution."""
        self._wait = max(self._wait - 1, 0)
        return contact or (self._wait == 0 and self.plain > 1)

    def record_use(self, useful: bool) -> None:
        """Take into account whether a guess was of use."""
        if useful:
            self._wait, self._next = 0, 1
        else:
            self._wait, self._next = self._next + 1, min(2 * self._next, _MOST_WAIT)

    def keep(self, operator: Operator) -> None:
        """Keep the present increments of an operator. Collective."""
        here, kept, partition = operator.here, [], operator.form.points.partition
        for field, own, u, factor in zip(
            here.fields, here.unknowns.fields, operator.increments, self._length_factors(operator)
        ):
            nodes, values = own.nodes, u
            if field.C is not None:
                # nodes that are constrained now may be free in the next step
                nodes, values = field.active, np.asarray(field.C @ u)
            leaves = field.basis if isinstance(field.basis, LeafBasis) else None
            if leaves is None:
                nodes = nodes[: np.searchsorted(nodes, own.numbering.owned)]
            values = np.asarray(values[nodes] / factor, np.float64)
            kept.append(_Kept(nodes, values, leaves))
        if self._partition is not partition:
            self._last, self._former, self._partition = [], [], partition
        rates = [name is None for name in operator.form.values]
        # it is of no use where the next step will not try a guess
        soon = self._wait <= 1
        self._goes_on = self._trends(kept, rates, here.unknowns.comm) if soon else []
        self._former, self._last = self._last, kept
        self._lengths = self.length, self._lengths[0]

    def _trends(self, kept: list[_Kept], rates: Sequence[bool], comm: MPI.Intracomm) -> list[bool]:
        """Whether the increments are nearer to changes that go on, per field. Collective.

        Args:
            kept: The present increments.
            rates: Whether the kept ones are those in a step of length 1, per field.
            comm: Communicator of the unknowns.
        """
        sums = np.zeros((len(kept), 2))
        for k, (now, last, ahead) in enumerate(zip(kept, self._last, self._ahead(rates))):
            if now.leaves is last.leaves and ahead is not None:
                own, others = _common(now.nodes, last.nodes)
                for j, values in enumerate((last.values + ahead, last.values)):
                    sums[k, j] = np.sum((now.values[own] - values[others]) ** 2)
        on, same = comm.allreduce(sums, op=MPI.SUM).T
        return [bool(good) for good in on < _NEARER**2 * same]

    def _ahead(self, rates: Sequence[bool]) -> list[Array | None]:
        """Changes of the kept increments from the last step to a step of the present length.

        The rate of a step is that in its middle; values that are carried change with its length.

        Args:
            rates: See `_trends`.
        """
        last, former = self._lengths
        found: list[Array | None] = []
        for k, rate in enumerate(rates):
            found.append(None)
            if k >= len(self._former) or self._former[k].leaves is not self._last[k].leaves:
                continue
            apart = (self.length + last) / (last + former) if rate else self.length / last
            one, two = self._last[k], self._former[k]
            own, others = _common(one.nodes, two.nodes)
            change = np.zeros_like(one.values)
            change[own] = apart * (one.values[own] - two.values[others])
            found[k] = change
        return found

    def on(self, operator: Operator) -> Array | None:
        """The guess, or None if no increments are known, or all are zero. Collective.

        Returns:
            The owned unknowns, shape (owned,).
        """
        if not self._last or self._partition is not operator.form.points.partition:
            return None
        nodal = operator.here.unknowns.nodal()
        factors = self._length_factors(operator)
        ahead: list[Array | None] = [None] * len(self._last)
        if any(self._goes_on):
            ahead = self._ahead([name is None for name in operator.form.values])
        for k, u in enumerate(nodal.arrays):
            nodes, values, old = self._last[k].nodes, self._last[k].values, self._last[k].leaves
            change = ahead[k]
            if change is not None and self._goes_on[k]:
                values = values + change
            basis = operator.here.fields[k].basis
            if old is not None and basis is not old:
                assert isinstance(basis, LeafBasis)
                whole = np.zeros((old.nodes.size, u.shape[1]))
                whole[nodes] = values
                nodes, values = _between_leaves(old, whole, basis)
            # a checkpoint may be of another basis
            known = nodes < len(u)
            u[nodes[known]] = values[known] * factors[k]
        found = operator.here.unknowns.restrict(nodal.arrays)
        moved = operator.here.unknowns.comm.allreduce(bool(found.any()), op=MPI.LOR)
        return found if moved else None

    def _length_factors(self, operator: Operator) -> list[float]:
        """Factor of each field's increments: the step's length, or 1 for carried values."""
        return [self.length if name is None else 1.0 for name in operator.form.values]

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The kept increments of this rank, and what decides about the next trial, by name.

        Those of refined fields are left out: leaves of the last step may be others than the next.
        """
        kept: dict[str, npt.NDArray[Any]] = {
            "guess trials": np.array([self._wait, self._next, self.plain])
        }
        if self._last and all(part.leaves is not None for part in self._last):
            return kept
        kept |= {"guess lengths": np.array(self._lengths), "guess ahead": np.array(self._goes_on)}
        for when, parts in ("last", self._last), ("former", self._former):
            for k, part in enumerate(parts):
                # without nodes the guess of a field is zero
                known = slice(None) if part.leaves is None else slice(0)
                nodes, values = part.nodes[known], part.values[known]
                kept |= {f"guess {when} {k} nodes": nodes, f"guess {when} {k}": values}
        return kept

    def set_state(self, local: dict[str, npt.NDArray[Any]], partition: Partition | None) -> None:
        """Restore a state returned by `state`, also an empty one.

        Args:
            local: Arrays of this rank.
            partition: Partition of the points, which says the ranks of the nodes.
        """
        self._partition = partition
        trials = local.get("guess trials", (0, 1, 2))
        self._wait, self._next, self.plain = (int(n) for n in trials)
        last, former = local.get("guess lengths", (1.0, 1.0))
        self._lengths = float(last), float(former)
        self._goes_on = [bool(good) for good in local.get("guess ahead", ())]
        self._last, self._former = (
            [
                _Kept(local[f"guess {when} {k} nodes"], local[f"guess {when} {k}"])
                for k in range(sum(f"guess {when} {n} nodes" in local for n in range(len(local))))
            ]
            for when in ("last", "former")
        )


def _common(
    one: npt.NDArray[np.int32], other: npt.NDArray[np.int32]
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Rows of the nodes that both of two sorted arrays have, in each of them."""
    at = np.searchsorted(other, one)
    own = np.flatnonzero(np.append(other, -1)[at] == one)
    return own, at[own]


def _between_leaves(
    old: LeafBasis, values: Array, basis: LeafBasis
) -> tuple[npt.NDArray[np.int32], Array]:
    """Values of functions on old leaves at the nodes of new leaves, where there were leaves.

    At the Greville points of splines these are the coefficients of nearly the same function.

    Args:
        old: The basis on the old leaves.
        values: Values at its nodes, shape (nodes, components).
        basis: The basis on the new leaves.

    Returns:
        Nodes of the new basis, and values, shape (n, components).
    """
    gdim = basis.grid.geometry.dim
    nodes, N = old.values_at(np.ascontiguousarray(basis.node_coordinates()[:, :gdim]))
    return nodes.astype(np.int32), np.asarray(N @ values)
