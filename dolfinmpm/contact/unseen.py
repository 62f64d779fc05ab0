"""Points that have got into a rigid body unseen, or through it, in a step."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.contact.candidates import touchable
from dolfinmpm.contact.corners import ALL
from dolfinmpm.contact.passing import entered, passes, suspected, too_far, travelled, within

__all__ = ["missed", "passed"]

Array = npt.NDArray[np.float64]


def missed(contact: Any, x: Array, before: Array | None = None) -> bool:
    """Whether points that were not looked at have got into the body. Collective.

    Args:
        contact: The contact, active in a step.
        x: Positions of all points at the end of the step (m), shape (points, gdim).
        before: Those at its start, where they may have gone through the body.
    """
    body = contact.contact.body
    way = 0.0 if before is None else float(np.abs(x - before).max(initial=0.0))
    far = within([body.pose], body.surface, x, way)
    far[contact.among] = False
    can = touchable(contact.contact, contact.sites, ALL)
    if can is not None:
        far &= can
    rows = np.flatnonzero(far)
    ends = x if before is None else before
    start, end = body.start.back(ends[rows]), body.pose.back(x[rows])
    inside = bool(rows.size) and entered(body.surface, body.half_thickness, start, end).any()
    return contact.contact.points.comm.allreduce(bool(inside), op=MPI.LOR)


def passed(contact: Any) -> str | None:
    """Why the body, where it has been put, and points of this rank have passed each other."""
    body = contact.contact.body
    if body.freedom is not None:
        # what prescribes the others has been asked before
        way = travelled(body.surface, body.start, body.pose)
        fault = too_far(body, way, contact.contact.limit)
        if fault is not None:
            return fault
    how = _passes(contact)
    if how is None:
        return None
    return (
        f"points that touch '{body.name}' {how}: take smaller steps or "
        "a larger penalty, or bound the penetration"
    )


def _passes(contact: Any) -> str | None:
    """How corners of this rank pass through the body instead of touching it, or None."""
    body = contact.contact.body
    half = body.half_thickness
    if not len(contact.x) or not suspected(half, contact.found.gap, contact.found.way):
        return None
    return passes(body.surface, half, contact.place, body.pose.back(contact.x), contact.found.gap)
