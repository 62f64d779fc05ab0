"""The additional equations of a step with free rigid bodies: the balance of their forces.

The components w of a body's motion, at the level of balance, solve M a(w) = Q(x, w) + F. Here Q are
the forces by contact, and F the loads of the body. Without inertia Q + F = 0. See `Bordered`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.contact.bodyinertia import inertial_forces
from dolfinmpm.contact.bodytangent import add_body_columns, add_body_rows
from dolfinmpm.contact.rigidbodies import RigidBodies
from dolfinmpm.contact.rigidbody import RigidBody
from dolfinmpm.solve.newton import Newton
from dolfinmpm.solve.operator import Operator

__all__ = ["FreeBodies", "Inertial", "check_masses"]

Array = npt.NDArray[np.float64]
# Sums of inertial forces below this share of their terms are small: the terms take their place as
# the size of a balance
_SMALL = 1e-6
# Sums of inertial forces below this share of their terms are rounding (4e-16 at most in 900 steps
# of free flight). No tolerance asks for less.
_ROUNDING = 1e-15


@dataclass(frozen=True)
class Inertial:
    """Accelerations of rigid bodies by their increments in a step in time.

    Attributes:
        factor: Derivative of the acceleration by the increment at the level of balance (1/s²).
        known: Function from velocities and accelerations at the start to the other part of the
            acceleration (m/s²).
        speed: Function from increments of the whole step, velocities and accelerations at the start
            to velocities at the level of balance (m/s).
        speed_factor: Derivative of these velocities by the increment at the level (1/s).
        level: Level of balance, as a share of the step.
        touches_at: Share of the step at which contact forces are found.
        weight: Weight of the contact forces in the balance.
    """

    factor: float
    known: Callable[[Array, Array], Array]
    speed: Callable[[Array, Array, Array], Array]
    speed_factor: float
    level: float
    touches_at: float = 1.0
    weight: float = 1.0


class FreeBodies:
    """The border of a step with free bodies; see `Border`.

    Args:
        bodies: The bodies of the problem.
        tolerance: Bound of the out-of-balance force, as a share of the body's largest force.

    Attributes:
        inertial: Accelerations by increments, or None in quasi-static steps.
        conjugate, settled, tolerance, unmet, sizes, acting: See `Border`.
    """

    unmet = "the forces on a free rigid body were not balanced"
    conjugate, settled = True, True

    def __init__(self, bodies: RigidBodies, tolerance: float):
        self.tolerance = tolerance
        self._all, self._bodies = bodies, bodies.free
        self.inertial: Inertial | None = None
        self.sizes: Array = np.empty(0)
        self.acting = 0.0

    def begin(self, operator: Operator) -> None:
        """See `Border`. Collective."""
        self._operator = operator

    def reset(self) -> None:
        """See `Border`. The prediction resets the bodies."""

    @property
    def _level(self) -> float:
        return 1.0 if self.inertial is None else self.inertial.level

    @property
    def _put_at(self) -> float:
        """Share of the step at which contact forces are found."""
        return 1.0 if self.inertial is None else self.inertial.touches_at

    def predict(self, newton: Newton, operator: Operator) -> tuple[Array, float] | str:
        """The bodies keep their motion, and the points' increments are zero. Collective."""
        for body in self._bodies:
            free = body.free_motion
            free.increment = np.zeros_like(free.increment)
            if self.inertial is not None and free.acceleration is not None:
                guess = body.dt * free.velocity + 0.5 * body.dt**2 * free.acceleration
                free.increment[free.free] = guess[free.free]
            body.put(self._put_at)
        x = np.zeros(operator.here.unknowns.owned)
        return x, operator.residual(x).norm

    def move(self, change: Array) -> None:
        """See `Border`. Collective."""
        at = 0
        for body in self._bodies:
            free = body.free_motion
            n = free.free.size
            free.increment[free.free] += change[at : at + n] / self._level
            at += n
            body.put(self._put_at)

    @property
    def value(self) -> Array:
        """See `Border`: the increments at the level of balance, body by body."""
        free = [body.free_motion for body in self._bodies]
        return np.concatenate([self._level * f.increment[f.free] for f in free])

    def _columns(self, nodal: Array, field: int) -> Array:
        """Entries of nodal forces at the owned unknowns, by columns. Collective.

        Args:
            nodal: Forces of this rank, shape (nodes, components of the field, columns).
            field: The field.
        """
        unknowns = self._operator.here.unknowns
        out = []
        for k in range(nodal.shape[2]):
            forces = unknowns.nodal()
            forces.arrays[field][...] = nodal[:, :, k]
            forces.add_up()
            out.append(unknowns.restrict(forces.arrays))
        return np.column_stack(out) if out else np.zeros((unknowns.owned, 0))

    def _contacts(self, body: RigidBody):
        acting = self._all.acting(self._operator)
        return [c for c in acting if c.contact.body is body]

    def slopes(self, x: Array) -> Array:
        """See `Border`. Collective."""
        found = []
        for body in self._bodies:
            size, free = body.free_motion.increment.size, body.free_motion.free
            total: Any = 0.0
            for contact in self._contacts(body):
                shape = self._operator.increments[contact.field].shape
                nodal = np.zeros((*shape, size))
                add_body_columns(contact, nodal)
                total = total + self._columns(nodal[:, :, free], contact.field)
            found.append(total)
        return np.hstack(found)

    def _norm_of_contact(self) -> float:
        """Norm of the forces of the bodies at the unknowns (N), as last found. Collective.

        They bring the bodies' loads to the points, and are no external forces of the operator.
        """
        unknowns = self._operator.here.unknowns
        forces = unknowns.nodal()
        for body in self._bodies:
            for contact in self._contacts(body):
                contact.internal(forces.arrays)
        forces.add_up()
        found = unknowns.entries(forces.arrays)
        return float(np.sqrt(unknowns.comm.allreduce(float(found @ found), op=MPI.SUM)))

    def gap(self, x: Array) -> tuple[Array, Array, Array]:
        """See `Border`. Collective."""
        gaps, columns, blocks, sizes_of = [], [], [], []
        weight = 1.0 if self.inertial is None else self.inertial.weight
        comm = self._operator.here.unknowns.comm
        self.acting = self._norm_of_contact()
        for body in self._bodies:
            free = body.free_motion
            size, own = free.increment.size, free.free
            by_x: Any = 0.0
            by_y: Array = np.zeros((size, size))
            touching: Array = np.zeros(size)
            for contact in self._contacts(body):
                force, moment = contact.totals()
                touching += weight * np.concatenate([force, moment])
                shape = self._operator.increments[contact.field].shape
                nodal = np.zeros((*shape, size))
                add_body_rows(contact, nodal, by_y)
                by_x = by_x + self._columns(nodal[:, :, own], contact.field)
            by_y = comm.allreduce(by_y, op=MPI.SUM)
            t = body.time + self._level * body.dt
            external = free.external(t)
            out, slope = -touching - external, -by_y
            M = free.inertia(body.start)
            inertia: Array = np.zeros(size)
            least: Array = np.zeros(size)
            if self.inertial is not None:
                assert free.acceleration is not None
                known = self.inertial.known(free.velocity, free.acceleration)
                speed = self.inertial.speed(free.increment, free.velocity, free.acceleration)
                acceleration = self.inertial.factor * self._level * free.increment + known
                inertia, by_motion = inertial_forces(
                    body, self._level, (speed, acceleration),
                    (self.inertial.speed_factor, self.inertial.factor),
                )  # fmt: skip
                out, slope = out + inertia, slope + by_motion
                # the inertial forces of a body with constant velocity cancel
                share = max(_SMALL, _ROUNDING / self.tolerance)
                least = share * np.abs(M) @ np.abs(known)
            d = body.gdim
            scale: Array = np.ones(size)
            for part in (slice(0, d), slice(d, size)):
                sizes = [np.abs(v[part]).max() for v in (touching, external, inertia, least)]
                scale[part] = max(sizes)
            # the reference of moments is at least force times half the body's extent
            reach = max(_size(body), 1e-300)
            scale[d:] = max(scale[d:].max(), scale[:d].max() * reach)
            # a body that only turns has no force
            least_force = max(_SMALL, _ROUNDING / self.tolerance) * scale[d:].max() / reach
            scale[:d] = max(scale[:d].max(), least_force)
            if self.inertial is not None:
                # forces that move it by rounding are rounding: nothing may act on a body at rest
                moved = _ROUNDING / self.tolerance * np.where(np.arange(size) < d, reach, 1.0)
                scale = np.maximum(scale, moved * np.abs(np.diag(slope)))
            scale = np.maximum(scale, 1e-300)
            sizes_of.append(scale[own])
            gaps.append((out / scale)[own])
            columns.append(-by_x / scale[own])
            blocks.append((slope / scale[:, None])[np.ix_(own, own)])
        self.sizes = np.concatenate(sizes_of)
        return np.concatenate(gaps), np.hstack(columns), _block_diagonal(blocks)


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    """A matrix with blocks on its diagonal."""
    ends = np.cumsum([0, *map(len, blocks)])
    whole = np.zeros((ends[-1], ends[-1]))
    for block, begin, end in zip(blocks, ends, ends[1:]):
        whole[begin:end, begin:end] = block
    return whole


def check_masses(bodies: RigidBodies) -> None:
    """Raise ParameterError unless every free body has a mass."""
    for body in bodies.free:
        if body.free_motion.mass is None:
            raise ParameterError(
                f"'{body.name}' is free and has no mass; steps in time need mass = ... (kg) and "
                "inertia = ... (kg m²)"
            )


def _size(body: RigidBody) -> float:
    """Half of the largest extent of a body (m); 1 for an infinite body."""
    surface = body.surface
    if not np.isfinite(surface.low).all():
        return 1.0
    return 0.5 * float(np.max(surface.high - surface.low))
