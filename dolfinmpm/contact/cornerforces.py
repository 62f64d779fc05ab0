"""Forces of a rigid body on corners: by the contact law at the end of a step, or in its mean."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.contactlaw import contact_forces, explicit_reduction
from dolfinmpm.contact.heldcorners import overlap_of
from dolfinmpm.contact.meanforces import mean_forces
from dolfinmpm.contact.surfaces import Probe

if TYPE_CHECKING:
    from dolfinmpm.contact.activerigidcontact import ActiveRigidContact

__all__ = ["set_forces_at_end", "set_mean_forces"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.integer]


def set_forces_at_end(
    active: ActiveRigidContact, c: Rows, at: Array, probe: Probe,
    clinging: npt.NDArray[np.bool_], closing: Array,
) -> None:  # fmt: skip
    """Set the forces on some corners by the contact law, `dolfinmpm.contact.contactlaw`.

    Args:
        active: The contact; its forces are changed.
        c: The corners, shape (n,), n > 0.
        at: Positions of all corners in the frame of the body (m), shape (m, gdim).
        probe: Values of the surface at the given corners.
        clinging: Which of all corners cling to the body even outside it, shape (m,).
        closing: Closing of the gaps in a step (m), shape (n,).
    """
    now, start, law = active.now, active.start, active.contact.law
    k, overlap = start.stiffness[c], overlap_of(active.held, c)
    found = [np.empty((c.size, *own.shape[1:])) for own in now.by_law]
    state = np.empty(c.size, np.int8)
    contact_forces(
        *probe, at[c], active.local_start[c], start.tangential[c],
        start.multiplier[c] - k * overlap, k, law.slip_share * k, law.friction, start.limit[c],
        start.water[c], clinging[c], *found, state,
    )  # fmt: skip
    for own, values in zip(now.by_law, found):
        own[c] = values
    now.gap[c], now.states[c] = probe[0] + overlap, state
    if active.explicit:
        found[0] -= explicit_reduction(now.gap[c], closing, found[2])[:, None] * probe[1]
        now.closed[c] = closing
    now.forces[c] = active.contact.body.pose.directions(found[0])


def set_mean_forces(active: ActiveRigidContact, c: Rows, at: Array, probe: Probe) -> Array:
    """Set the mean forces over the step on some corners; see `dolfinmpm.contact.meanforces`.

    Args:
        active, c, at, probe: See `set_forces_at_end`.

    Returns:
        The rotation of the body in the middle of the step, shape (gdim, gdim).
    """
    now, start, law, body = active.now, active.start, active.contact.law, active.contact.body
    k, path = start.stiffness[c], at[c] - active.local_start[c]
    middle = body.surface.probe(active.local_start[c] + 0.5 * path)[1:]
    found = [np.empty((c.size, *own.shape[1:])) for own in now.by_law]
    loss, state = np.empty(c.size), np.empty(c.size, np.int8)
    overlap = overlap_of(active.held, c)
    mean_forces(
        start.gap[c], *probe[:2], *middle, path, start.tangential[c],
        start.multiplier[c] - k * overlap, k, law.slip_share * k, law.friction, start.limit[c],
        start.water[c], *found, loss, state,
    )  # fmt: skip
    if active.held is not None:
        loss += active.held.loss_in_mean(c, start)
    for own, values in zip(now.by_law, found):
        own[c] = values
    now.gap[c], now.states[c], now.loss[c] = probe[0] + overlap, state, loss
    # the frame of the body in the middle of its rotation
    U, _, Vt = np.linalg.svd(0.5 * (body.start.rotation + body.pose.rotation))
    rotation = np.asarray(U @ Vt)
    now.forces[c] = found[0] @ rotation.T
    return rotation
