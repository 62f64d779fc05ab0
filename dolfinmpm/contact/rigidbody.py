"""Rigid bodies: their surface and their motion."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm._platform.argumentchecks import number, shown, vector
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.readonce import ReadOnce
from dolfinmpm.contact.bodymotion import (
    FreeMotion,
    Motion,
    Pose,
    PrescribedMotion,
    first_rate,
    rotation_of,
)
from dolfinmpm.contact.shapesurface import refuse_half, surface_of
from dolfinmpm.contact.surfaces import RigidSurface, middle_of
from dolfinmpm.contact.tunnelling import half_thickness, travelled

__all__ = ["RigidBody", "check_bodies"]

Array = npt.NDArray[np.float64]

_numbers = itertools.count(1)


class RigidBody(ReadOnce):
    """A rigid body that touches material points through `contact`; all ranks know the body.

    The body stands still, or its motion is prescribed. Quasi-static problems prescribe increments,
    problems in time prescribe velocities, and both may prescribe the total motion. The time t is
    the time of the problem (s). In quasi-static problems t is the number of steps since the body
    was made. In a substep the body moves by the same share of its way as the load.

    Args:
        shape: `Plane`, `Wedge`, `Polygon`, `Disc`, `Box` or `TurnedBox` in 2D; `Plane`, `Cone`,
            `Ball`, `Box` or a closed surface mesh in 3D: a file that meshio reads (STL, Gmsh), or
            a `meshio.Mesh`. The mesh has triangles with outward normals.
        increment: Motion of its centre in every step of a quasi-static problem (m), shape (gdim,):
            numbers, or a function of t: step k moves by its mean from t = k − 1 to k. The function
            may jump at the end of a step, as in `lambda t: (0, -0.01) if t < 5 else (0.01, 0)`.
        velocity: Velocity of its centre in a problem in time (m/s), likewise.
        displacement: Displacement of the centre since the body was made (m): a function of t that
            is 0 at t = 0, or a DOLFINx constant. The user sets the constant before a step, and
            substeps scale it like a load. The first step applies a value that the constant holds
            already. Only one of `increment`, `velocity` and `displacement` may be given.
        rotation_increment: Rotation about the centre in every step of a quasi-static problem
            (degrees), counter-clockwise: a number, in 3D a vector of shape (3,); or a function
            of t.
        angular_velocity: Angular velocity in a problem in time (degrees/s), likewise.
        rotation: Rotation since the body was made (degrees): an angle, in 3D a rotation vector. It
            is given in the same ways as `displacement`.
        centre: Centre of rotation (m). By default the middle of the bounding box, or the point of
            a plane. Mass and weight of a free body act there: give its centre of mass, which is
            not the middle of a wedge or of a mesh.
        fillet: Radius (m) that rounds convex edges. So points that slide around an edge meet no
            jump of the normal. The body stays within its shape.
        name: Name of the body in messages, records and files.
        free: Per component of the motion, whether forces decide it: first the directions, then the
            rotations. By default all are free if a mass or a load is given. The other components
            are prescribed. A prescribed velocity of a free component is its initial velocity.
        mass: Mass (kg; kg/m in plane strain). Without a mass, only quasi-static problems can have
            free components.
        inertia: Moment of inertia about the centre (kg m²): a number, in 3D one or three, about
            the axes of the grid in the initial position of the body.
        gravity: Acceleration of gravity (m/s²), shape (gdim,), or a DOLFINx constant.
        force: Force at the centre (N), likewise, or a function of t.
        moment: Moment (N m), a number or in 3D three, likewise.

    Attributes:
        freedom: The free components of the motion, or None.
        surface: The surface in its initial position.
        name: The name.
        pose: The present position and rotation.
        time: The time of the present position (s; steps).

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range. Or a mesh is
            open, inside out, or meets itself at an edge; the message names the place. Or an
            argument is assigned to later.
        OSError: A file cannot be read.

    A disc that goes down by 1 cm per step:

    >>> import dolfinmpm as mpm
    >>> disc = mpm.RigidBody(mpm.Disc((2, 3), 1.0), increment=(0.0, -0.01), name="disc")
    >>> disc.position.tolist(), disc.name
    ([2.0, 3.0], 'disc')
    """

    _attributes = frozenset({"name"})

    def __init__(
        self,
        shape: Any,
        *,
        increment: Sequence[float] | Motion | None = None,
        velocity: Sequence[float] | Motion | None = None,
        displacement: fem.Constant | Motion | None = None,
        rotation_increment: float | Sequence[float] | Motion | None = None,
        angular_velocity: float | Sequence[float] | Motion | None = None,
        rotation: fem.Constant | Motion | None = None,
        centre: Sequence[float] | None = None,
        fillet: float = 0.0,
        name: str | None = None,
        free: Sequence[bool] | None = None,
        mass: float | None = None,
        inertia: float | Sequence[float] | None = None,
        gravity: fem.Constant | Sequence[float] | None = None,
        force: fem.Constant | Sequence[float] | Motion | None = None,
        moment: fem.Constant | float | Sequence[float] | Motion | None = None,
    ):
        number("fillet", fillet, 0.0, math.inf, "m", closed=True)
        self.surface: RigidSurface = surface_of(shape, fillet)
        d = self.surface.gdim
        middle: Array = middle_of(self.surface)
        if centre is not None:
            middle = vector("centre", centre, d)
        self.name = f"body{next(_numbers)}" if name is None else name
        if not isinstance(self.name, str) or not self.name.isidentifier():
            raise ParameterError(f"name = {shown(name)} must be an identifier")
        turns = 1 if d < 3 else 3
        self._shift = PrescribedMotion(
            d, displacement=displacement, velocity=velocity, increment=increment
        )
        self._turn = PrescribedMotion(
            turns, rotation=rotation, angular_velocity=angular_velocity,
            rotation_increment=rotation_increment,
        )  # fmt: skip
        # a rotation vector is not the sum of small rotations
        self._turn.absolute = d == 3 and rotation is not None
        self._turn.unit = math.radians(1.0)
        loads = mass, inertia, gravity, force, moment
        self.freedom: FreeMotion | None = None
        if free is not None or any(load is not None for load in loads):
            rates = [first_rate(motion) for motion in self.prescribed_motions]
            self.freedom = FreeMotion(d, free, *loads, np.concatenate(rates))
            for motion, first in zip(self.prescribed_motions, (0, d)):
                motion.refuse_free(self.freedom.free - first)
        self.pose = self.start = Pose.first(middle)
        self.time, self.dt = 0.0, 0.0
        self.mover: Any = None  # see `RigidBodies.take`
        self._force: Array = np.zeros(d)
        self._moment: Array = np.zeros(turns)

    def require_axis(self) -> None:
        """Raise unless the body can be a body of revolution, with motion along the axis only.

        Raises:
            ParameterError: The body can, or does, move across the axis or turn, or ends there.
        """
        refuse_half(self.surface, self.name)
        across = [c for c in ([] if self.freedom is None else self.freedom.free) if c != 1]
        first = np.concatenate([first_rate(self._shift), first_rate(self._turn)])
        if across or first[0] != 0.0 or first[2] != 0.0:
            raise ParameterError(
                f"'{self.name}' would move across the axis or rotate (first by {first[:2]} m and "
                f"{first[2]:g} rad per step or second, free components {across}); in axisymmetric "
                "problems it moves along the axis only: give increment=(0.0, v), "
                "velocity=(0.0, v) or free=(False, True, False)"
            )

    @property
    def gdim(self) -> int:
        """Dimension of space."""
        return self.surface.gdim

    @property
    def free_motion(self) -> FreeMotion:
        """Its free components; of bodies that have some."""
        assert self.freedom is not None
        return self.freedom

    @property
    def force(self) -> Array:
        """Force of the material points on it (N; N/m in plane strain), shape (gdim,)."""
        return self._force

    @property
    def moment(self) -> Array:
        """Moment of the material points about its centre (N m), shape (1,), in 3D (3,)."""
        return self._moment

    def _called(self) -> str:
        return f"the rigid body '{self.name}'"

    def _instead(self, name: str) -> str:
        """See `ReadOnce`."""
        if name.endswith(("velocity", "increment")):
            return f"make it with a function of time, {name}=lambda t: ..., which steps call"
        if name in ("displacement", "rotation", "force", "moment"):
            return (
                f"make it with a function of time, {name}=lambda t: ..., or with a "
                "dolfinx.fem.Constant, whose value you set"
            )
        if name == "gravity":
            return "make it with a dolfinx.fem.Constant, whose value you set"
        return f"make a new body with {name}=..., and a new problem with a contact with it"

    @functools.cached_property
    def half_thickness(self) -> float:
        """Volume by surface (m): half the thickness of a plate; see `tunnelling.half_thickness`."""
        return half_thickness(self.surface)

    @property
    def position(self) -> Array:
        """Position of its centre (m), shape (gdim,)."""
        return self.pose.centre

    @property
    def angle(self) -> Array:
        """Rotation since it was made (degrees), shape (1,), in 3D (3,), see `Pose`."""
        return np.degrees(self.pose.turn)

    @property
    def prescribed_motions(self) -> tuple[PrescribedMotion, PrescribedMotion]:
        """Its prescribed motions: the motion of the centre, and the rotation."""
        return self._shift, self._turn

    @property
    def loads(self) -> list[fem.Constant]:
        """DOLFINx constants that prescribe its motion or its loads."""
        prescribe = [c.given for c in self.prescribed_motions if isinstance(c.given, fem.Constant)]
        return prescribe + ([] if self.freedom is None else self.freedom.loads)

    def prescribed(self, t: float) -> list[Array]:
        """Values of prescribing functions at a time (s; steps): translation, then rotation."""
        both = [(c, f) for c in self.prescribed_motions for f in (c.given, c.rate) if f is not None]
        return [c.value(f, t) for c, f in both if not isinstance(f, fem.Constant)]

    def check_start(self) -> None:
        """Raise ParameterError if its prescribed motion does not begin at its shape."""
        for motion in self.prescribed_motions:
            motion.check_start()

    # -- for solvers ----------------------------------------------------------

    def begin(self, dt: float) -> None:
        """Begin a step, or a substep, of the length dt (s; steps)."""
        self.dt = dt
        for motion, start in zip(self.prescribed_motions, (self.start.shift, self.start.turn)):
            motion.begin(start, self.time, dt)

    def put(self, share: float) -> None:
        """Move it to its pose at a share of the step."""
        self.pose = self.at(share)

    def at(self, share: float) -> Pose:
        """Its pose at a share of the step."""
        start, t = self.start, self.time
        shift = self._shift.change(start.shift, t, share * self.dt)
        turn = self._turn.change(start.turn, t, share * self.dt)
        if self.freedom is not None:
            d, own = self.gdim, self.freedom.free
            parts = self.freedom.parts(share)
            shift[own[own < d]] = parts[0][own[own < d]]
            turn[own[own >= d] - d] = parts[1][own[own >= d] - d]
        if self._turn.absolute:
            whole = start.turn + turn
            return Pose(start.origin, start.shift + shift, rotation_of(whole, self.gdim), whole)
        return start.moved(shift, turn)

    def press(self, totals: Sequence[tuple[Array, Array]]) -> None:
        """Set the forces at the start of a step: sums of forces and moments (N, N m)."""
        self._force = sum((force for force, _ in totals), np.zeros_like(self._force))
        self._moment = sum((moment for _, moment in totals), np.zeros_like(self._moment))

    def commit(self, force: Array, moment: Array, *, mean: bool = False) -> float:
        """Keep the pose at the end of the step, and the forces on the body.

        Args:
            force, moment: Force and moment of the points on it (N, N m), at the end of the step.
            mean: True if force and moment are means over the step.

        Returns:
            Work that moves the body (J). On prescribed components: against the means of the forces
            before and after the step. On free components: work of the loads.
        """
        before, after = self.start, self.pose
        turned = after.rotation @ before.rotation.T
        # the rotation vector
        W = 0.5 * (turned - turned.T)
        spin = W[1:, 0] if self.gdim == 2 else np.array([W[2, 1], W[0, 2], W[1, 0]])
        sine, cosine = np.linalg.norm(spin), 0.5 * (np.trace(turned) - (self.gdim == 3))
        if sine > 0.0:
            spin = np.arctan2(sine, cosine) / sine * spin
        way = np.concatenate([after.shift - before.shift, spin])
        against = -np.concatenate([force, moment])
        if not mean:
            against = 0.5 * (against - np.concatenate([self._force, self._moment]))
        if self.freedom is not None:
            own = self.freedom.free
            load = self.freedom.external(self.time + 0.5 * self.dt)
            against[own] = load[own]
        self.start, self.time = self.pose, self.time + self.dt
        self._force, self._moment = force, moment
        return float(against @ way)

    def kinetic(self) -> float:
        """Kinetic energy of its free components (J)."""
        free = self.freedom
        if free is None or free.mass is None:
            return 0.0
        v = np.zeros_like(free.velocity)
        v[free.free] = free.velocity[free.free]
        return 0.5 * float(v @ free.inertia(self.start) @ v)

    def travel(self) -> float:
        """Largest motion of its surface in this step (m); of a plane the motion of its centre."""
        return travelled(self.surface, self.start, self.at(1.0))

    def ahead(self, dt: float, count: int, limit: float) -> int:
        """Number of successive steps of equal length in which it moves no further than a limit.

        Motions of free components follow from forces and are not known ahead. A function of the
        user may raise an error at a later time. Then the steps end before this time.

        Args:
            dt: Length of the steps (s).
            count: Largest number of steps. The first step is not checked.
            limit: Largest motion (m).
        """
        kept = self.start, self.pose, self.time
        try:
            for k in range(count):
                self.begin(dt)
                end = self.at(1.0)
                if self.freedom is not None:
                    self.freedom.external(self.time)
                if k and travelled(self.surface, self.start, end) > limit:
                    return k
                self.start, self.time = end, self.time + dt
        except Exception:
            if not k:
                raise
            return k
        finally:
            self.start, self.pose, self.time = kept
        return count

    def record(self) -> dict[str, list[float]]:
        """Position, angle, force and moment for the record of a step."""
        parts = {
            "position": self.position, "angle": self.angle, "force": self.force,
            "moment": self.moment,
        }  # fmt: skip
        return {name: [float(v) for v in values] for name, values in parts.items()}

    def state(self) -> Array:
        """The state for a checkpoint, as one row of numbers."""
        pose = self.start
        parts = [pose.shift, pose.rotation.ravel(), pose.turn, self.force, self.moment]
        free = self.freedom
        if free is not None:
            parts += [free.velocity, np.zeros(free.velocity.size)]
            if free.acceleration is not None:
                parts[-1] = free.acceleration
            parts.append(np.array([float(free.acceleration is not None)]))
        return np.concatenate([np.array([self.time]), *parts])

    def set_state(self, row: Array) -> None:
        """Restore a state returned by `state`."""
        d, turns = self.gdim, len(self.moment)
        sizes = np.cumsum([1, d, d * d, turns, d])
        sizes = np.append(sizes, sizes[-1] + turns)
        time, shift, rotation, turn, force, moment, rest = np.split(row, sizes)
        self.start = Pose(self.start.origin, shift, rotation.reshape(d, d), turn)
        self.pose, self.time = self.start, float(time[0])
        self._force, self._moment = force, moment
        if self.freedom is not None:
            n = self.freedom.velocity.size
            self.freedom.velocity = rest[:n].copy()
            self.freedom.acceleration = rest[n : 2 * n].copy() if rest[2 * n] else None

    def outline(self, low: Array, high: Array) -> Array:
        """Facets of its picture in a box, shape (facets, gdim, gdim); see `RigidSurface.outline`.

        Args:
            low, high: Corners of the box (m), shape (gdim,).
        """
        return self.pose.forth(self.surface.outline(low, high))


def check_bodies(bodies: Any, gdim: int) -> None:
    """Raise ParameterError unless `bodies` are rigid bodies in space of the dimension gdim."""
    if not isinstance(bodies, (list, tuple)):
        raise ParameterError(f"bodies = {shown(bodies)} must be a list of mpm.RigidBody")
    for body in bodies:
        if not isinstance(body, RigidBody) or body.gdim != gdim:
            raise ParameterError(f"bodies holds {shown(body)}, no mpm.RigidBody in {gdim}D")
