"""First guess of the increments of bodies that a tool moves: those of the last step."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.grid.partition import Partition
from dolfinmpm.solve.operator import Operator

__all__ = ["Guess"]

Array = npt.NDArray[np.float64]


class Guess:
    """Increments that were found last, as a first guess of those that are looked for next.

    What flows past a tool flows much alike from step to step, and the grid is reset, or goes with
    the tool: the nodes' last increments touch the tool where it is by then, and find the points
    that yield yielding, where a step from rest first finds all of them elastic. Nodes that were not
    active are at rest.

    Attributes:
        length: Length of the step that is taken, as its time or load measures it.
    """

    def __init__(self) -> None:
        self.length = 1.0
        # each field's owned nodes, and what they did in a step of the length 1
        self._parts: list[tuple[npt.NDArray[np.int32], Array]] = []
        # which rank owns the nodes
        self._partition: Partition | None = None

    def keep(self, operator: Operator) -> None:
        """Take the increments that an operator has been moved to."""
        here = operator.here
        self._parts, self._partition = [], operator.form.points.partition
        for field, own, u, scale in zip(
            here.fields, here.unknowns.fields, operator.increments, self._scales(operator)
        ):
            nodes, values = own.nodes, u
            if field.C is not None:
                # nodes that are tied now may be free next
                nodes, values = field.active, np.asarray(field.C @ u)
            nodes = nodes[: np.searchsorted(nodes, own.numbering.owned)]
            self._parts.append((nodes, np.asarray(values[nodes] / scale, np.float64)))

    def on(self, operator: Operator) -> Array | None:
        """The guess, or None if there is nothing to guess from. Collective.

        Returns:
            The owned unknowns, shape (owned,).
        """
        if not self._parts or self._partition is not operator.form.points.partition:
            return None
        nodal = operator.here.unknowns.nodal()
        for u, (nodes, values), scale in zip(nodal.arrays, self._parts, self._scales(operator)):
            u[nodes] = values * scale
        return operator.here.unknowns.restrict(nodal.arrays)

    def _scales(self, operator: Operator) -> list[float]:
        """By what increments of each field grow with the step; what the form carries are none."""
        return [self.length if name is None else 1.0 for name in operator.form.values]

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """What it keeps on this rank."""
        kept: dict[str, npt.NDArray[Any]] = {}
        for k, (nodes, values) in enumerate(self._parts):
            kept |= {f"guess {k} nodes": nodes, f"guess {k}": values}
        return kept

    def set_state(self, local: dict[str, npt.NDArray[Any]], partition: Partition | None) -> None:
        """Take what `state` returned, or nothing.

        Args:
            local: Arrays of this rank.
            partition: Which rank owns the nodes, as the points have it.
        """
        self._parts, self._partition = [], partition
        for k in range(sum(name.endswith(" nodes") for name in local if name.startswith("guess"))):
            self._parts.append((local[f"guess {k} nodes"], local[f"guess {k}"]))
