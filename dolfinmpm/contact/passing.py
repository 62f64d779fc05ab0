"""What a step may not do to a rigid body and what touches it: let one pass through the other.

A corner that touches is pushed out of a body along the normal of the nearest face. If it gets
beyond the middle of the body, it is pushed out on the far side, and nothing tells of it any more.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.facets import Facets, facet_normals
from dolfinmpm.contact.pose import Pose
from dolfinmpm.contact.revolution import Revolved
from dolfinmpm.contact.surfaces import RigidSurface, Round, Rounded

__all__ = [
    "entered",
    "half_thickness",
    "limit_of",
    "passes",
    "suspected",
    "too_far",
    "travelled",
    "within",
]

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]

# Steps along a path within a body, by half its thickness, and how deep it leads through the body
# at least; paths around a tip are less deep
_STRIDE, _THROUGH = 0.25, 0.25
# Cosine of the angle between the normals of opposite faces at most: for short paths, and for paths
# longer than half the thickness. Faces that meet at an edge of 45° or more are beside each other:
# at whatever depth a corner comes from one to the other, smaller steps do not change it
_OPPOSITE, _AROUND = -math.sqrt(0.5), -1e-6
# Strides along a path at most
_MOST = 10_000
# Which corner of a box is where in each direction, by dimension
_UPPER = {d: np.indices((2,) * d).reshape(d, -1).T == 1 for d in (2, 3)}


def half_thickness(surface: RigidSurface) -> float:
    """Volume of a body by its surface (m): half the thickness of a plate.

    Of a convex body it is at most the radius of the largest ball within it. Of a body of revolution
    it is that of the section, of one without end infinite.
    """
    if isinstance(surface, Round):
        return surface.radius / surface.gdim
    if isinstance(surface, Rounded):
        return half_thickness(surface.core) + surface.radius
    if isinstance(surface, Revolved):
        return half_thickness(surface.profile)
    if not isinstance(surface, Facets):
        return math.inf
    normals = facet_normals(surface.x, surface.facets)
    # of triangles twice the area
    areas = normals / (surface.gdim - 1)
    middles = surface.x[surface.facets].mean(axis=1) - surface.low
    volume = float(np.sum(middles * areas)) / surface.gdim
    return volume / float(np.linalg.norm(areas, axis=1).sum())


def _box_corners(low: Array, high: Array) -> Array:
    """Corners of a box (m), shape (2^gdim, gdim)."""
    return np.where(_UPPER[len(low)], high, low)


def travelled(surface: RigidSurface, start: Pose, end: Pose) -> float:
    """How far a body's parts are apart in two poses at most; of one without end its centre (m)."""
    if not np.isfinite(surface.low).all():
        return float(np.linalg.norm(end.shift - start.shift))
    corners = _box_corners(surface.low, surface.high)
    return float(np.linalg.norm(end.forth(corners) - start.forth(corners), axis=1).max())


def limit_of(body: Any, cell: float) -> float:
    """How far a body may go at once (m): no further than a cell, or half its own thickness."""
    return min(cell, body.half_thickness)


def too_far(body: Any, travel: float, cell: float) -> str | None:
    """Why a body may not go so far (m) at once, or None.

    Args:
        body: The rigid body.
        travel: How far it goes (m).
        cell: Smallest size of a cell (m).
    """
    limit = limit_of(body, cell)
    if travel <= limit * (1 + 1e-9):
        return None
    what = "a cell" if limit == cell else "half its mean thickness"
    return f"'{body.name}' moves {travel:.3g} m at once, more than {what} ({limit:.3g} m)"


def within(poses: list[Pose], surface: RigidSurface, x: Array, reach: Array | float) -> Chosen:
    """Which positions are within a reach of a box around a surface, in any pose.

    Args:
        poses: The poses.
        surface: The surface; all are near to one that has no end.
        x: Positions (m), shape (n, gdim).
        reach: How far (m), a number or shape (n, 1).
    """
    if not np.isfinite(surface.low).all():
        return np.ones(len(x), bool)
    corners = np.concatenate([p.forth(_box_corners(surface.low, surface.high)) for p in poses])
    first, last = corners.min(axis=0), corners.max(axis=0)
    return np.all((x + reach >= first) & (x - reach <= last), axis=1)


