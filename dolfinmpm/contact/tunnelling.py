"""The points that may touch a rigid body in a step, and checks that no point passes through it.

Contact pushes a corner out of a body along the normal of the nearest face. A corner beyond the
middle of the body is pushed out on the far side, and later steps cannot detect this.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.contact.bodymotion import Pose
from dolfinmpm.contact.corners import ALL, CornerLayout, Rows, Which, longest
from dolfinmpm.contact.facetedsurface import FacetedSurface, facet_normals
from dolfinmpm.contact.surfaces import Revolved, RigidSurface, Round, Rounded

if TYPE_CHECKING:
    from dolfinmpm.contact.rigidcontact import RigidContact

__all__ = [
    "MARGIN",
    "candidates",
    "entered",
    "half_thickness",
    "limit_of",
    "passed_through",
    "passes",
    "too_far",
    "travelled",
    "unlisted_entered",
    "within",
]

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]

# Steps along a path inside a body, and the least depth of a path through the body, in half
# thicknesses; paths around a tip are less deep
_STRIDE, _THROUGH = 0.25, 0.25
# Largest cosine of the angle between the normals of opposite faces: for short paths, and for paths
# longer than half the thickness. Faces at an edge of 45° or more are neighbours. At any depth a
# corner may come from one to the other, and smaller steps do not change this.
_OPPOSITE, _AROUND = -math.sqrt(0.5), -1e-6
# Largest number of steps along a path
_MOST = 10_000
# Mask of the upper coordinates of the corners of a box, by dimension
_UPPER = {d: np.indices((2,) * d).reshape(d, -1).T == 1 for d in (2, 3)}


def half_thickness(surface: RigidSurface) -> float:
    """Volume of a body divided by its surface (m): half the thickness of a plate.

    For a convex body it is at most the radius of the largest ball inside. For a body of revolution
    it is that of the section. For an infinite body it is infinite.
    """
    if isinstance(surface, Round):
        return surface.radius / surface.gdim
    if isinstance(surface, Rounded):
        return half_thickness(surface.core) + surface.radius
    if isinstance(surface, Revolved):
        return half_thickness(surface.profile)
    if not isinstance(surface, FacetedSurface):
        return math.inf
    normals = facet_normals(surface.x, surface.facets)
    # normals of triangles have twice their area
    areas = normals / (surface.gdim - 1)
    middles = surface.x[surface.facets].mean(axis=1) - surface.low
    volume = float(np.sum(middles * areas)) / surface.gdim
    return volume / float(np.linalg.norm(areas, axis=1).sum())


def _box_corners(low: Array, high: Array) -> Array:
    """Corners of a box (m), shape (2^gdim, gdim)."""
    return np.where(_UPPER[len(low)], high, low)


def travelled(surface: RigidSurface, start: Pose, end: Pose) -> float:
    """Largest motion of a body between two poses; for an infinite body that of its centre (m)."""
    if not np.isfinite(surface.low).all():
        return float(np.linalg.norm(end.shift - start.shift))
    corners = _box_corners(surface.low, surface.high)
    return float(np.linalg.norm(end.forth(corners) - start.forth(corners), axis=1).max())


def limit_of(body: Any, cell: float) -> float:
    """Largest allowed motion of a body at once (m): a cell, or half its own thickness."""
    return min(cell, body.half_thickness)


def too_far(body: Any, travel: float, cell: float) -> str | None:
    """Why a motion of a body is too large, or None.

    Args:
        body: The rigid body.
        travel: Its motion (m).
        cell: Smallest size of a cell (m).
    """
    limit = limit_of(body, cell)
    if travel <= limit * (1 + 1e-9):
        return None
    what = "a cell" if limit == cell else "half its mean thickness"
    return f"'{body.name}' moves {travel:.3g} m at once, more than {what} ({limit:.3g} m)"


def within(poses: list[Pose], surface: RigidSurface, x: Array, reach: Array | float) -> Chosen:
    """Mask of positions near the bounding box of a surface, in any of some poses.

    Args:
        poses: The poses.
        surface: The surface. All positions are near an infinite surface.
        x: Positions (m), shape (n, gdim).
        reach: Largest distance from the box (m), a number or shape (n, 1).
    """
    if not np.isfinite(surface.low).all():
        return np.ones(len(x), bool)
    corners = np.concatenate([p.forth(_box_corners(surface.low, surface.high)) for p in poses])
    first, last = corners.min(axis=0), corners.max(axis=0)
    return np.all((x + reach >= first) & (x - reach <= last), axis=1)


def entered(surface: RigidSurface, half: float, start: Array, end: Array) -> Chosen:
    """Mask of the straight paths that enter a body, shape (n,).

    Args:
        surface: Its surface.
        half: Half its thickness (m), see `half_thickness`.
        start, end: Ends of the paths in its frame (m), shape (n, gdim).
    """
    found = surface.probe(end)[0] < 0.0
    if math.isinf(half):
        return found
    # paths that end outside may have gone through the body
    low, high = np.minimum(start, end), np.maximum(start, end)
    rows = np.flatnonzero(~found & np.all((high >= surface.low) & (low <= surface.high), axis=1))
    rows = rows[np.linalg.norm(end[rows] - start[rows], axis=1) > half]
    found[rows] = _along(surface, start[rows], end[rows], half)[0] < 0.0
    return found


def suspected(half: float, gap: Array, path: Array) -> bool:
    """Whether some of at least one corner may have passed through a body.

    Args:
        half: Half its thickness (m).
        gap: Gaps of the corners (m), infinite if they are far away, shape (n,).
        path: Upper bounds of the paths of the corners (m), shape (n,).
    """
    return bool(gap.min() < -_THROUGH * half or path.max() > half)


def passes(surface: RigidSurface, half: float, start: Array, end: Array, gap: Array) -> str | None:
    """How corners pass through a body instead of touching it, in words, or None.

    Args:
        surface: Its surface.
        half: Half its thickness (m), see `half_thickness`.
        start, end: Positions of corners before and after the step, in its frame (m), shape
            (n, gdim).
        gap: Gaps at the end (m), infinite for corners far away, shape (n,).
    """
    deepest = -float(gap.min())
    if deepest >= half:
        return f"are {deepest:.3g} m deep in it, beyond half its mean thickness ({half:.3g} m)"
    path = np.linalg.norm(end - start, axis=1)
    rows = np.flatnonzero((path > half) | (gap < -_THROUGH * half))
    if not rows.size:
        return None
    low, first = _along(surface, start[rows], end[rows], half)
    most = np.where(path[rows] > half, _AROUND, _OPPOSITE)
    turned = np.sum(first * surface.probe(end[rows])[1], axis=1) < most
    if not np.any(turned & (low <= -_THROUGH * half)):
        return None
    return f"get through it, whose mean thickness is {2 * half:.3g} m"


def _along(surface: RigidSurface, start: Array, end: Array, half: float) -> tuple[Array, Array]:
    """Least gap along straight paths (m), shape (n,), and the normal at their entry.

    Args:
        surface: The surface.
        start, end: Ends of the paths (m), shape (n, gdim).
        half: Half the thickness of the body (m).
    """
    gap, normal, _ = surface.probe(start)
    least, first = gap.copy(), normal.copy()
    path = np.linalg.norm(end - start, axis=1)
    done = np.zeros(len(path))
    rows = np.arange(len(path))
    for _ in range(_MOST):
        # outside, the gap decreases by no more than the step
        done[rows] += np.maximum(gap, _STRIDE * half)
        rows = rows[done[rows] < path[rows]]
        if not rows.size:
            break
        at = start[rows] + (done[rows] / path[rows])[:, None] * (end[rows] - start[rows])
        gap, normal, _ = surface.probe(at)
        enters = (least[rows] >= 0.0) & (gap < 0.0)
        first[rows[enters]] = normal[enters]
        least[rows] = np.minimum(least[rows], gap)
    gap, normal, _ = surface.probe(end)
    enters = (least >= 0.0) & (gap < 0.0)
    first[enters] = normal[enters]
    return np.minimum(least, gap), first


# Margin around a body in which points are searched, in half-lengths of domains. The motion of the
# body in a step is added.
MARGIN = 4.0


def touchable(contact: RigidContact, layout: CornerLayout, rows: Which) -> Chosen | None:
    """Which of some points can touch at all, or None if all points can."""
    can = layout.marked(rows)
    if contact.tags is None:
        return can
    chosen = contact.chosen(rows)
    return chosen if can is None else chosen & can


def candidates(
    contact: RigidContact, layout: CornerLayout, listed: Rows | None, distance: float
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
