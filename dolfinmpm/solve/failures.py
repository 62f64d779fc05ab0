"""Failed steps: release of forces out of balance by shares, and messages with advice.

Points that cross cells put the state out of balance: with linear functions by a quarter of the
loads. The first substep must make up for all of it, however small the substep is. So halving alone
does not help. Here a substep releases as much of these forces as its share of the way to the end of
the step, and leaves the others out of balance. At the end of the step all forces balance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.basis.conditionchecks import free_motions
from dolfinmpm.body.axisymmetry import deformation
from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.facetedsurface import FacetedSurface
from dolfinmpm.contact.rigidbody import RigidBody
from dolfinmpm.cut.activecells import active_on_grid
from dolfinmpm.kinematics.nitsche import WeakCondition
from dolfinmpm.solve.firststress import remark_on_unstressed
from dolfinmpm.solve.loosepieces import loose_piece
from dolfinmpm.solve.newton import Newton
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.step import Failed

if TYPE_CHECKING:
    from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = [
    "FIRST_RELEASED",
    "advice_on",
    "begins_unbalanced",
    "failed_step",
    "hold_back",
    "why_step_failed",
]

Array = npt.NDArray[np.float64]

# Share of the first substep that releases forces out of balance
FIRST_RELEASED = 0.125
# Relative force out of balance at the start of the smallest substep, by its share of the load, that
# is not the load's own
_UNBALANCED = 4.0
# Rounding of positions, over the half-length of a point, that a balance of contact forces feels
_ROUNDINGS = 4.0
# Change of a load in the smallest substep, as a share of the load, that is a jump
_JUMP = 0.1
# Distance from an edge of a corner in line with it, and beside it, as a share of the longest
# half-length of the point. Footings that tilt failed with corners half of it beside their edges.
_IN_LINE, _BESIDE = 0.01, 0.6
_EDGES = "", "beside", "in line with"


def failed_step(problem: QuasiStatic, operator: Operator, reason: str) -> Failed:
    """What is known of a step that failed. Collective.

    Args:
        problem: The problem.
        operator: The step's equations.
        reason: The reason, in a few words.
    """
    free = [] if problem.scheme.inertia else problem.bodies.free
    contacts = problem.bodies.acting(operator)
    support = _jump_of_load(free) or _missing_support(free, contacts, reason, problem.comm)
    edges = _advice_on_edges(contacts, problem.comm)
    return Failed(reason, _worst_point(problem, operator, reason), support, edges)


def why_step_failed(problem: QuasiStatic, failed: Failed, done: float, share: float) -> str:
    """Message about a step that failed after all halvings. Collective.

    Args:
        problem: The problem.
        failed: The last substep.
        done: Converged share of the step.
        share: Share of the last substep.
    """
    number, thrown = len(problem.history) + 1, "NAN" in failed.reason or "out of" in failed.reason
    remark = problem.scheme.remark_on(number) if thrown and not done else ""
    if number == 1 and not done:
        remark += remark_on_unstressed(problem.points, problem.form.parts.declarations)
    return (
        f"step {number} failed at {done + share:.4g} of its load "
        f"({problem.loads.describe()}) with substeps of {share:.3g}; the reason is "
        f"{failed.reason}; the relative out-of-balance force is {problem.last_residual} (tolerance "
        f"{problem.tolerance:g}); the worst is {failed.worst}. The state is that at "
        f"{done:.4g} of the step: {failed.advice or advice_on(problem)}{failed.remark}"
        f"{remark}"
    )


def advice_on(problem: QuasiStatic) -> str:
    """Advice on a step that failed. Collective."""
    here = problem.here
    if here is None:
        # a rigid body would move too far, so no step has begun
        return "take smaller steps"
    first, points = here.fields[0], problem.points
    named = any(field.stabilisation.kind != "none" for field in problem.fields)
    text = "take smaller steps or add stabilisation"
    if named or here.ghost_facets > 0:
        text = "take smaller steps"
    if first.space.increment.ufl_shape != (points.gdim,):
        return text
    free = free_motions(problem.bcs, first.space, active_on_grid(first), points.axisymmetric)
    if free and _held_within_cells(problem):
        return _advice_on_rounding(problem) or text
    if not free:
        loose = "" if problem.scheme.inertia else loose_piece(problem)
        return f"{loose}; or {text}" if loose else _advice_on_rounding(problem) or text
    if not problem.bcs:
        return (
            "no boundary conditions are given, rigid motions are free: hold the body with "
            f"mpm.fixed or mpm.rollers unless a term of the form does, or {text}"
        )
    return (
        f"no condition holds the body's rigid motions {', '.join(free)}: add one unless a term of "
        f"the form holds them, or {text}"
    )


def _held_within_cells(problem: QuasiStatic) -> bool:
    """Whether boundaries that do not fit the grid hold the body.

    One of them holds all components, or several hold one each. Walls push only.
    """
    every = [c for of in problem.form.boundaries for c in of.conditions]
    held = [c for c in every if isinstance(c, WeakCondition)]
    return len(held) > 1 or any(c.direction is None for c in held)


def _advice_on_rounding(problem: QuasiStatic) -> str:
    """Advice where positions are rounded so much that contact cannot balance, or "". Collective.

    Gaps are differences of positions. Their rounding, over the sizes of the points, is that of the
    forces.
    """
    points = problem.points
    ends = np.array([np.abs(points["x"]).max(initial=0.0), -points["l"].min(initial=np.inf)])
    points.comm.Allreduce(MPI.IN_PLACE, ends, op=MPI.MAX)
    far, size = float(ends[0]), -float(ends[1])
    rounding = float(np.spacing(far))
    reached = _ROUNDINGS * rounding / size
    if not problem.bodies.all or reached < problem.tolerance:
        return ""
    return (
        f"the body is {far:.3g} m from the origin, where positions are rounded to {rounding:.1g} "
        f"m, and contact forces cannot balance to the tolerance {problem.tolerance:g}: subtract an "
        f"origin near the body from all coordinates, or take tolerance={10 * reached:.0e}"
    )


def _worst_point(problem: QuasiStatic, operator: Operator, reason: str) -> str:
    """The point or node whose terms failed, or the most compressed point. Collective."""
    points = problem.points
    found = None
    if len(points):
        J = np.ones(len(points))
        if problem.moves:
            motion = operator.points.motion(operator.here.movers)
            J = np.linalg.det(deformation(points, *motion))
        failure = operator.points.failure
        if failure is None and "NAN" in reason:
            faces = (operator.active(term) for term in operator.form.surfaces)
            found_in = (one.not_finite() for one in (operator.points, *faces))
            failure = next((one for one in found_in if one is not None), None)
        p = int(np.argmin(np.nan_to_num(J, nan=-np.inf))) if failure is None else failure.point
        place = f"point {points['id'][p]} at {points['x'][p]} m with det ΔF = {J[p]:.4g}"
        place += f": {failure.cause}" if failure is not None and failure.cause else ""
        found = (failure is None, np.nan_to_num(J[p], nan=-np.inf), place)
    candidates = [c for c in points.comm.allgather(found) if c is not None]
    if "NAN" in reason and all(no_failure for no_failure, *_ in candidates):
        nodes = [node for node in points.comm.allgather(_failed_node(operator)) if node]
        if nodes:
            return nodes[0]
    return min(candidates)[2] if candidates else "none"


def _failed_node(operator: Operator) -> str:
    """A node whose forces are not finite, in words; an inner one of them. Collective."""
    forces = operator.forces()
    moved = all(np.isfinite(u).all() for u in operator.increments)
    for field, force in zip(operator.here.fields, forces) if moved else ():
        bad = field.nodes[~np.isfinite(force[field.nodes]).all(axis=1)]
        if bad.size:
            x = field.basis.node_coordinates()[bad, : field.space.grid.geometry.dim]
            apart = np.linalg.norm(x - x.mean(axis=0), axis=1)
            return (
                f"the node at {x[np.argmin(apart)]} m, where forces are not finite: look at "
                "divisions, roots and logarithms in terms over the grid, and at their functions"
            )
    return ""


def _jump_of_load(bodies: Sequence[RigidBody]) -> str:
    """Advice on a load by a function of time that jumps within the smallest substep, or "".

    Args:
        bodies: The free bodies.
    """
    for body in bodies:
        if not body.free_motion.loads_by_functions:
            continue
        end, d = body.free_motion.external(body.time + body.dt), body.gdim
        change = np.abs(end + np.concatenate([body.force, body.moment]))
        free = body.free_motion.free
        for part in (free[free < d], free[free >= d]):
            if np.any(change[part] > _JUMP * np.abs(end[part]).max(initial=0.0)):
                return (
                    f"the load of '{body.name}' is a function of t that jumps, and substeps take "
                    "the whole jump at once: give the load as a dolfinx.fem.Constant, which "
                    "substeps divide, or as a function without jumps"
                )
    return ""


def _missing_support(
    bodies: Sequence[RigidBody], contacts: Sequence[ActiveRigidContact], reason: str, comm: MPI.Comm
) -> str:
    """Advice on a free rigid body without support in a step without inertia. Collective.

    Args:
        bodies: The free bodies.
        contacts: The contacts in their last state.
        reason: Reason of the failure.
        comm: The ranks.

    Returns:
        The advice, or an empty string if contact supports all free bodies.
    """
    for body in bodies:
        own = [contact for contact in contacts if contact.contact.body is body]
        # iterations that fail may throw a body off on which it rested
        touching = any(c.now.normal.any() or c.start.normal_force.any() for c in own)
        touches = comm.allreduce(touching, op=MPI.LOR)
        if touches and "singular" not in reason:
            continue
        what = "nothing touches it" if not touches else "contact does not hold it in all of them"
        free = ", ".join(map(str, body.free_motion.free))
        return (
            f"'{body.name}' is free in the components {free} of its motion, {what}, and without "
            "inertia nothing else carries its load: begin where it rests on the points, give the "
            "contact friction, prescribe the components that are not to move, "
            "free=(False, True, ...), or take Newmark and give it a mass"
        )
    return ""


def _advice_on_edges(contacts: Sequence[ActiveRigidContact], comm: MPI.Comm) -> str:
    """Remark on a rigid body with a sharp edge in line with corners of points. Collective.

    Args:
        contacts: The contacts in their last state.
        comm: The ranks.
    """
    for contact in contacts:
        where = comm.allreduce(_at_sharp_edge(contact), op=MPI.MAX)
        if where:
            return (
                f". A sharp edge of '{contact.contact.body.name}' is {_EDGES[where]} corners of "
                "points, where the normal jumps and forces may find no balance: round it, "
                "fillet=... of mpm.RigidBody, by some share of a cell, or make it a little wider"
            )
    return ""


def _at_sharp_edge(active: ActiveRigidContact) -> int:
    """Where corners of points begin the step at a sharp edge, on this rank: a row of `_EDGES`.

    A prescribed body without friction finds its balance there. A body that is free to turn may
    fail with corners beside its edge.

    Args:
        active: The contact.
    """
    body, points = active.contact.body, active.contact.points
    friction, free = active.contact.law.friction, body.freedom
    turns = free is not None and bool(np.any(free.free >= body.gdim))
    if not isinstance(body.surface, FacetedSurface) or not (friction or turns):
        return 0
    touches = active.start.gap <= active.now.path
    x = active.local_start[touches]
    length = points["l"].max(axis=1)[active.corners.rows[touches]]
    shares = [_distances(x, *ends) / length for ends in body.surface.sharp_edges()]
    nearest = min((float(share.min(initial=np.inf)) for share in shares), default=np.inf)
    if nearest <= _IN_LINE:
        return 2
    return 1 if turns and nearest <= _BESIDE else 0


def _distances(x: Array, a: Array, b: Array) -> Array:
    """Distances of positions from a segment (m), shape (n,)."""
    along = b - a
    square = float(along @ along)
    t = np.clip((x - a) @ along / square, 0.0, 1.0) if square else np.zeros(len(x))
    return np.linalg.norm(x - a - t[:, None] * along, axis=1)


def begins_unbalanced(problem: QuasiStatic, residuals: Sequence[float]) -> bool:
    """Whether the state is out of balance at the start of the smallest substep, which failed.

    Args:
        problem: The problem. Inertia balances forces in its own way, and free bodies add equations.
        residuals: Relative forces out of balance before and after each iteration.
    """
    if problem.scheme.inertia or not isinstance(problem.solver, Newton):
        return False
    least = 0.5**problem.max_halvings
    return least < FIRST_RELEASED and bool(residuals) and residuals[0] > _UNBALANCED * least


def hold_back(operator: Operator, released: float) -> None:
    """Add external forces that balance the forces out of balance at rest, but a share. Collective.

    Args:
        operator: The equations of a substep.
        released: Share of the forces that is not balanced.
    """
    operator.move_to_zero()
    for mine, force in zip(operator.external, operator.forces()):
        mine -= (1.0 - released) * force
