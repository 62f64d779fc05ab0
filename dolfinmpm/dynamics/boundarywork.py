"""Work of terms over boundaries that do not fit the grid, in steps in time.

These forces depend on the increments: pressures that follow a boundary, Nitsche's terms, penalties
of prescribed displacements, walls. Their work in a step is that of the mean of the forces at its
start and end. Walls (`signorini`) do not move: their work is energy that their penalties store, or
friction. So it is left out here, see `Wall.energy`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.assembly.term import NewState
from dolfinmpm.solve.operator import Operator
from dolfinmpm.terms.boundaryterm import ActiveBoundaryTerm

__all__ = ["boundary_forces", "fields_at_level", "works_of_boundaries"]

Array = npt.NDArray[np.float64]


def boundary_forces(operator: Operator) -> list[Array] | None:
    """Internal forces of boundaries at the present increments and loads. Collective.

    Returns:
        Shape (nodes, components) per field (N), or None without boundaries.
    """
    if not operator.has("boundary"):
        return None
    return list(operator.forces_of("boundary", renewed=True))


def fields_at_level(operator: Operator) -> list[dict[str, Array]]:
    """Fields that conditions set at the markers of each boundary, for the present increments."""
    found = []
    for of in operator.form.boundaries:
        active = operator.active(of)
        assert isinstance(active, ActiveBoundaryTerm)
        found.append(active.new_fields())
    return found


def works_of_boundaries(
    operator: Operator,
    start: Sequence[Array] | None,
    state: NewState,
    level: Sequence[dict[str, Array]] | None = None,
) -> tuple[float, float, float]:
    """Works of boundaries in a step (J). Collective.

    Args:
        operator: The step's equations, at the increments, with the loads at its end.
        start: Internal forces of boundaries at the start of the step (N), shape (nodes, components)
            per field, or None without boundaries.
        state: The new state.
        level: Result of `fields_at_level` if forces balance within the step. Then the work of walls
            is that of their forces at this time.

    Returns:
        Work of all boundaries except walls, work of the forces at the end of the step, and work of
        the walls.
    """
    end = boundary_forces(operator)
    if start is None or end is None:
        return 0.0, 0.0, 0.0
    here, u, works = operator.here, operator.increments, np.zeros(3)
    for k in here.movers:
        at = here.unknowns.fields[k].owned_nodes
        for i, force in enumerate((0.5 * (start[k] + end[k]), end[k])):
            works[i] -= np.sum((force * u[k])[at])
    for k, of in enumerate(operator.form.boundaries):
        fields, moved = state.of(of.markers), state.moved[of.markers.number]
        for condition in of.conditions:
            own = condition.own_work(fields, moved)
            works[0] -= own
            works[2] += own if level is None else condition.own_work(fields, moved, level[k])
    here.unknowns.comm.Allreduce(MPI.IN_PLACE, works, op=MPI.SUM)
    return float(works[0]), float(works[1]), float(works[2])
