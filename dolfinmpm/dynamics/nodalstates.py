"""Nodes at which colliding bodies touch and slip: where an explicit step is not smooth."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import LatticeBasis

__all__ = ["NodalStates"]

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]

# Approach and slip that count as rounding, relative to the fastest node
_ROUNDING = 1e-12


class NodalStates:
    """Nodes at which bodies touch and slip, in each exchange of momentum since `begin`.

    Every exchange has kinks of its own, also one that a later exchange takes back.

    Attributes:
        sets: Sets of nodes, as numbers on the lattice, shape (nodes,) each: for each exchange and
            each pair of bodies those that touch, and those that slip. Each rank has its own nodes.
    """

    def __init__(self) -> None:
        self.sets: list[Numbers] = []
        self._numbers: Numbers = np.empty(0, np.int64)

    def begin(self) -> None:
        """Forget the sets."""
        self.sets = []

    def begin_step(self, basis: LatticeBasis) -> None:
        """Number the nodes of a step.

        Args:
            basis: The basis.
        """
        shape = np.add(basis.lattice.shape, basis.degree)
        ijk = basis.halo.node_ijk.T.astype(np.int64)
        self._numbers = np.asarray(np.ravel_multi_index(tuple(ijk), tuple(shape)), np.int64)
        # nodes of other ranks
        self._numbers[basis.nodes.owned :] = -1

    def add(self, nodes: npt.NDArray[np.intp], approach: Array, slip: Array, speed: float) -> None:
        """Add the states of two bodies in an exchange.

        Args:
            nodes: Nodes that both bodies share, shape (m,).
            approach: Speed that the normal impulse stops (m/s), shape (m,).
            slip: Speed that friction leaves (m/s), shape (m,).
            speed: Largest component of a velocity at the nodes (m/s).
        """
        numbers, least = self._numbers[nodes], _ROUNDING * speed
        touch = (approach > least) & (numbers >= 0)
        self.sets += [np.sort(numbers[at]) for at in (touch, touch & (slip > least))]
