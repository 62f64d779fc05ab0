"""Terms of implicit steps in time outside the weak form: inertia, penalties, dashpots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from dolfinmpm.assembly.stencilsums import add_product
from dolfinmpm.assembly.term import ActiveTerm
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.dynamics.nodalmass import Mass

__all__ = ["Dashpots", "Inertia"]

Array = npt.NDArray[np.float64]


class Inertia(ActiveTerm):
    """Inertial forces M a, and penalties on the change of velocity in a step.

    Accelerations are a linear function of the increments, a = factor u + known. Penalties act on
    u − expected, the increments beyond those by the velocities at the start.

    Args:
        here: The activation.
        masses: Number of a field that moves points → its mass.
        factor: Derivative of the accelerations by the increments (1/s²).
        known: Number of the field → other part of the accelerations (m/s²), shape (nodes, d).
        expected: Number of the field → increments without penalty (m), shape (nodes, d).
    """

    kind, is_load = "inertia", False

    def __init__(
        self,
        here: Activation,
        masses: Mapping[int, Mass],
        factor: float,
        known: Mapping[int, Array],
        expected: Mapping[int, Array],
    ):
        self._known, self._expected = known, expected
        self._masses = [b for mass in masses.values() for b in mass.blocks]
        self._changes = here.blocks_of("changes")
        inertial = [replace(b, values=factor * b.values) for b in self._masses]
        self.stiffness = [*self._changes, *inertial]

    def external(self, out: Sequence[Array]) -> None:
        """See `ActiveTerm`. M times the known accelerations acts like a load."""
        for b in self._masses:
            add_product(b, self._on_all(self._known, out), out)
        for b in self._changes:
            add_product(replace(b, values=-b.values), self._on_all(self._expected, out), out)

    @staticmethod
    def _on_all(given: Mapping[int, Array], out: Sequence[Array]) -> list[Array]:
        """Nodal values of all fields, with zeros for fields without values."""
        return [given.get(k, np.zeros_like(force)) for k, force in enumerate(out)]


class Dashpots(ActiveTerm):
    """Dashpots on the nodes of the first field.

    Args:
        blocks: Derivative of the forces by the increments.
        start: Part of the forces without the increments (N), shape (nodes, d).
        owned: Nodes of this rank.
    """

    kind, is_load = "inertia", False

    def __init__(self, blocks: Blocks, start: Array, owned: npt.NDArray[np.int32]):
        self.stiffness, self._start, self._owned = [blocks], start, owned

    def external(self, out: Sequence[Array]) -> None:
        """See `ActiveTerm`."""
        out[0][self._owned] += self._start[self._owned]
