"""The state of the points at the end of a step: `new_state` computes it, `commit` writes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.errors import PointsOutsideGridError, raise_together
from dolfinmpm.assembly.term import NewState
from dolfinmpm.basis.gimp import update_domains
from dolfinmpm.body.axisymmetry import full_gradient, in_section
from dolfinmpm.body.loadbalance import balance
from dolfinmpm.body.location import bounds, destinations
from dolfinmpm.body.pointchecks import seal_results, unseal_results
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.cut.facetmoduli import FIELD
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.grid.tensors import products
from dolfinmpm.kinematics.fbar import VOLUMES, share_volumes
from dolfinmpm.kinematics.heldsides import keep_inside
from dolfinmpm.solve.operator import Operator

if TYPE_CHECKING:
    from dolfinmpm.solve.problem import Problem

__all__ = ["NewState", "commit", "new_state"]

Array = npt.NDArray[np.float64]


@stages.commit
def new_state(
    problem: Problem,
    operator: Operator,
    *,
    x: Array | None = None,
    carried: Mapping[str, Array] | None = None,
    stays: bool = False,
    moved: Sequence[Array] | None = None,
) -> NewState | str:
    """The new state for the present increments of the equations. Collective.

    The function changes no point.

    Args:
        problem: The problem.
        operator: The equations.
        x: New positions (m), shape (n, d), if they do not follow from the increment.
        carried: Values of fields that the form carries, if they do not follow from the present
            increments.
        stays: Whether points strain, but do not move.
        moved: Increments at the nodes by which points move, if they are not the present increments:
            in explicit steps of the order "usf" the strain is that of the last motion. Contacts and
            springs follow them. Shape (nodes, components) per field.

    Returns:
        The state, or the reason of a failure.

    Raises:
        PointsOutsideGridError: Points would leave the grid, by at most one cell.
    """
    points, comm, moves = problem.points, problem.comm, problem.moves and not stays
    evaluation, number = operator.points, len(problem.history) + 1
    moduli = evaluation.moduli() if operator.form.moduli else None
    new = evaluation.end_state()
    if moduli is not None:
        new[FIELD] = operator.form.bounded_moduli(moduli)
    for declaration in operator.form.parts.declarations:
        marks = new.setdefault("moved_under", points["moved_under"].copy())
        marks[declaration.rows] = declaration.mark
    for update in problem.form.updates:
        if not (carried and update.carried):
            update.run(evaluation if update.term is None else operator.active(update.term), new)
    new.update(carried or {})
    reason = _out_of_bounds(points, operator.form.parts.carried, new)
    if reason is not None:
        return reason
    state = NewState(new, moves)
    bad: npt.NDArray[np.intp] = np.empty(0, np.intp)
    if moves:
        bad = _move(operator, new, x)
    if moved is not None:
        operator.set_increments_of("springs", moved)
    operator.update_contact(moved)
    for term in operator.others:
        term.update(state)
    reason = _impossible(operator, new, bad)
    if reason is not None:
        return reason
    for contact in operator.contacts:
        reason = contact.fault(state)
        if reason is not None:
            return reason
    if not moves:
        return state
    if not operator.here.total:
        state.to = destinations(points.grid, new["x"], points["cell"], points.partition)
        lost = np.flatnonzero(state.to.rank < 0)
        far = np.any(np.abs(new["x"][lost] - points["x"][lost]) > largest_cell(points.grid))
        if comm.allreduce(bool(far), op=MPI.LOR):
            # Newton's method may find an equilibrium beyond a singular state
            return "material points would be thrown out of the grid, further than a cell"
        raise_together(comm, _outside(points, new["x"], lost, number, problem.scheme))
    for term in operator.others:
        term.follow(state, number)
    return state


def _impossible(
    operator: Operator, new: Mapping[str, Array], bad: npt.NDArray[np.intp]
) -> str | None:
    """Why points cannot have a new state, or None. Collective.

    Args:
        operator: The operator.
        new: New values by name of the field.
        bad: Points whose volume would not be positive.
    """
    points, comm = operator.form.points, operator.form.points.comm
    low, high = bounds(points.grid)
    # see `error_in_fields`, which would refuse such a domain in the next step
    most = (high - low) * (1 + 1e-9)
    long: npt.NDArray[np.intp] = np.empty(0, np.intp)
    if "l" in new and not 2 * new["l"].max(initial=0.0) <= most.min():
        long = np.flatnonzero(np.any(2 * new["l"] > most, axis=1))
    possible = not bad.size and all(np.isfinite(values).all() for values in new.values())
    if comm.allreduce(possible and not long.size, op=MPI.LAND):
        return None
    for rows in (bad, long):
        if rows.size:
            operator.points.blame(int(rows[0]))
            break
    if not comm.allreduce(possible, op=MPI.LAND):
        return "a material point's state is not finite or its volume not positive"
    return (
        "the domain of a material point would be longer than the grid, as where a body is torn: "
        "take a stabilisation, or domains that change with the volume only, "
        'mpm.Space(..., domains="volume")'
    )


def _move(operator: Operator, new: dict[str, Array], x: Array | None) -> npt.NDArray[np.intp]:
    """Deform the points and move them, in a new state.

    Args:
        operator: The operator.
        new: New values by name of the field; the function adds the moved fields.
        x: New positions (m), shape (n, d), if they do not follow from the increment.

    Returns:
        Points whose volume would not be positive.
    """
    points, here = operator.form.points, operator.here
    u, gradient = operator.points.motion(here.movers)
    if points.axisymmetric:
        gradient = full_gradient(points, u, gradient)
    new["F"], J = products(gradient + np.eye(points.strain_dim), points["F"])
    bad = np.flatnonzero(~(J > 0))
    for declaration in operator.form.parts.declarations:
        if declaration.fbar == VOLUMES and not bad.size:
            share_volumes(new["F"], J, new["J_bar"], declaration.rows)
    new["V"] = J * points["V0"]
    new["x"] = points["x"] + u if x is None else x
    if not here.total:
        keep_inside(points, here, new["x"])
    if any(here.fields[k].basis.averaged for k in here.movers):
        new["l"] = _domains(operator, new["F"])
    return bad


@stages.commit
def commit(points: MaterialPoints, state: NewState) -> int:
    """Write a new state, and move the points to the ranks of their cells. Collective.

    Returns:
        Number of points that changed rank.
    """
    unseal_results(points)
    for name, values in state.fields.items():
        points.fields[name][...] = values
    for markers, fields, to in state.markers:
        for name, values in fields.items():
            markers.fields[name][...] = values
        if to is not None:
            markers.migrate(to)
    migrated = 0
    if state.to is not None:
        migrated = points.migrate(state.to)
        if points.comm.size > 1:
            migrated += balance(points)
    seal_results(points)
    return migrated


def _domains(operator: Operator, F: Array) -> Array:
    """Half-lengths of the points' domains (m), by the rule of each point's field."""
    points, here = operator.form.points, operator.here
    new = points["l"].copy()
    if points.axisymmetric:
        F = in_section(points, F)
    for field in (here.fields[k] for k in here.movers):
        if not field.basis.averaged:
            continue
        tags, growth = field.space.tags, field.space.domains
        if tags is None:
            return update_domains(F, points["l0"], growth)
        own = np.isin(points["tag"], tags)
        new[own] = update_domains(F[own], points["l0"][own], growth)
    return new


def _out_of_bounds(
    points: MaterialPoints, carried: Sequence[PointField], new: dict[str, Array]
) -> str | None:
    """The first carried field outside its bounds, for a message, or None. Collective."""
    found = None
    for field in carried:
        if isinstance(field, CarriedField) and field.bounds is not None:
            low, high = field.bounds
            values = new[field.name]
            bad = np.flatnonzero(~((values > low) & (values < high)))
            if bad.size and found is None:
                p = bad[0]
                found = (
                    f"{field.name} = {values[p]:.4g} of the point at {points['x'][p]} m, which "
                    f"must lie between {low:g} and {high:g}"
                )
    bounded = any(isinstance(field, CarriedField) and field.bounds for field in carried)
    if not bounded:
        return None
    return next((text for text in points.comm.allgather(found) if text is not None), None)


def _outside(
    points: MaterialPoints, x: Array, lost, step: int, scheme: Any
) -> PointsOutsideGridError | None:
    """The error about points that would leave the grid, or None."""
    if lost.size == 0:
        return None
    p = lost[0]
    return PointsOutsideGridError(
        f"{lost.size} material points would leave the grid in step {step}; point "
        f"{points['id'][p]} goes from {points['x'][p]} m to {x[p]} m. The state is that before it: "
        f"enlarge the grid or hold the points with boundary conditions{scheme.remark_on(step)}"
    )
