"""Boundaries that do not fit the grid, in the course of a step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm._platform.errors import PointsOutsideGridError, raise_together
from dolfinmpm.assembly.evaluation import Evaluation
from dolfinmpm.assembly.nitschepenalty import trace_constants
from dolfinmpm.assembly.updates import PointUpdates
from dolfinmpm.body.axisymmetry import deformation, in_section
from dolfinmpm.body.boundary import OWN, Boundary
from dolfinmpm.body.location import Destinations, cells_here, destinations
from dolfinmpm.body.markerstate import take_state
from dolfinmpm.cut.participants import Activation
from dolfinmpm.forms.splitting import BoundaryTerms
from dolfinmpm.grid.lattice import lattice_of, smallest_height
from dolfinmpm.kinematics.nitsche import TRACE
from dolfinmpm.solve.referencemarkers import refer

__all__ = [
    "MarkerState",
    "advance_markers",
    "commit_markers",
    "memory_of_markers",
    "order_of_markers",
    "place_markers",
    "set_markers",
    "set_penalties",
]

Array = npt.NDArray[np.float64]
# Constants of cells with a stabilisation serve as long as the boundary moves by no more of a cell
_STILL = 0.02
MarkerState = tuple[Boundary, dict[str, Array], Destinations | None]


def place_markers(boundaries: Sequence[BoundaryTerms]) -> None:
    """Bring markers to the ranks of their cells, with the state of the nearest points. Collective.

    Args:
        boundaries: Terms over boundaries.
    """
    for of in boundaries:
        markers, points = of.boundary.markers, of.boundary.points
        if markers.partition is not points.partition:
            markers.partition = points.partition
            markers.locate()
        if of.stateful:
            take_state(of.boundary, of.tags)
        if markers.configuration == "total" and not of.boundary.follows:
            refer(of.boundary)


def set_penalties(
    boundaries: Sequence[BoundaryTerms],
    here: Activation,
    moduli: Any,
    increments: Sequence[Any],
    stabilised: bool,
) -> None:
    """Set the penalties of weak conditions for a step. Collective.

    Args:
        boundaries: Terms over boundaries.
        here: What is active.
        moduli: Function that gives the elastic moduli M and G at the points (Pa).
        increments: Increments of the fields.
        stabilised: Whether a stabilisation bounds the constants of cells with small cuts, so that
            they
            change little with the cut.
    """
    for number, of in enumerate(boundaries):
        markers = of.boundary.markers
        rows = np.sort(here.fields[0].of_markers[number].order)
        for condition in of.conditions:
            condition.prepare(rows)
        # constants are kept of one field
        fields = {id(c.declaration.u) for c in of.conditions if c.local}
        for k, u in enumerate(increments):
            local = [c for c in of.conditions if c.local and c.declaration.u is u]
            if not local:
                continue
            if not (stabilised and len(fields) == 1 and _stays(of.boundary, rows)):
                at = np.zeros((len(markers), 2))
                for one in of.declarations:
                    at[one.rows] = one.moduli()
                points = of.boundary.points
                found = trace_constants(here, k, points, moduli(), markers, at, number)
                markers[TRACE], markers[f"{TRACE}_x"] = found, markers["x"]
                markers[f"{TRACE}_cell"] = _middles(of.boundary)
            for condition in local:
                of_law = condition.declaration.rows
                markers[condition.stiffness][of_law] = 2.0 * markers[TRACE][of_law]


def _middles(boundary: Boundary) -> Array:
    """Middles of the markers' cells (m), shape (markers, gdim)."""
    markers, grid, x = boundary.markers, boundary.markers.grid, boundary.seen
    lattice = lattice_of(grid)
    if lattice is None:
        corners = grid.geometry.x[:, : markers.gdim][geometry_dofmap(grid)[markers["cell"]]]
        return np.asarray(corners.mean(axis=1), np.float64)
    ijk = lattice.cells_at(x)
    lines = enumerate(lattice.lines)
    return np.column_stack([0.5 * (line[ijk[:, d]] + line[ijk[:, d] + 1]) for d, line in lines])


def _stays(boundary: Boundary, rows: npt.NDArray[np.integer]) -> bool:
    """Whether markers are next to where constants were computed for them, in the same cells."""
    markers = boundary.markers
    h = smallest_height(markers.grid)
    way = np.abs(markers["x"] - markers[f"{TRACE}_x"])[rows].max(initial=0.0)
    other = np.abs(_middles(boundary) - markers[f"{TRACE}_cell"])[rows].max(initial=0.0)
    known = bool((markers[TRACE][rows] > 0).all())
    same = known and way < _STILL * h and other < 1e-6 * h
    return bool(markers.comm.allreduce(same, op=MPI.LAND))


