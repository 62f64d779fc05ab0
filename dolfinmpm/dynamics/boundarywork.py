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

from dolfinmpm._platform.errors import InstabilityError
from dolfinmpm.assembly.term import NewState
from dolfinmpm.solve.operator import Operator
from dolfinmpm.terms.boundaryterm import ActiveBoundaryTerm

__all__ = ["WallEnergy", "boundary_forces", "fields_at_level", "works_of_boundaries"]

Array = npt.NDArray[np.float64]

# Largest work of walls at rest, as a share of the whole energy
_MOST = 0.1


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


class WallEnergy:
    """Work that walls have done on a body in implicit steps.

    Walls at rest store energy and rub. So this work is negative, or 0 after contact without
    friction. But a penalty that begins or ends to act within a step does the work of the mean of
    its forces, and not of its energy. A stiff wall may so multiply the energy of an impact.

    Attributes:
        done: Sum of the works (J).
    """

    def __init__(self) -> None:
        self.done = 0.0

    def judge(self, work: float, whole: float, dt: float, may_halve: bool) -> str | None:
        """The reason to halve a step, or None. With None the step's work is added.

        Args:
            work: Work of the walls in the step (J).
            whole: First energy plus work of loads (J).
            dt: Length of the step (s).
            may_halve: Whether the step may be halved.

        Raises:
            InstabilityError: The walls have done too much work, and the step may not be halved.
        """
        if work > 0.0 and self.done + work > _MOST * abs(whole) > 0.0:
            reason = (
                f"walls (mpm.signorini) at rest have given {self.done + work:.4g} J to a body with "
                f"{abs(whole):.4g} J of first energy and work of loads, more than the share "
                f"{_MOST:g}"
            )
            if not may_halve:
                raise InstabilityError(
                    f"{reason}, in a step of {dt:.3g} s. The state is that before it. Take "
                    'mass="lumped", or GeneralisedAlpha with rho_inf = 0, or a smaller penalty of '
                    "the wall, or smaller steps"
                )
            return reason
        self.done += work
        return None
