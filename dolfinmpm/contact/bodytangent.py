"""Tangent of contact with a free rigid body: its rows and columns in the bordered matrix."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.contactlaw import FREE
from dolfinmpm.contact.corners import Rows

__all__ = ["add_body_columns", "add_body_rows"]

Array = npt.NDArray[np.float64]


def add_body_columns(contact: ActiveRigidContact, out: Array) -> None:
    """Add the derivative of `internal` by the body's motion.

    Args:
        contact: The contact.
        out: Nodal forces by motions (N/m, N/rad), shape (nodes, gdim, components).
    """
    active = np.flatnonzero(contact.states != FREE)
    if active.size:
        by_motion = np.zeros((len(contact.x), *out.shape[1:]))
        by_motion[active] = -contact.tangent_weight * _by_motion(contact, active)
        contact.corners.stencils.add(by_motion, out)


def _by_motion(contact: ActiveRigidContact, active: Rows) -> Array:
    """Derivative of the forces on corners by the body's motion, shape (n, gdim, components)."""
    K, share = contact.derivative(active), _own_share(contact)
    # the motion of the body that the corners must follow
    by_body = K if contact.held is None else K @ contact.held.demanded(active)
    arm = cross_matrix(contact.x[active] - contact.contact.body.pose.centre)
    turned = share * cross_matrix(contact.forces[active])
    by_turn = turned.transpose(0, 2, 1) - by_body @ arm.transpose(0, 2, 1)
    return np.concatenate([-by_body, by_turn], axis=2)


def add_body_rows(contact: ActiveRigidContact, by_x: Array, by_y: Array) -> None:
    """Add the derivatives of force and moment on the body, the share of this rank.

    Args:
        contact: The contact.
        by_x: Derivatives by nodal increments, shape (nodes, gdim, components).
        by_y: Derivatives by the body's own motion, shape (components, components).
    """
    active = np.flatnonzero(contact.states != FREE)
    if active.size == 0:
        return
    K, d, weight = contact.derivative(active), contact.x.shape[1], contact.tangent_weight
    S = cross_matrix(contact.lever()[active])
    S_f = _own_share(contact) * cross_matrix(contact.forces[active])
    to_x = -weight * np.concatenate([K, S @ K - S_f], axis=1)
    whole = np.zeros((len(contact.x), d, by_y.shape[0]))
    whole[active] = to_x.transpose(0, 2, 1)
    contact.corners.stencils.add(whole, by_x)
    A = _by_motion(contact, active)
    to_y = -np.concatenate([A, S @ A], axis=1)
    # the lever arm begins at the centre, which moves
    to_y[:, d:, :d] -= S_f
    by_y += weight * to_y.sum(axis=0)


def _own_share(contact: ActiveRigidContact) -> float:
    """Share of the step's end in the position where forces act."""
    return 1.0 if contact.mean_weights is None else 0.5


def cross_matrix(arms: Array) -> Array:
    """S with S(a) f = a × f, shape (n, 1, 2) of arms in 2D, (n, 3, 3) in 3D."""
    if arms.shape[1] == 2:
        return np.stack([-arms[:, 1], arms[:, 0]], axis=1)[:, None]
    S = np.zeros((len(arms), 3, 3))
    S[:, 0, 1], S[:, 0, 2], S[:, 1, 2] = -arms[:, 2], arms[:, 1], -arms[:, 0]
    S[:, 1, 0], S[:, 2, 0], S[:, 2, 1] = arms[:, 2], -arms[:, 1], arms[:, 0]
    return S
