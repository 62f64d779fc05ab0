"""Forces and work of terms over boundaries that do not fit the grid, in steps in time.

These forces depend on the increments: pressures that follow a boundary, Nitsche's terms, penalties
of prescribed displacements, walls. Their work in a step is that of the mean of the forces at its
start and end. Walls (`signorini`) do not move: their work is energy that their penalties store, or
friction. So it is left out here, see `Wall.energy`. In implicit steps walls act in the mean over a
step, as contact with bodies does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.assembly.term import NewState
from dolfinmpm.dynamics.transfer import scatter
from dolfinmpm.solve.operator import Operator
from dolfinmpm.terms.boundaryterm import ActiveBoundaryTerm

__all__ = [
    "boundary_forces",
    "forces_without_contact",
    "has_walls",
    "pending_work",
    "wall_forces",
    "works_of_boundaries",
]

Array = npt.NDArray[np.float64]


def has_walls(operator: Operator) -> bool:
    """Whether the form has walls, see `signorini`."""
    return any(c.pushes for of in operator.form.boundaries for c in of.conditions)


def wall_forces(operator: Operator, what: str) -> list[Array]:
    """Forces of walls on the nodes, shape (nodes, components) per field (N). Collective.

    Args:
        operator: The step's equations.
        what: "force" in the mean over the step, with the increments at its end; or "acting", as in
            the balance of forces.
    """
    here, sums = operator.here, operator.here.unknowns.nodal()
    increments = [space.increment for space in operator.form.spaces]
    for of in operator.form.boundaries:
        walls = [condition for condition in of.conditions if condition.pushes]
        active = operator.active(of) if walls else None
        if not isinstance(active, ActiveBoundaryTerm):
            continue
        found, number = active.new_fields(), of.markers.number
        for wall in walls:
            k = next(i for i, u in enumerate(increments) if u is wall.u)
            ones = np.ones(len(of.markers))
            force = found[f"{wall.name}_{what}"]
            scatter(here.fields[k].of_markers[number], ones, force, sums.arrays[k])
    sums.add_up()
    return list(sums.arrays)


def forces_without_contact(operator: Operator) -> list[Array]:
    """Internal plus external forces without contact and walls (N). Collective.

    Returns:
        Shape (nodes, components) per field.
    """
    forces = operator.forces(without=("contact",))
    if not has_walls(operator):
        return forces
    return [a + b for a, b in zip(forces, wall_forces(operator, "acting"))]


def boundary_forces(operator: Operator) -> list[Array] | None:
    """Internal forces of boundaries at the present increments and loads. Collective.

    Walls that act in the mean over a step are left out.

    Returns:
        Shape (nodes, components) per field (N), or None without boundaries.
    """
    if not operator.has("boundary"):
        return None
    forces = list(operator.forces_of("boundary", renewed=True))
    if operator.form.contact_weights is None or not has_walls(operator):
        return forces
    return [a + b for a, b in zip(forces, wall_forces(operator, "acting"))]


def works_of_boundaries(
    operator: Operator, start: Sequence[Array] | None, state: NewState
) -> tuple[float, float]:
    """Works of boundaries in a step (J). Collective.

    Args:
        operator: The step's equations, at the increments, with the loads at its end.
        start: Internal forces of boundaries at the start of the step (N), shape (nodes, components)
            per field, or None without boundaries.
        state: The new state.

    Returns:
        Work of all boundaries except walls, and work of the forces at the end of the step.
    """
    end = boundary_forces(operator)
    if start is None or end is None:
        return 0.0, 0.0
    here, u, works = operator.here, operator.increments, np.zeros(2)
    for k in here.movers:
        at = here.unknowns.fields[k].owned_nodes
        for i, force in enumerate((0.5 * (start[k] + end[k]), end[k])):
            works[i] -= np.sum((force * u[k])[at])
    # in implicit steps the forces do not have those of walls
    for of in operator.form.boundaries if operator.form.contact_weights is None else ():
        fields, moved = state.of(of.markers), state.moved[of.markers.number]
        for condition in of.conditions:
            works[0] -= condition.own_work(fields, moved)
    here.unknowns.comm.Allreduce(MPI.IN_PLACE, works, op=MPI.SUM)
    return float(works[0]), float(works[1])


def pending_work(
    operator: Operator, start: Sequence[Array] | None, moved: Array, scheme: str
) -> float:
    """Work of boundaries on the motion of a step in "usf", which counts in the next step (J).

    Collective.

    Args:
        operator: The step's equations.
        start: See `works_of_boundaries`.
        moved: Increments of the motion (m), shape (nodes, d).
        scheme: Order of the step; only in "usf" work is pending.
    """
    if start is None or scheme != "usf":
        return 0.0
    at = operator.here.unknowns.fields[0].owned_nodes
    done = -float(np.sum((start[0] * moved)[at]))
    return operator.here.unknowns.comm.allreduce(done, op=MPI.SUM)
