"""Recorded motions of the ground: acceleration or velocity over time."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import choice, coordinates, number, shown, whole
from dolfinmpm._platform.errors import (
    DoubtfulInputWarning,
    DriftingRecordWarning,
    ParameterError,
    warn,
)
from dolfinmpm._platform.filepaths import text_of
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm.grid.userfunctions import VelocityByTime

__all__ = ["InputMotion"]

Array = npt.NDArray[np.float64]

# Largest velocity that may be left after the record, as a share of its peak velocity
_LEFT = 0.02
# Largest mean velocity that a step may miss, as a share of the peak velocity: waves of 6 steps
_MISSED = 0.1
# Acceleration (m/s²) above all that were measured in earthquakes: 38.66 m/s² vertically, see
# Aoi et al. (2008), doi 10.1126/science.1163113
_STRONGEST = 50.0


class InputMotion(Unchanged, VelocityByTime):
    """A recorded motion of the ground in one direction, for `absorbing(incoming=)` and `moving`.

    Between its samples the given quantity is linear. The others follow by exact integration. Before
    the record the ground is at rest. After the record its velocity stays, so that a record whose
    last velocity is not 0 drifts for ever.

    Args:
        time: Times of the samples (s), shape (n,), increasing, from 0 or later.
        acceleration: Accelerations (m/s²), shape (n,). The velocity begins with 0.
        velocity: Velocities (m/s), shape (n,), instead of accelerations.

    Attributes:
        time: The argument.
        drift: Velocity after the record (m/s).
        left: Displacement at the end of the record (m).

    Raises:
        ParameterError: The times do not increase, samples are not finite, or not exactly one of
            `acceleration` and `velocity` is given.

    Warns:
        DoubtfulInputWarning: Given accelerations are above 50 m/s² when the record is first used.
        DriftingRecordWarning: A record in use has more than 2 % of its peak velocity left after
            its end. Or steps are so long that they miss a tenth of its peak velocity. Steps of
            `Newmark`, `GeneralisedAlpha` and `Transient` take the mean of the velocities at both
            ends. Steps of `Explicit` are compared with a wave that comes in through a side.

    A record of three samples:

    >>> import dolfinmpm as mpm
    >>> quake = mpm.InputMotion([0.0, 1.0, 2.0], velocity=[0.0, 0.5, 0.0])
    >>> quake(0.5), quake.displacement(2.0), quake.acceleration(1.5), quake.drift
    (0.25, 0.5, -0.5, 0.0)
    """

    def __init__(self, time: Any, *, acceleration: Any = None, velocity: Any = None):
        from scipy.interpolate import PPoly

        if (acceleration is None) == (velocity is None):
            raise ParameterError(
                "a record needs either acceleration= (m/s²) or velocity= (m/s), one of both"
            )
        name = "velocity" if acceleration is None else "acceleration"
        t, values = coordinates("time", time), coordinates(name, velocity)
        if acceleration is not None:
            values = coordinates(name, acceleration)
        if t.ndim != 1 or t.size < 2 or values.shape != t.shape:
            raise ParameterError(
                f"time has the shape {t.shape} and {name} {values.shape}: give two arrays of one "
                "length of at least 2"
            )
        if not np.isfinite(values).all() or not np.isfinite(t).all():
            bad = int(np.flatnonzero(~(np.isfinite(values) & np.isfinite(t)))[0])
            raise ParameterError(f"sample {bad} of the record must be finite: fill gaps in first")
        if t[0] < 0.0 or not np.all(np.diff(t) > 0.0):
            raise ParameterError("the times of a record must begin at 0 or later, and increase")
        self.time, self._kind = t, name
        given = PPoly(np.array([np.diff(values) / np.diff(t), values[:-1]]), t)
        self._velocity = given if acceleration is None else given.antiderivative()
        self._displacement = self._velocity.antiderivative()
        self._acceleration = self._velocity.derivative()
        self.drift = float(self._velocity(t[-1]))
        self.left = float(self._displacement(t[-1]))
        self._peak = float(np.abs(self._velocity(t)).max())
        self._told = self._missed = False

    def _check(self) -> None:
        """Warn once about a record that goes on after its end."""
        from mpi4py import MPI

        self._told = True
        # given velocities may jump, and have any acceleration
        peak = float(np.abs(self._samples()).max()) if self._kind == "acceleration" else 0.0
        if peak > _STRONGEST:
            warn(
                MPI.COMM_WORLD,
                f"the record has a peak of {peak:.4g} m/s², and no earthquake has had more than "
                f"{_STRONGEST:g}: if it is in cm/s² (Gal), take record.scaled(0.01)",
                DoubtfulInputWarning,
            )
        if abs(self.drift) > _LEFT * self._peak:
            warn(
                MPI.COMM_WORLD,
                f"the record ends with the velocity {self.drift:.3g} m/s, and its peak is "
                f"{self._peak:.3g} m/s: the ground goes on for ever; take record.corrected(), "
                "which removes a line from the acceleration",
                DriftingRecordWarning,
            )

    def check_step(self, start: float, end: float) -> None:
        """Warn once if a step misses waves: it takes the mean of the velocities at both ends.

        Args:
            start, end: Times (s).
        """
        if self._missed:
            return
        found, dt = 0.5 * (self(start) + self(end)), end - start
        exact = self.displacement(end) - self.displacement(start)
        if abs(found * dt - exact) > _MISSED * self._peak * dt:
            from mpi4py import MPI

            self._missed = True
            warn(
                MPI.COMM_WORLD,
                f"the step of {dt:.3g} s from t = {start:.6g} s passes over waves of the record: "
                f"it moves the ground by {found * dt:.3g} m, and the record by {exact:.3g} m; take "
                "steps of a tenth of the shortest period of interest, and a record without shorter "
                "ones",
                DriftingRecordWarning,
            )

    @classmethod
    def from_csv(
        cls, path: Any, *, kind: str = "acceleration", factor: float = 1.0, skip: int = 0
    ) -> InputMotion:
        """A record from a table of two columns, times (s) and values.

        Args:
            path: A text file; columns are divided by commas, semicolons or spaces. Empty lines,
                and what follows a "#", are left out.
            kind: "acceleration" or "velocity".
            factor: Factor of the values, such as 9.81 for accelerations in g.
            skip: Number of lines before the table.

        Raises:
            OSError: The file is missing, or has no two columns of numbers.
            ParameterError: An argument is out of range.
        """
        lines = text_of("record", path).splitlines()
        number("factor", factor), whole("skip", skip, 0)
        kind = choice("kind", kind, ("acceleration", "velocity"))
        rows = []
        for k, line in enumerate(lines[skip:], skip + 1):
            words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
            try:
                rows += [(float(time), float(value)) for time, value in [words]] if words else []
            except ValueError:
                raise OSError(
                    f"{path}, line {k}: {shown(line)} is no time with a value, two numbers with "
                    "decimal points; skip= leaves out lines at the top"
                ) from None
        if not rows:
            raise OSError(f"{path} has no line of numbers after {skip} of its {len(lines)} lines")
        time, values = np.array(rows).T
        return cls(time, **{kind: factor * values})

    def __call__(self, t: float) -> float:
        """Velocity at time t (m/s)."""
        t = number("t", t, unit="s")
        # a record may be corrected before it is used
        if not self._told:
            self._check()
        if t < self.time[0]:
            return 0.0
        return float(self._velocity(min(t, self.time[-1])))

    def acceleration(self, t: float) -> float:
        """Acceleration at time t (m/s²); 0 before and after the record."""
        t = number("t", t, unit="s")
        if not self.time[0] <= t <= self.time[-1]:
            return 0.0
        return float(self._acceleration(t))

    def displacement(self, t: float) -> float:
        """Displacement at time t (m)."""
        t = number("t", t, unit="s")
        if t < self.time[0]:
            return 0.0
        end = float(self.time[-1])
        return float(self._displacement(min(t, end))) + self.drift * max(t - end, 0.0)

    def scaled(self, factor: float) -> InputMotion:
        """The record times a factor: 0.5 makes the upward wave of a record at an outcrop."""
        return self._changed(number("factor", factor) * self._samples())

    def corrected(self) -> InputMotion:
        """The record after a correction of its baseline: velocity and displacement end with 0.

        A parabola that is 0 at the start is subtracted from the velocity, which is a line in the
        acceleration. Its two coefficients follow from both conditions at the end.

        Raises:
            ParameterError: A record of velocities has two samples only.
        """
        if self._kind == "velocity" and self.time.size < 3:
            raise ParameterError(
                "a record of 2 velocities has nothing between its ends that a correction could "
                "change, and must have at least 3: give more samples"
            )
        t = self.time - self.time[0]
        T = float(t[-1])
        # velocity b t + c t², of which velocity and displacement at T are those of the record
        matrix = np.array([[T, T**2], [T**2 / 2, T**3 / 3]])
        b, c = np.linalg.solve(matrix, [self.drift, self.left])
        if self._kind == "acceleration":
            return self._changed(self._samples() - (b + 2 * c * t))
        less = b * t + c * t**2
        # lines between the samples are a little off the parabola
        missing = np.sum(0.5 * np.diff(t) * (less[1:] + less[:-1])) - self.left
        bump = t * (T - t)
        bump *= missing / np.sum(0.5 * np.diff(t) * (bump[1:] + bump[:-1])) if T else 0.0
        return self._changed(self._samples() - less + bump)

    def _samples(self) -> Array:
        """Values of the given quantity at the samples."""
        kept = self._velocity if self._kind == "velocity" else self._acceleration
        return np.asarray(kept(self.time), np.float64)

    def _changed(self, values: Array) -> InputMotion:
        return InputMotion(self.time, **{self._kind: values})
