"""Motion of a rigid body: its pose, prescribed components, and free components with mass and loads.

The motion in a step has one component per direction and per rotation: (u_x, u_y, θ) in 2D,
(u_x, u_y, u_z, θ_x, θ_y, θ_z) in 3D. Components that are not free follow the prescribed motion: in
total, per step, or per second.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm._platform.argumentchecks import at_time, coordinates, floats, number, shown, vector
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.contact.givenmotion import Given, Load
from dolfinmpm.grid.constants import begin_at_zero

__all__ = [
    "FreeMotion",
    "Motion",
    "Pose",
    "PrescribedMotion",
    "first_rate",
    "moments",
    "rotation_of",
]

Array = npt.NDArray[np.float64]

# Places of Gauss's rule in a step
_GAUSS = 0.5 - math.sqrt(1 / 12), 0.5 + math.sqrt(1 / 12)


def rotation_of(turn: Array, gdim: int) -> Array:
    """Matrix of a rotation, shape (gdim, gdim).

    Args:
        turn: Angle (rad), shape (1,), in 2D, or the rotation vector (rad), shape (3,).
        gdim: Dimension of space.
    """
    if gdim < 3:
        c, s = math.cos(turn[0]), math.sin(turn[0])
        return np.array([[c, -s], [s, c]])
    angle = float(np.linalg.norm(turn))
    W = np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]])
    if angle < 1e-8:
        return np.eye(3) + W + 0.5 * W @ W
    # Rodrigues
    half = math.sin(0.5 * angle) / (0.5 * angle)
    return np.eye(3) + math.sin(angle) / angle * W + 0.5 * half**2 * W @ W


def moments(arms: Array, forces: Array) -> Array:
    """Moments of forces at arms, shape (n, 1) in 2D, (n, 3) in 3D."""
    if arms.shape[1] == 3:
        return np.asarray(np.cross(arms, forces), float)
    return (arms[:, 0] * forces[:, 1] - arms[:, 1] * forces[:, 0])[:, None]


@dataclass(frozen=True)
class Pose:
    """Position and rotation of a body.

    Attributes:
        origin: Initial position of the centre of rotation (m), shape (gdim,).
        shift: Translation of the centre since then (m), shape (gdim,).
        rotation: Rotation matrix since then, shape (gdim, gdim).
        turn: Angle since then (rad), shape (1,), in 2D, with whole turns; in 3D the sum of all
            small rotations, shape (3,).
    """

    origin: Array
    shift: Array
    rotation: Array
    turn: Array

    @staticmethod
    def first(origin: Array) -> Pose:
        """The pose of a body that has not moved."""
        d = len(origin)
        return Pose(origin, np.zeros(d), np.eye(d), np.zeros(1 if d < 3 else 3))

    @property
    def centre(self) -> Array:
        """Present position of the centre (m), shape (gdim,)."""
        return self.origin + self.shift

    def moved(self, shift: Array, turn: Array) -> Pose:
        """The pose after a further motion.

        Args:
            shift: Translation of the centre (m), shape (gdim,).
            turn: Rotation about the centre (rad), shape (1,), in 3D (3,).
        """
        rotation = self.rotation
        if turn.any():
            rotation = rotation_of(turn, len(shift)) @ rotation
        return replace(self, shift=self.shift + shift, rotation=rotation, turn=self.turn + turn)

    def back(self, x: Array) -> Array:
        """Initial positions of points of the body (m) from present ones, shape (n, gdim)."""
        return self.origin + (x - self.centre) @ self.rotation

    def forth(self, x: Array) -> Array:
        """Present positions of points of the body (m) from initial ones, shape (..., gdim)."""
        return self.centre + (x - self.origin) @ self.rotation.T

    def directions(self, v: Array) -> Array:
        """Present directions of vectors fixed to the body, shape (..., gdim)."""
        return v @ self.rotation.T


Motion = Callable[[float], Any]


class PrescribedMotion(Given):
    """One prescribed motion, a displacement or a rotation.

    Args:
        size: Number of its components.
        motions: Name → total motion, velocity, and increment per step, in this order. Only one
            may be given: a function of time (s; steps), or a DOLFINx constant for the total
            motion, or numbers for velocity and increment.

    Attributes:
        size: The argument.
        name: Name of the given motion, or "".
        kind: "total", "velocity" or "increment"; "" for a body at rest.
        given: The total motion, or None.
        rate: The velocity or the increment per step, or None.
        absolute: Whether a rotation is a rotation vector in total.
        unit: Unit of the given numbers, in m or rad.
        until: Time at which a constant is to have its value, at the end of several steps (s); by
            default the end of each step.

    Raises:
        ParameterError: Two motions are given, or a motion has the wrong type or value.
    """

    unit, until = 1.0, -math.inf

    def __init__(self, size: int, **motions: Any):
        kinds = dict(zip(motions, ("total", "velocity", "increment")))
        given_motions = {name: motion for name, motion in motions.items() if motion is not None}
        if len(given_motions) > 1:
            raise ParameterError(
                f"{' and '.join(given_motions)} are given at once; give only one of them"
            )
        name, motion = next(iter(given_motions.items()), ("", None))
        self.size, self.name, self.kind, self.absolute = size, name, kinds.get(name, ""), False
        given, rate = (motion, None) if self.kind == "total" else (None, motion)
        self.given: Any = given
        self.rate: Any = rate
        self._first: Array = np.zeros(size)
        self._step: Array = np.zeros(size)
        self._dt = 1.0
        if isinstance(given, fem.Constant):
            if given.value.size != size:
                raise ParameterError(
                    f"{name} has {given.value.size} components and must have {size}"
                )
            begin_at_zero(name, given)
        elif given is not None:
            if not callable(given):
                raise ParameterError(
                    f"{name} = {shown(given)} must be a function of time or a dolfinx.fem.Constant"
                )
            self._first = self.value(given, 0.0)
        elif rate is not None and not callable(rate):
            self.rate = functools.partial(_steady, vector(name, rate, size))
        if callable(self.rate):
            self.value(self.rate, 0.0)

    def check_start(self) -> None:
        """Raise ParameterError if the total motion is not zero at t = 0."""
        if self._first.any():
            raise ParameterError(
                f"{self.name}(0) = {shown(self._first)} must be 0: it is the motion of the body "
                "since it was made; make the shape at the body's initial position"
            )

    def refuse_free(self, free: npt.NDArray[np.intp]) -> None:
        """Raise ParameterError if all that it prescribes are free components.

        Velocities and increments are those at the start there.
        """
        if self.kind == "total" and np.isin(np.arange(self.size), free).all():
            raise ParameterError(
                f"{self.name} prescribes components that are free and would do nothing: hold one "
                "by free=..., or leave it out; an initial velocity is given by velocity or "
                "angular_velocity"
            )

    def value(self, function: Motion, t: float) -> Array:
        """Value of a function of time at t, shape (size,)."""
        return vector(f"{self.name}({t:g})", at_time(self.name, function, t), self.size)

    def begin(self, start: Array, t: float, dt: float) -> None:
        """Begin a substep of length dt at t: read the value of a constant.

        Later in the substep, solvers set constants to their values at the time of the balance.
        """
        if isinstance(self.given, fem.Constant):
            self._step = self.unit * np.array(self.given.value, float).ravel() - start
            self._step *= dt / max(self.until - t, dt)
            self._dt = dt

    def change(self, start: Array, t: float, dt: float) -> Array:
        """Change from the start of a substep, at t, to dt later; start is the motion so far."""
        if isinstance(self.given, fem.Constant):
            return np.asarray(dt / self._dt * self._step)
        if self.given is not None:
            return self.unit * (self.value(self.given, t + dt) - self._first) - start
        if self.rate is None or dt == 0.0:
            return np.zeros(self.size)
        # Gauss's rule: a jump of the function at the end of a step belongs to no step
        one, two = (self.value(self.rate, t + s * dt) for s in _GAUSS)
        return np.asarray(self.unit * dt / 2 * (one + two))


def _steady(rate: Array, t: float) -> Array:
    """The same velocity, or increment, at all times."""
    return rate


def first_rate(motion: PrescribedMotion) -> Array:
    """Initial velocity, or first increment; zero if neither is given."""
    if motion.rate is None:
        return np.zeros(motion.size)
    return motion.unit * motion.value(motion.rate, 0.0)


class FreeMotion:
    """The free components of a body's motion, with their inertia and loads.

    Args:
        gdim: Dimension of space.
        free: Whether each component is free, shape (3,) or in 3D (6,).
        mass: Mass (kg), or None without inertia.
        inertia: Moment of inertia about the centre (kg m²): a number, or in 3D three for the axes
            of the body in its initial position.
        gravity: Acceleration of gravity (m/s²), shape (gdim,), or a DOLFINx constant.
        force: Further force at its centre (N), likewise, or a function of time.
        moment: Further moment (N m), shape (1,) or in 3D (3,), likewise.
        velocity: Initial velocity of the components (m/s, rad/s), shape (components,).

    Attributes:
        free: The argument, as indices.
        velocity: Velocity of all components (m/s, rad/s), shape (components,).
        acceleration: Acceleration of all components (m/s², rad/s²), likewise. None before it is
            known.
        increment: Increment of all components in the step (m, rad), likewise.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.
    """

    def __init__(
        self, gdim: int, free: Any, mass: Any, inertia: Any, gravity: Any, force: Any,
        moment: Any, velocity: Array,
    ):  # fmt: skip
        self._gdim = gdim
        size = 3 if gdim == 2 else 6
        if free is None:
            free = (True,) * size
        flags = floats(free)
        if flags is None or flags.shape != (size,) or not np.isin(flags, (0.0, 1.0)).all():
            raise ParameterError(
                f"free = {shown(free)} must have {size} values True or False, one per component: "
                "the directions first, then the rotations"
            )
        self.free = np.flatnonzero(flags)
        self.mass = None if mass is None else number("mass", mass, 0.0, unit="kg")
        turns = size - gdim
        self._inertia = None
        if inertia is not None:
            values = np.atleast_1d(coordinates("inertia", inertia))
            if values.shape not in ((1,), (turns,)) or not np.all((values > 0) & (values < np.inf)):
                raise ParameterError(
                    f"inertia = {shown(inertia)} kg m² must be positive: a number, or in 3D three"
                )
            self._inertia = np.broadcast_to(values, (turns,)).astype(float)
        turning = np.any(self.free >= gdim)
        if self.mass is not None and turning and self._inertia is None:
            raise ParameterError(
                "a body with a mass that is free to rotate needs its inertia (kg m²): give "
                "inertia=..."
            )
        if self.mass is None and inertia is not None:
            raise ParameterError("inertia is of a mass, and the body has none: give mass=... (kg)")
        if gravity is not None and self.mass is None:
            raise ParameterError(
                "gravity acts on a mass, and the body has none: give mass=... (kg), or a force"
            )
        self._gravity = Load("gravity", gravity, gdim)
        self._force, self._moment = Load("force", force, gdim), Load("moment", moment, turns)
        self._force.refuse_held(self.free)
        self._moment.refuse_held(self.free - gdim)
        self.velocity = np.array(velocity, float)
        self.acceleration: Array | None = None
        self.increment = np.zeros(size)

    @property
    def loads(self) -> list[fem.Constant]:
        """DOLFINx constants in its loads."""
        parts = self._gravity, self._force, self._moment
        return [p.given for p in parts if isinstance(p.given, fem.Constant)]

    @property
    def loads_by_functions(self) -> bool:
        """Whether a load is a function of time."""
        return any(
            callable(p.given) and not isinstance(p.given, fem.Constant)
            for p in (self._gravity, self._force, self._moment)
        )

    def external(self, t: float) -> Array:
        """Forces and moments other than contact (N, N m), shape (components,)."""
        force = self._force.value(t)
        if self.mass is not None:
            force = force + self.mass * self._gravity.value(t)
        return np.concatenate([force, self._moment.value(t)])

    def inertia(self, pose: Pose) -> Array:
        """Mass matrix of all components, shape (components, components); zero without a mass."""
        size, d = self.increment.size, self._gdim
        M = np.zeros((size, size))
        if self.mass is None:
            return M
        M[:d, :d] = self.mass * np.eye(d)
        own = self._inertia if self._inertia is not None else np.zeros(size - d)
        M[d:, d:] = np.diag(own) if d == 2 else pose.rotation @ np.diag(own) @ pose.rotation.T
        return M

    def go_on(self, dt: float) -> None:
        """Set the increment of a body that continues its motion for a time dt (s)."""
        free, self.increment = self.free, np.zeros_like(self.increment)
        self.increment[free] = dt * self.velocity[free]
        if self.acceleration is not None:
            self.increment[free] += 0.5 * dt**2 * self.acceleration[free]

    def parts(self, share: float) -> tuple[Array, Array]:
        """Translation (m) and rotation (rad) of the free components at a share of the step."""
        return share * self.increment[: self._gdim], share * self.increment[self._gdim :]
