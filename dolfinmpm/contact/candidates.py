"""The points that may touch a rigid body in a step, and checks of all other points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.contact.corners import ALL, CornerLayout, Rows, Which, longest
from dolfinmpm.contact.protocols import RigidContactTerm
from dolfinmpm.contact.tunnelling import entered, passes, suspected, too_far, travelled, within

__all__ = ["MARGIN", "candidates", "passed_through", "unlisted_entered"]

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]

# Margin around a body in which points are searched, in half-lengths of domains. The motion of the
# body in a step is added.
MARGIN = 4.0


def touchable(contact: RigidContactTerm, layout: CornerLayout, rows: Which) -> Chosen | None:
    """Which of some points can touch at all, or None if all points can."""
    can = layout.marked(rows)
    if contact.tags is None:
        return can
    chosen = contact.chosen(rows)
    return chosen if can is None else chosen & can


def candidates(
    contact: RigidContactTerm, layout: CornerLayout, listed: Rows | None, distance: float
) -> Rows:
    """The points that may touch in a step, increasing. Collective before the first step.

    Args:
        contact: The contact, with its body at the end of the step.
        layout: The corners of the points.
        listed: The points to search, increasing, or None for all points.
        distance: Largest distance from the body of corners that can touch in the step (m).

    Raises:
        ParameterError: Points are inside the body before the first step.
    """
    body, points = contact.body, contact.points
    rows: Which = ALL if listed is None else listed
    x, l0 = points["x"][rows], points["l0"][rows]
    # a step in which points come from further away is halved, see `unlisted_entered`
    margin = np.minimum(MARGIN * longest(l0), distance)
    reach = layout.reach(rows) + margin
    # nothing comes nearer than a given distance in the step
    poses = [body.start, body.pose] if math.isinf(distance) else [body.start]
    near = within(poses, body.surface, x, reach[:, None])
    can = touchable(contact, layout, rows)
    if can is not None:
        near &= can
    chosen = np.flatnonzero(near)
    gap: Array = np.full(chosen.size, np.inf)
    first = gap
    if chosen.size:
        for k, pose in enumerate(poses):
            found = body.surface.probe(pose.back(x[chosen]))[0]
            gap = np.minimum(gap, found)
            if k == 0:
                first = found
    if body.time == 0.0:
        error = None
        if first.min(initial=np.inf) < 0.0:
            p = chosen[np.argmin(first)]
            error = ParameterError(
                f"{np.count_nonzero(first < 0)} material points are inside '{body.name}' "
                f"before the first step; the point at {x[p]} m is inside by "
                f"{-first.min():.4g} m: fill the body beside it, or make the rigid body outside"
            )
        raise_together(points.comm, error)
    chosen = chosen[gap < reach[chosen]]
    return chosen if listed is None else listed[chosen]


def unlisted_entered(active: Any, x: Array, before: Array | None = None) -> bool:
    """Whether points that were no candidates have entered the body. Collective.

    Args:
        active: The contact, active in a step.
        x: Positions of all points at the end of the step (m), shape (points, gdim).
        before: Their positions at the start of the step, if paths through the body count too.
    """
    contact, body = active.contact, active.contact.body
    path = 0.0 if before is None else float(np.abs(x - before).max(initial=0.0))
    near = within([body.pose], body.surface, x, path)
    near[active.candidates] = False
    can = touchable(contact, active.layout, ALL)
    if can is not None:
        near &= can
    rows = np.flatnonzero(near)
    first = x if before is None else before
    start, end = body.start.back(first[rows]), body.pose.back(x[rows])
    inside = bool(rows.size) and entered(body.surface, body.half_thickness, start, end).any()
    return contact.points.comm.allreduce(bool(inside), op=MPI.LOR)


def passed_through(active: Any) -> str | None:
    """Why the present pose of the body lets it and points of this rank pass, or None."""
    contact, body, now = active.contact, active.contact.body, active.now
    if body.freedom is not None:
        # prescribed motions have been checked before the step
        fault = too_far(body, travelled(body.surface, body.start, body.pose), contact.limit)
        if fault is not None:
            return fault
    half = body.half_thickness
    if not len(active.x) or not suspected(half, now.gap, now.path):
        return None
    how = passes(body.surface, half, active.local_start, body.pose.back(active.x), now.gap)
    if how is None:
        return None
    return (
        f"points that touch '{body.name}' {how}: take smaller steps or a larger penalty, or bound "
        "the penetration"
    )
