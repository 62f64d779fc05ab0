"""Which points may touch a rigid body in a step."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.contact.corners import ALL, Rows, Sites, Which, longest
from dolfinmpm.contact.declared import DeclaredContact
from dolfinmpm.contact.passing import within

__all__ = ["MARGIN", "candidates", "touchable"]

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]

# How far around a body points are looked at, besides its way in a step, in half-lengths of domains
MARGIN = 4.0


def touchable(contact: DeclaredContact, sites: Sites, rows: Which) -> Chosen | None:
    """Which of some points can touch at all, or None if all can."""
    can = sites.marked(rows)
    if contact.tags is None:
        return can
    chosen = contact.chosen(rows)
    return chosen if can is None else chosen & can


def candidates(contact: DeclaredContact, sites: Sites, among: Rows | None, distance: float) -> Rows:
    """Which points may touch in a step, increasing. Collective before the first step.

    Args:
        contact: The contact, its body put to the end of the step.
        sites: Where the points touch.
        among: The points that are looked at, increasing, or None for all.
        distance: How near to the body corners are that can touch in the step (m).

    Raises:
        ParameterError: Points are inside the body before the first step.
    """
    body, points = contact.body, contact.points
    rows: Which = ALL if among is None else among
    x, l0 = points["x"][rows], points["l0"][rows]
    # points that come from further away in one step are missed, and the step is halved
    margin = np.minimum(MARGIN * longest(l0), distance)
    reach = sites.reach(rows) + margin
    # where a distance is told nothing comes nearer than that in the step
    poses = [body.start, body.pose] if math.isinf(distance) else [body.start]
    near = within(poses, body.surface, x, reach[:, None])
    can = touchable(contact, sites, rows)
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
                f"before the first step; that at {x[p]} m is so by "
                f"{-first.min():.4g} m: fill the body beside it, or make the rigid body outside"
            )
        raise_together(points.comm, error)
    chosen = chosen[gap < reach[chosen]]
    return chosen if among is None else among[chosen]