def entered(surface: RigidSurface, half: float, start: Array, end: Array) -> Chosen:
    """Which straight paths get into a body, shape (n,).

    Args:
        surface: Its surface.
        half: Half its thickness (m), see `half_thickness`.
        start, end: Ends of the paths in its frame (m), shape (n, gdim).
    """
    found = surface.probe(end)[0] < 0.0
    if math.isinf(half):
        return found
    # those that end beside it may have gone through it
    low, high = np.minimum(start, end), np.maximum(start, end)
    rows = np.flatnonzero(~found & np.all((high >= surface.low) & (low <= surface.high), axis=1))
    rows = rows[np.linalg.norm(end[rows] - start[rows], axis=1) > half]
    found[rows] = _along(surface, start[rows], end[rows], half)[0] < 0.0
    return found


def suspected(half: float, gap: Array, way: Array) -> bool:
    """Whether corners may have passed through a body at all; at least one corner.

    Args:
        half: Half its thickness (m).
        gap: How far outside they are (m), infinite where they are far, shape (n,).
        way: How far they have gone towards the body at most (m), likewise.
    """
    return bool(gap.min() < -_THROUGH * half or way.max() > half)


def passes(surface: RigidSurface, half: float, start: Array, end: Array, gap: Array) -> str | None:
    """How corners pass through a body instead of touching it, or None.

    Args:
        surface: Its surface.
        half: Half its thickness (m), see `half_thickness`.
        start, end: Where corners were and are in its frame (m), shape (n, gdim).
        gap: How far outside they are in the end (m), infinite where they are far, shape (n,).
    """
    deepest = -float(gap.min())
    if deepest >= half:
        return f"are {deepest:.3g} m deep in it, beyond half its mean thickness ({half:.3g} m)"
    way = np.linalg.norm(end - start, axis=1)
    rows = np.flatnonzero((way > half) | (gap < -_THROUGH * half))
    if not rows.size:
        return None
    low, first = _along(surface, start[rows], end[rows], half)
    most = np.where(way[rows] > half, _AROUND, _OPPOSITE)
    turned = np.sum(first * surface.probe(end[rows])[1], axis=1) < most
    if not np.any(turned & (low <= -_THROUGH * half)):
        return None
    return f"get through it, whose mean thickness is {2 * half:.3g} m"


def _along(surface: RigidSurface, start: Array, end: Array, half: float) -> tuple[Array, Array]:
    """Least gap along straight paths (m), shape (n,), and the normal where they get into the body.

    Args:
        surface: The surface.
        start, end: Ends of the paths (m), shape (n, gdim).
        half: Half the thickness of the body (m).
    """
    gap, normal, _ = surface.probe(start)
    least, first = gap.copy(), normal.copy()
    way = np.linalg.norm(end - start, axis=1)
    done = np.zeros(len(way))
    rows = np.arange(len(way))
    for _ in range(_MOST):
        # what is outside comes no nearer than it goes
        done[rows] += np.maximum(gap, _STRIDE * half)
        rows = rows[done[rows] < way[rows]]
        if not rows.size:
            break
        at = start[rows] + (done[rows] / way[rows])[:, None] * (end[rows] - start[rows])
        gap, normal, _ = surface.probe(at)
        enters = (least[rows] >= 0.0) & (gap < 0.0)
        first[rows[enters]] = normal[enters]
        least[rows] = np.minimum(least[rows], gap)
    gap, normal, _ = surface.probe(end)
    enters = (least >= 0.0) & (gap < 0.0)
    first[enters] = normal[enters]
    return np.minimum(least, gap), first
