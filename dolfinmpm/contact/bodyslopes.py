"""How forces of contact change with the motion of a free rigid body, and forces on it with all."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.activecontact import ActiveContact
from dolfinmpm.contact.corners import Rows
from dolfinmpm.contact.freedom import cross_matrix
from dolfinmpm.contact.penalty import FREE

__all__ = ["add_slopes", "add_to_body"]

Array = npt.NDArray[np.float64]


def add_slopes(contact: ActiveContact, out: Array) -> None:
    """Add the derivative of `internal` by the body's motion.

    Args:
        contact: The contact.
        out: Nodal forces by motions (N/m, N/rad), shape (nodes, gdim, components).
    """
    active = np.flatnonzero(contact.states != FREE)
    if active.size:
        by_motion = np.zeros((len(contact.x), *out.shape[1:]))
        by_motion[active] = -contact.slope_weight * _by_motion(contact, active)
        contact.corners.add(by_motion, out)


def _by_motion(contact: ActiveContact, active: Rows) -> Array:
    """Derivative of the forces on corners by the body's motion, shape (n, gdim, components)."""
    K, share = contact.world_slope(active), _own_share(contact)
    arm = cross_matrix(contact.x[active] - contact.contact.body.pose.centre)
    turned = share * cross_matrix(contact.forces[active])
    by_turn = turned.transpose(0, 2, 1) - K @ arm.transpose(0, 2, 1)
    return np.concatenate([-K, by_turn], axis=2)


def add_to_body(contact: ActiveContact, by_x: Array, by_y: Array) -> None:
    """Add the derivatives of force and moment on the body, this rank's share.

    Args:
        contact: The contact.
        by_x: By nodal increments, shape (nodes, gdim, components).
        by_y: By the body's own motion, shape (components, components).
    """
    active = np.flatnonzero(contact.states != FREE)
    if active.size == 0:
        return
    K, d, weight = contact.world_slope(active), contact.x.shape[1], contact.slope_weight
    S = cross_matrix(contact.lever()[active])
    S_f = _own_share(contact) * cross_matrix(contact.forces[active])
    to_x = -weight * np.concatenate([K, S @ K - S_f], axis=1)
    whole = np.zeros((len(contact.x), d, by_y.shape[0]))
    whole[active] = to_x.transpose(0, 2, 1)
    contact.corners.add(whole, by_x)
    A = _by_motion(contact, active)
    to_y = -np.concatenate([A, S @ A], axis=1)
    # the arm is from the centre, which moves
    to_y[:, d:, :d] -= S_f
    by_y += weight * to_y.sum(axis=0)


def _own_share(contact: ActiveContact) -> float:
    """Share of the end in where forces act in the step."""
    return 1.0 if contact.means is None else 0.5
