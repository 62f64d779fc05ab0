"""Warnings of a contact with a rigid body, before its first step and after each step."""

from __future__ import annotations

import itertools
import math
import weakref
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import (
    IdleConditionWarning,
    OverlapWarning,
    SmallBodyWarning,
    warn,
)
from dolfinmpm.body.location import bounds
from dolfinmpm.contact.surfaces import HalfSpace

if TYPE_CHECKING:
    from dolfinmpm.contact.rigidcontact import RigidContact

__all__ = ["warn_at_start", "warn_of_bare_points"]

Array = npt.NDArray[np.float64]

# Depth of a corner within a body at the start that is told, and distance of the point from the body
# that is not told with it, both over the distance of a point from its corners. Points that are
# filled beside a body have corners within it: most of them less deep, and of a triangle that the
# surface cuts off a domain 0.53, where the point is 0.47 away (a corner of a cube: 0.70 and 0.30).
_OVERLAP = 0.5
_AWAY = 0.25
# Distance of a body from the grid, in lengths of the grid, that a wrong unit makes: mm are 1000
_FAR = 30.0
# Part of a width that is rounding
_ROUNDING = 1e-9
# Contacts whose points within the body have been told
_told: weakref.WeakSet[RigidContact] = weakref.WeakSet()


def warn_at_start(active: Any) -> None:
    """Warn of a body that begins far away, is too small, or overlaps corners. Collective.

    Args:
        active: The contact in the first step of its body.
    """
    active.contact.begun = True
    _warn_of_distance(active.contact)
    _warn_of_size(active.contact)
    _warn_of_overlap(active)


def warn_of_bare_points(contact: RigidContact, contacts: Sequence[RigidContact]) -> None:
    """Warn once where points without a face of the contact's surface are in the body. Collective.

    Nothing pushes them out: soil that flows brings points to the body which had no face at first.

    Args:
        contact: The contact.
        contacts: All contacts of the form.
    """
    if contact.surface is None or contact in _told:
        return
    points, body = contact.points, contact.body
    bare = _chosen(contact)
    for one in contacts:
        if one.body is body and one.points is points:
            touches = _chosen(one)
            if one.surface is not None:
                touches &= points[one.surface.area.name].any(axis=1)
            bare &= ~touches
    half = points["l"].max(axis=1)
    at = body.pose.back(points["x"])
    bare &= np.all((at > body.surface.low) & (at < body.surface.high), axis=1)
    rows = np.flatnonzero(bare)
    gap = body.surface.probe(at[rows])[0]
    deep = gap < -half[rows]
    largest = points.comm.allreduce(float(-gap[deep].min(initial=0.0)), op=MPI.MAX)
    count = points.comm.allreduce(int(deep.sum()), op=MPI.SUM)
    if count:
        _told.add(contact)
        warn(
            points.comm,
            f"{count} points without a face of '{contact.surface.name}' are within '{body.name}', "
            f"by up to {largest:.3g} m, and nothing pushes them out, because faces of the surface "
            "alone touch. Leave out surface= where soil flows, or give a surface along all that "
            "touches",
            OverlapWarning,
        )


def _chosen(contact: RigidContact) -> npt.NDArray[np.bool_]:
    """Points with the tags of a contact, shape (points,)."""
    return np.ones(len(contact.points), bool) if contact.tags is None else contact.chosen()


def _warn_of_overlap(active: Any) -> None:
    """Warn where corners of points begin within the body. Collective."""
    contact, layout = active.contact, active.layout
    gap, rows = active.start.gap, active.corners.rows
    deep = np.flatnonzero(gap < -_OVERLAP * layout.reach(rows))
    centres = contact.body.start.back(contact.points["x"][rows[deep]])
    away = contact.body.surface.probe(centres)[0] > _AWAY * layout.reach(rows[deep])
    deep = deep[~away]
    found = np.array([-gap[deep].min(initial=0.0), np.unique(rows[deep]).size])
    largest = contact.points.comm.allreduce(found[0], op=MPI.MAX)
    count = contact.points.comm.allreduce(int(found[1]), op=MPI.SUM)
    if count:
        warn(
            contact.points.comm,
            f"corners of {count} points begin within '{contact.body.name}', by up to "
            f"{largest:.3g} m: the contact pushes them out from the first step on. Fill the body "
            "beside it, or move the rigid body by that much",
            OverlapWarning,
        )


def _warn_of_distance(contact: RigidContact) -> None:
    """Warn of a body that begins so far from the grid that its unit of length is another one."""
    body, (low, high) = contact.body, bounds(contact.points.grid)
    at, surface, length = body.start.shift, body.surface, float((high - low).max())
    if isinstance(surface, HalfSpace):
        # it has no ends, and may have turned: the nearest corner of the grid tells
        corners = np.array(list(itertools.product(*zip(low, high))))
        gaps = surface.probe(body.start.back(corners))[0].min(keepdims=True)
    else:
        gaps = np.maximum(surface.low + at - high, low - surface.high - at)
    distance = float(np.linalg.norm(np.maximum(gaps, 0.0)))
    if distance > _FAR * length:
        warn(
            contact.points.comm,
            f"'{body.name}' begins {distance:.4g} m outside the grid, which is {length:.4g} m "
            "long, and touches nothing there: check its place, and the unit of its lengths (m)",
            IdleConditionWarning,
        )


def _warn_of_size(contact: RigidContact) -> None:
    """Warn of a body that fits between the corners of a domain, as a needle does. Collective."""
    body, points = contact.body, contact.points
    sizes = np.sort(body.surface.high - body.surface.low)
    # the longer side in 2D, the middle one in 3D: a needle is longer than it is wide
    width = float(sizes[1])
    own = points["l0"] if contact.tags is None else points["l0"][contact.chosen()]
    side = 2.0 * points.comm.allreduce(float(own.min(initial=math.inf)), op=MPI.MIN)
    if width < (1.0 - _ROUNDING) * side < math.inf:
        warn(
            points.comm,
            f"'{body.name}' is {width:.3g} m wide, and the domains of material points are "
            f"{side:.3g} m wide: it passes between their corners. Take smaller cells, more points "
            "per cell or a larger body",
            SmallBodyWarning,
        )
