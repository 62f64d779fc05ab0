"""Inertia of free rigid bodies; in 3D Euler's equations in the axes of the grid.

The inertia J = R J0 Rᵀ turns with the body. The moment m changes the angular momentum Jω:

    J α + ω × Jω = m.

Implicit steps balance it at their level, with the pose and the velocity there, and so in second
order. Explicit steps change Jω by the moment: they keep the angular momentum of a body that no
moment acts on. (Simo & Wong 1991, doi 10.1002/nme.1620310103.)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.bodymotion import rotation_of
from dolfinmpm.contact.rigidbody import RigidBody

__all__ = ["accelerate", "find_acceleration", "inertial_forces", "skew"]

Array = npt.NDArray[np.float64]

# Iterations for the angular velocity of a momentum; each multiplies the error by some |ω| Δt/2
_ITERATIONS, _ROUNDING = 50, 1e-15


def skew(v: Array) -> Array:
    """Matrix of the product v × w, shape (3, 3), of a vector v, shape (3,)."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def inertial_forces(
    body: RigidBody, share: float, motion: tuple[Array, Array], slopes: tuple[float, float]
) -> tuple[Array, Array]:
    """Inertial forces of a free body at a share of a step, and their derivative.

    Args:
        body: The body.
        share: The share of the step.
        motion: Velocities (m/s, rad/s) and accelerations (m/s², rad/s²) there, shape (components,).
            Prescribed components have those of their motion instead.
        slopes: Derivatives of velocities (1/s) and accelerations (1/s²) by the increments up to
            there.

    Returns:
        Forces and moments (N, N m), shape (components,), and their derivatives by the increments,
        shape (components, components).
    """
    free = body.free_motion
    V, A = (np.where(_flags(body), values, 0.0) for values in motion)
    pose = body.at(share)
    M = free.inertia(pose)
    if body.gdim == 2:
        return M @ A, slopes[1] * M
    spin, acceleration = _held_spin(body, share, V[3:], A[3:])
    forces, slope = M @ A, slopes[1] * M
    J, S, momentum = M[3:, 3:], skew(spin), M[3:, 3:] @ spin
    forces[3:] = J @ acceleration + np.cross(spin, momentum)
    by_pose = J @ skew(acceleration) - skew(J @ acceleration) + S @ (J @ S - skew(momentum))
    # a change of a rotation vector turns the body otherwise than by itself, in second order
    by_pose = by_pose @ (np.eye(3) + 0.5 * skew(free.parts(share)[1]))
    slope[3:, 3:] += slopes[0] * (S @ J - skew(momentum)) + by_pose
    return forces, slope


def find_acceleration(body: RigidBody, force: Array, afresh: bool) -> None:
    """Find the acceleration of a free body at the start of a step if it is unknown.

    Args:
        body: The body, at the start of the step.
        force: Force and moment of contact (N, N m), shape (components,).
        afresh: Whether a load jumps, so that the acceleration differs from the end of the last
            step.
    """
    free = body.free_motion
    if free.mass is None or (free.acceleration is not None and not afresh):
        return
    size, own = free.increment.size, free.free
    known: Array = np.zeros(size)
    if body.gdim == 3:
        spin, acceleration = _held_spin(body, 0.0, free.velocity[3:], np.zeros(3))
        J = free.inertia(body.start)[3:, 3:]
        known[3:] = J @ acceleration + np.cross(spin, J @ spin)
    out = free.external(body.time) + force - known
    free.acceleration = np.zeros(size)
    free.acceleration[own] = np.linalg.solve(free.inertia(body.start)[np.ix_(own, own)], out[own])


def accelerate(body: RigidBody, force: Array, kick: float) -> None:
    """Compute velocity and motion of a free body in an explicit step from the force on it.

    Args:
        body: The body.
        force: Force and moment at the start of the step (N, N m), shape (components,).
        kick: Time during which they act (s).
    """
    free = body.free_motion
    before = free.velocity.copy()
    find_acceleration(body, force, True)
    assert free.acceleration is not None
    own = free.free
    free.velocity[own] += kick * free.acceleration[own]
    if body.gdim == 3 and free.mass is not None and np.any(own >= 3):
        moment = (force + free.external(body.time))[3:]
        free.velocity[3:] = _turned_on(body, before[3:], kick * moment, 2.0 * kick - body.dt)
    free.increment = np.zeros_like(free.velocity)
    free.increment[own] = body.dt * free.velocity[own]


def _turned_on(body: RigidBody, spin: Array, impulse: Array, last: float) -> Array:
    """Angular velocity in the middle of an explicit step (rad/s), shape (3,).

    Args:
        body: The body.
        spin: Angular velocity in the middle of the last step (rad/s), likewise.
        impulse: Moment times the time of its action (N m s), likewise.
        last: Length of the last step (s); 0 at the start of a run.
    """
    free = body.free_motion

    def inertia(turn: Array) -> Array:
        rotation = rotation_of(turn, 3) @ body.start.rotation
        return free.inertia(replace(body.start, rotation=rotation))[3:, 3:]

    own = _flags(body)[3:]
    held = _prescribed_rates(body, 0.5)[0]
    if last <= 0.0:
        spin = np.where(own, spin, held)
    momentum = inertia(-0.5 * last * spin) @ spin + impulse
    found = np.where(own, spin, held)
    for _ in range(_ITERATIONS):
        J, former = inertia(0.5 * body.dt * found), found.copy()
        rest = momentum - J[:, ~own] @ held[~own]
        found[own] = np.linalg.solve(J[np.ix_(own, own)], rest[own])
        if np.abs(found - former).max() <= _ROUNDING * np.abs(found).max():
            break
    return found


def _flags(body: RigidBody) -> npt.NDArray[np.bool_]:
    """Whether each component is free, shape (components,)."""
    free = body.free_motion
    flags = np.zeros(free.velocity.size, bool)
    flags[free.free] = True
    return flags


def _held_spin(
    body: RigidBody, share: float, spin: Array, acceleration: Array
) -> tuple[Array, Array]:
    """Angular velocity and acceleration, with those of prescribed motions where these hold."""
    own = _flags(body)[3:]
    if own.all():
        return spin, acceleration
    rates = _prescribed_rates(body, share)
    return np.where(own, spin, rates[0]), np.where(own, acceleration, rates[1])


def _prescribed_rates(body: RigidBody, share: float) -> tuple[Array, Array]:
    """Prescribed angular velocity (rad/s) and acceleration (rad/s²) at a share of the step."""
    turn, start, dt = body.prescribed_motions[1], body.start.turn, body.dt
    # the cubic polynomial through four places
    at = np.array([1.0, 2.0, 3.0]) / 3.0
    moved = [turn.change(start, body.time, s * dt) for s in at]
    a, b, c = np.linalg.solve(np.column_stack([at, at**2, at**3]), moved)
    return (a + 2.0 * share * b + 3.0 * share**2 * c) / dt, (2.0 * b + 6.0 * share * c) / dt**2