def advance_markers(
    boundaries: Sequence[BoundaryTerms],
    updates: Sequence[PointUpdates],
    evaluations: Sequence[Evaluation],
    step: int,
    movers: Sequence[int] = (0,),
) -> list[MarkerState]:
    """The new state of markers, which nothing has been changed for. Collective.

    Args:
        boundaries: Terms over boundaries.
        updates: Their fields that are set to UFL expressions.
        evaluations: Their terms, moved to the increments.
        step: Number of the step, for messages.
        movers: Numbers of the fields that move what sees them.

    Raises:
        PointsOutsideGridError: Markers would leave the grid.
    """
    made: list[MarkerState] = []
    for of, update, evaluation in zip(boundaries, updates, evaluations):
        markers = of.boundary.markers
        new: dict[str, Array] = {}
        update.run(evaluation, new)
        if not of.boundary.follows:
            made.append((of.boundary, new, None))
            continue
        u, gradient = evaluation.motion(movers)
        dF = deformation(markers, u, gradient)
        J = np.linalg.det(dF)
        # Nanson's formula
        across = np.swapaxes(in_section(markers, dF), 1, 2)
        turned = np.linalg.solve(across, markers["area"][:, :, None])[:, :, 0]
        new["area"] = J[:, None] * turned
        new["V"] = np.linalg.norm(new["area"], axis=1)
        new["x"] = markers["x"] + u
        if OWN in markers.fields:
            new[OWN] = dF @ markers[OWN]
        if markers.configuration == "total":
            made.append((of.boundary, new, None))
            continue
        to = destinations(markers.grid, new["x"], markers["cell"], markers.partition)
        raise_together(markers.comm, _outside(of.boundary, new["x"], to, step))
        made.append((of.boundary, new, to))
    return made


def commit_markers(states: Sequence[MarkerState]) -> None:
    """Write a new state, and move the markers to the ranks of their cells. Collective."""
    for boundary, new, to in states:
        for name, values in new.items():
            boundary.markers.fields[name][...] = values
        if to is not None:
            boundary.markers.migrate(to)


def memory_of_markers(boundaries: Sequence[BoundaryTerms]) -> dict[str, npt.NDArray[Any]]:
    """What markers keep, in the order of their numbers, the same on all ranks. Collective."""
    state: dict[str, npt.NDArray[Any]] = {}
    for k, of in enumerate(boundaries):
        markers = of.boundary.markers
        names = _kept(of.boundary)
        found = markers.comm.bcast(markers.gather(*names))
        state |= {f"boundary {k} {name}": values for name, values in zip(names, found)}
    return state


def order_of_markers(boundaries: Sequence[BoundaryTerms]) -> dict[str, npt.NDArray[Any]]:
    """Numbers of this rank's markers as they stand, behind whether they are where points are."""
    made = {}
    for k, of in enumerate(boundaries):
        markers = of.boundary.markers
        placed = markers.partition is of.boundary.points.partition
        made[f"boundary {k}"] = np.concatenate([[np.int64(placed)], markers["id"]])
    return made


def set_markers(
    boundaries: Sequence[BoundaryTerms], state: dict[str, Any], local: dict[str, Any] | None
) -> None:
    """Set markers to what `memory_of_markers` returned, on any number of ranks. Collective.

    Args:
        boundaries: Terms over boundaries.
        state: What that returned.
        local: What `order_of_markers` did on this rank; None if ranks are others.
    """
    for k, of in enumerate(boundaries):
        markers, names = of.boundary.markers, _kept(of.boundary)
        markers.partition = of.boundary.points.partition
        if local is not None:
            placed, number = local[f"boundary {k}"][0], local[f"boundary {k}"][1:].copy()
            if not placed:
                # the next step finds their ranks, as it would have done
                markers.partition = None
            for name, values in markers.fields.items():
                # the state of the nearest points is taken anew
                markers.fields[name] = np.zeros((len(number), *values.shape[1:]), values.dtype)
            markers.fields["id"] = number
        for name in names:
            markers.fields[name][...] = state[f"boundary {k} {name}"][markers["id"]]
        if local is None:
            markers.locate()
        else:
            markers.fields["cell"] = cells_here(markers.grid, of.boundary.seen)
            markers.recount()
        if of.stateful:
            take_state(of.boundary, of.tags)


def _kept(boundary: Boundary) -> list[str]:
    """Names of the markers' fields that are not of the nearest point."""
    state = {*boundary.points.fields, "body_x", "body_l", "body_x0"} - {"x", "V", "x0", "V0"}
    state.add("cell")
    return sorted(name for name in boundary.markers.fields if name not in state)


def _outside(boundary: Boundary, x: Array, to: Destinations, step: int):
    lost = np.flatnonzero(to.rank < 0)
    if lost.size == 0:
        return None
    return PointsOutsideGridError(
        f"{lost.size} markers of {boundary} would leave the grid in step {step}, one from "
        f"{boundary.markers['x'][lost[0]]} m to {x[lost[0]]} m. The state is that before it: "
        "enlarge the grid, or let the boundary stay in space with follows=False"
    )
