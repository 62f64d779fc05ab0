"""Rigid bodies: a surface, and how it moves."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm._platform.checks import number, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.given import ReadOnce
from dolfinmpm.contact.course import Course, Motion, first_rate
from dolfinmpm.contact.freedom import Freedom, vector
from dolfinmpm.contact.making import surface_of
from dolfinmpm.contact.passing import half_thickness, travelled
from dolfinmpm.contact.pose import Pose, rotation_of
from dolfinmpm.contact.surfaces import RigidSurface

__all__ = ["RigidBody", "check_bodies"]

Array = npt.NDArray[np.float64]

_numbers = itertools.count(1)


class RigidBody(ReadOnce):
    """A rigid body that touches material points through `contact`; all ranks know it.

    It stands still, or its motion is prescribed: by increments in quasi-static problems, by
    velocities in problems in time, or in total in both. Time t is that of the problem in s, or for
    quasi-static problems the number of steps since the body was made. In parts of a step the body
    goes that part of the way.

    Args:
        shape: `Plane`, `Wedge`, `Polygon`, `Disc`, `Box` or `TurnedBox` in 2D; `Plane`, `Cone`,
            `Ball`, `Box` or a closed surface mesh in 3D: a file that meshio reads (STL, Gmsh), or
            a `meshio.Mesh`, of triangles whose normals point out of the body.
        increment: Motion of its centre in every step of a quasi-static problem (m), shape (gdim,):
            numbers, or a function of t.
        velocity: Velocity of its centre in a problem in time (m/s), likewise.
        displacement: Where the centre has got to since the body was made (m): a function of t that
            is 0 at t = 0, or a DOLFINx constant, which steps set and solvers scale like a load;
            the first step brings about what the constant holds already. One of `increment`,
            `velocity` and `displacement` may be given.
        rotation_increment: Rotation about the centre in every step of a quasi-static problem
            (degrees), counter-clockwise: a number, in 3D a vector of shape (3,); or a function
            of t.
        angular_velocity: Its velocity in a problem in time (degrees/s), likewise.
        rotation: How far the body has turned since it was made (degrees), given as `displacement`
            is: an angle, in 3D a rotation vector.
        centre: What it turns about (m); by default the middle of a box around it, or a plane's
            point.
        fillet: Radius (m) by which convex edges are rounded, so that what slides around them meets
            no jump of the normal. The body stays within its shape.
        name: What messages, records and files call it.
        free: Which components of its motion forces decide, the directions first, then the
            rotations; all if only a mass or a load is given. The other ones are prescribed.
            Velocities of free ones are those at first.
        mass: Its mass (kg; kg/m in plane strain), without which only quasi-static problems can
            have it free.
        inertia: Moment of inertia about its centre (kg m²): a number, in 3D one or three, about
            the axes of the grid as the body is at first.
        gravity: Acceleration (m/s²) that gives it weight, shape (gdim,), or a DOLFINx constant.
        force: Force that acts at its centre (N), likewise, or a function of t.
        moment: Moment (N m), a number or in 3D three, likewise.

    Attributes:
        freedom: What is free of its motion, or None.
        surface: Its surface, where it was at first.
        name: Its name.
        pose: Where it is.
        time: Time that it is of (s; steps).

    Raises:
        ParameterError: An argument is not what it may be, or a mesh is open, inside out, or meets
            itself at an edge; the message tells where. Or an argument is assigned to later.
        OSError: A file cannot be read.
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
        middle: Array = _middle(self.surface)
        if centre is not None:
            middle = vector("centre", centre, d)
        self.name = f"body{next(_numbers)}" if name is None else name
        if not isinstance(self.name, str) or not self.name.isidentifier():
            raise ParameterError(f"name = {shown(name)} must be an identifier")
        turns = 1 if d < 3 else 3
        self._shift = Course(d, displacement=displacement, velocity=velocity, increment=increment)
        self._turn = Course(
            turns, rotation=rotation, angular_velocity=angular_velocity,
            rotation_increment=rotation_increment,
        )  # fmt: skip
        # a rotation vector is not the sum of small ones
        self._turn.absolute = d == 3 and rotation is not None
        self._turn.unit = math.radians(1.0)
        loads = mass, inertia, gravity, force, moment
        self.freedom: Freedom | None = None
        if free is not None or any(load is not None for load in loads):
            rates = [first_rate(course) for course in self.courses]
            self.freedom = Freedom(d, free, *loads, np.concatenate(rates))
        self.pose = self.start = Pose.first(middle)
        self.time, self.dt = 0.0, 0.0
        self.mover: Any = None  # see `Bodies.take`
        self._force: Array = np.zeros(d)
        self._moment: Array = np.zeros(turns)

    def require_axis(self) -> None:
        """Raise unless it can be the meridian of a body of revolution, which moves along the axis.

        Raises:
            ParameterError: It is free to go across the axis x[0] = 0 or to turn, or begins to.
        """
        across = [c for c in ([] if self.freedom is None else self.freedom.free) if c != 1]
        first = np.concatenate([first_rate(self._shift), first_rate(self._turn)])
        if across or first[0] != 0.0 or first[2] != 0.0:
            raise ParameterError(
                f"'{self.name}' would go across the axis or turn (at first by {first[:2]} m and "
                f"{first[2]:g} rad per step or second, free components {across}), and against a "
                "body of revolution it moves along the axis alone: give increment=(0.0, v), "
                "velocity=(0.0, v) or free=(False, True, False)"
            )

    @property
    def gdim(self) -> int:
        """Dimension of space."""
        return self.surface.gdim

    @property
    def force(self) -> Array:
        """Force of the material points on it (N; N/m in plane strain), shape (gdim,)."""
        return self._force

    @property
    def moment(self) -> Array:
        """Their moment about its centre (N m), shape (1,), in 3D (3,)."""
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
        """Volume by surface (m): half the thickness of a plate; see `passing.half_thickness`."""
        return half_thickness(self.surface)

    @property
    def position(self) -> Array:
        """Where its centre is (m), shape (gdim,)."""
        return self.pose.centre

    @property
    def angle(self) -> Array:
        """How far it has turned (degrees), shape (1,), in 3D (3,), see `Pose`."""
        return np.degrees(self.pose.turn)

    @property
    def courses(self) -> tuple[Course, Course]:
        """Its prescribed motions, those of the centre and those about it."""
        return self._shift, self._turn

    @property
    def loads(self) -> list[fem.Constant]:
        """DOLFINx constants that prescribe its motion or load it."""
        prescribe = [c.given for c in self.courses if isinstance(c.given, fem.Constant)]
        return prescribe + ([] if self.freedom is None else self.freedom.loads)

    def prescribed(self, t: float) -> list[Array]:
        """What functions prescribe at a time (s; steps): places or rates, shift before turn."""
        both = [(c, f) for c in self.courses for f in (c.given, c.rate) if f is not None]
        return [c.value(f, t) for c, f in both if not isinstance(f, fem.Constant)]

    def check_start(self) -> None:
        """Raise ParameterError where it would not begin where its shape is."""
        for course in self.courses:
            course.check_start()

    # -- what solvers do with it ----------------------------------------------

    def begin(self, dt: float) -> None:
        """Begin a step, or a part of one, of that length (s; steps)."""
        self.dt = dt

    def put(self, share: float) -> None:
        """Put it where it is at that share of the step."""
        self.pose = self.at(share)

    def at(self, share: float) -> Pose:
        """Where it is at that share of the step."""
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
            pose = Pose(start.origin, start.shift + shift, rotation_of(whole, self.gdim), whole)
            return pose
        return start.moved(shift, turn)

    def push(self, force: Array, kick: float) -> None:
        """Take velocity and motion of an explicit step from the force on it (N, N m).

        Args:
            force: Forces and moments.
            kick: For how long they act (s).
        """
        free = self.freedom
        assert free is not None
        free.begin(self.start, force, self.time, True)
        assert free.acceleration is not None
        own = free.free
        free.velocity[own] += kick * free.acceleration[own]
        free.increment = np.zeros_like(free.velocity)
        free.increment[own] = self.dt * free.velocity[own]

    def commit(self, force: Array, moment: Array, *, mean: bool = False) -> float:
        """Take where it has been put for where it is, and what acts on it.

        Args:
            force, moment: Of the points on it (N, N m), at the end of the step.
            mean: Whether these are means over the step.

        Returns:
            Work of what moves it (J): on what is prescribed of it, against the means of the forces
            before and after, and of its loads on what is free.
        """
        before, after = self.start, self.pose
        turned = after.rotation @ before.rotation.T
        # of a small rotation
        W = 0.5 * (turned - turned.T)
        spin = W[1:, 0] if self.gdim == 2 else np.array([W[2, 1], W[0, 2], W[1, 0]])
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
        """Kinetic energy of what is free of it (J)."""
        free = self.freedom
        if free is None or free.mass is None:
            return 0.0
        v = np.zeros_like(free.velocity)
        v[free.free] = free.velocity[free.free]
        return 0.5 * float(v @ free.inertia(self.start) @ v)

    def travel(self) -> float:
        """How far any part of it, but of a plane its centre, goes in this step (m)."""
        return travelled(self.surface, self.start, self.at(1.0))

    def ahead(self, dt: float, count: int, limit: float) -> int:
        """How many steps of a length follow each other in which it goes no further than a limit.

        Of free components, which forces decide, nothing is known. What prescribes the motion, or
        loads, in time may raise at later times: then the steps end before.

        Args:
            dt: The length (s).
            count: At most so many, of which the first one is not looked at.
            limit: The limit (m).
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
        """Position, angle, force and moment, as records of steps have them."""
        parts = {
            "position": self.position, "angle": self.angle, "force": self.force,
            "moment": self.moment,
        }  # fmt: skip
        return {name: [float(v) for v in values] for name, values in parts.items()}

    def state(self) -> Array:
        """What a checkpoint keeps, as one row of numbers."""
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
        """Take what `state` returned."""
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
        """Facets that draw it there, shape (facets, gdim, gdim); see `RigidSurface.outline`."""
        return self.pose.forth(self.surface.outline(low, high))


def check_bodies(bodies: Any, gdim: int) -> None:
    """Raise ParameterError unless these are rigid bodies in space of that dimension."""
    if not isinstance(bodies, (list, tuple)):
        raise ParameterError(f"bodies = {shown(bodies)} must be a list of mpm.RigidBody")
    for body in bodies:
        if not isinstance(body, RigidBody) or body.gdim != gdim:
            raise ParameterError(f"bodies holds {shown(body)}, no mpm.RigidBody in {gdim}D")


def _middle(surface: RigidSurface) -> Array:
    if np.isfinite(surface.low).all():
        return np.asarray(0.5 * (surface.low + surface.high))
    g, n, _ = surface.probe(np.zeros((1, surface.gdim)))
    # the point of a plane that is nearest to the origin
    return np.asarray(-g[0] * n[0])
