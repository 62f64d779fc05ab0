"""Prescribed motions of rigid bodies: in total, per step, or per second."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm._platform.argumentchecks import at_time, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.contact.freemotion import vector
from dolfinmpm.grid.constants import begin_at_zero

__all__ = ["Motion", "PrescribedMotion", "first_rate"]

Array = npt.NDArray[np.float64]
Motion = Callable[[float], Any]


class PrescribedMotion:
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
            constant: Array = vector(name, rate, size)
            self.rate = lambda t: constant
        if callable(self.rate):
            self.value(self.rate, 0.0)

    def check_start(self) -> None:
        """Raise ParameterError if the total motion is not zero at t = 0."""
        if self._first.any():
            raise ParameterError(
                f"{self.name}(0) = {shown(self._first)} must be 0: it is the motion of the body "
                "since it was made; make the shape at the body's initial position"
            )

    def value(self, function: Motion, t: float) -> Array:
        """Value of a function of time at t, shape (size,)."""
        answer = np.atleast_1d(np.asarray(at_time(self.name, function, t)))
        return vector(f"{self.name}({t:g})", answer, self.size)

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
        first, middle, last = (self.value(self.rate, t + s * dt) for s in (0.0, 0.5, 1.0))
        # Simpson's rule
        return np.asarray(self.unit * dt / 6 * (first + 4 * middle + last))


def first_rate(motion: PrescribedMotion) -> Array:
    """Initial velocity, or first increment; zero if neither is given."""
    if motion.rate is None:
        return np.zeros(motion.size)
    return motion.unit * motion.value(motion.rate, 0.0)
