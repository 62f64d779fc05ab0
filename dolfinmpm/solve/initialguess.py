"""First guess of the increments: those of the last step."""

from __future__ import annotations

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
# Most steps without a trial, after guesses were of no use
_MOST_WAIT = 16


class InitialGuess:
    """The increments of the last step, as a first guess of the next increments.

    Where loads grow evenly, increments hardly change from step to step, and one or two iterations
    of Newton's method are saved. A guess that leaves more than a tenth of the forces out of balance
    is not taken. The next guess is then tried after some steps, twice as many each time.

    Material flows past a rigid body in much the same way from step to step. With the last
    increments, the points touch the body at its new place, and points that yield are found to
    yield. From zero increments, all points are elastic at first. So with contact each guess is
    tried, and taken if it is nearer to balance than zero increments. That needs the secants that
    find the length of a step under contact. Without them, as with pressures among the unknowns, no
    guess is tried beside rigid bodies.

    The guess is zero at nodes that were not active.

    Attributes:
        length: Length of the present step, in time or load.
    """

    def __init__(self) -> None:
        self.length = 1.0
        # steps before the next trial, and after the next guess without use
        self._wait, self._next = 0, 1
        # iterations of the last solution from zero increments
        self._plain = 2
        # per field: owned nodes, and their increments in a step of length 1
        self._parts: list[tuple[npt.NDArray[np.int32], Array]] = []
        # per field: the basis of a refined field, whose nodes change with its leaves
        self._leaves: list[LeafBasis | None] = []
        # ranks of the nodes
        self._partition: Partition | None = None

    def count(self, iterations: int) -> None:
        """Take into account the iterations from zero increments. A single one is not saved."""
        self._plain = iterations

    @staticmethod
    def share(contact: bool) -> float:
        """Largest share of the forces at zero increments that a useful guess leaves."""
        return 1.0 if contact else _USEFUL

    def tried(self, contact: bool) -> bool:
        """Whether a guess is tried in this solution."""
        self._wait = max(self._wait - 1, 0)
        return contact or (self._wait == 0 and self._plain > 1)

    def judge(self, useful: bool) -> None:
        """Take into account whether a guess was of use."""
        if useful:
            self._wait, self._next = 0, 1
        else:
            self._wait, self._next = self._next + 1, min(2 * self._next, _MOST_WAIT)

    def keep(self, operator: Operator) -> None:
        """Keep the present increments of an operator."""
        here = operator.here
        self._parts, self._partition = [], operator.form.points.partition
        self._leaves = []
        for field, own, u, scale in zip(
            here.fields, here.unknowns.fields, operator.increments, self._scales(operator)
        ):
            nodes, values = own.nodes, u
            if field.C is not None:
                # nodes that are constrained now may be free in the next step
                nodes, values = field.active, np.asarray(field.C @ u)
            leaves = field.basis if isinstance(field.basis, LeafBasis) else None
            self._leaves.append(leaves)
            if leaves is None:
                nodes = nodes[: np.searchsorted(nodes, own.numbering.owned)]
            self._parts.append((nodes, np.asarray(values[nodes] / scale, np.float64)))

    def on(self, operator: Operator) -> Array | None:
        """The guess, or None if no increments are known, or all are zero. Collective.

        Returns:
            The owned unknowns, shape (owned,).
        """
        if not self._parts or self._partition is not operator.form.points.partition:
            return None
        nodal = operator.here.unknowns.nodal()
        scales = self._scales(operator)
        for k, u in enumerate(nodal.arrays):
            nodes, values = self._parts[k]
            old, basis = self._leaves[k], operator.here.fields[k].basis
            if old is not None and basis is not old:
                assert isinstance(basis, LeafBasis)
                whole = np.zeros((old.nodes.size, u.shape[1]))
                whole[nodes] = values
                nodes, values = _between_leaves(old, whole, basis)
            u[nodes] = values * scales[k]
        found = operator.here.unknowns.restrict(nodal.arrays)
        moved = operator.here.unknowns.comm.allreduce(bool(found.any()), op=MPI.LOR)
        return found if moved else None

    def _scales(self, operator: Operator) -> list[float]:
        """Factor of each field's increments: the step's length, or 1 for carried values."""
        return [self.length if name is None else 1.0 for name in operator.form.values]

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The kept increments of this rank, and what decides about the next trial, by name."""
        kept: dict[str, npt.NDArray[Any]] = {
            "guess trials": np.array([self._wait, self._next, self._plain])
        }
        if any(leaves is not None for leaves in self._leaves):
            return kept
        for k, (nodes, values) in enumerate(self._parts):
            kept |= {f"guess {k} nodes": nodes, f"guess {k}": values}
        return kept

    def set_state(self, local: dict[str, npt.NDArray[Any]], partition: Partition | None) -> None:
        """Restore a state returned by `state`, also an empty one.

        Args:
            local: Arrays of this rank.
            partition: Partition of the points, which says the ranks of the nodes.
        """
        self._parts, self._partition, self._leaves = [], partition, []
        trials = local.get("guess trials", (0, 1, 2))
        self._wait, self._next, self._plain = (int(n) for n in trials)
        for k in range(sum(name.endswith(" nodes") for name in local if name.startswith("guess"))):
            self._parts.append((local[f"guess {k} nodes"], local[f"guess {k}"]))
            self._leaves.append(None)


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
