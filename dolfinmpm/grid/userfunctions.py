"""Calls of users' functions: of positions, in one layout of the positions, and of time.

Arrays of positions have shape (points, gdim), one row per point, wherever they are given or
returned.
dolfinmpm takes functions of positions in many places: places and values of conditions, faces
of a surface, densities, parameters of laws, stresses, `Where`. All these functions get one array x
of positions (m) of shape (gdim, n), one row per coordinate as in DOLFINx, and return n values.
In 2D the array has no third row. `x[-1]` is therefore the height in every dimension. A function
that asks for a missing coordinate gets an error; a row of zeros would give wrong values in
silence. Functions for DOLFINx that use only `x[0] ... x[gdim - 1]` work unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import array_of, at_time, cut, floats, number, shown
from dolfinmpm._platform.errors import DolfinMPMError, FieldShapeError, ParameterError

__all__ = ["VelocityByTime", "booleans", "call_function", "choose"]

Array = npt.NDArray[np.float64]


def _call(what: str, function: Callable[[Array], Any], x: Array) -> Any:
    n, d = x.shape
    if isinstance(function, Expr):
        # UFL calls its own expressions, with other arguments
        raise ParameterError(
            f"{what} = {shown(function)} is an expression of UFL: give a number, or a function of "
            f"positions (m) of shape ({d}, {n}), as in lambda x: 1000.0 + 10.0 * x[-1]"
        )
    try:
        # a copy: functions may change their argument in place
        return function(np.array(x.T, order="C"))
    except DolfinMPMError:
        raise  # the message is clear already
    except Exception as error:
        raise ParameterError(
            f"{what} failed with {type(error).__name__}: {cut(str(error))}; it is called with one "
            f"array of positions (m) of shape ({d}, {n}), one row per coordinate"
        ) from error


def call_function(
    what: str,
    function: Callable[[Array], Any],
    x: Array,
    shape: tuple[int, ...] = (),
    truths: bool = False,
) -> npt.NDArray[np.float64]:
    """Values of a user's function at positions. Not collective; see `call_together`.

    Args:
        what: Name of the function in messages.
        function: Function of positions in the layout of this module.
        x: Positions (m), shape (n, gdim). With n = 0 the function is not called, because many
            functions fail on empty arrays.
        shape: Shape of one value.
        truths: Whether truth values count as 0 and 1.

    Returns:
        Values, shape (n, *shape). A single value is repeated for all positions.

    Raises:
        ParameterError: The function fails, or does not return numbers of these shapes.
    """
    n = len(x)
    if n == 0:
        return np.empty((0, *shape))
    answer = _call(what, function, x)
    values = floats(answer, truths)
    if values is None or values.shape not in (shape, (n, *shape)):
        got = shown(answer) if values is None else f"shape {values.shape}"
        raise ParameterError(
            f"{what} should return numbers of shape {(n, *shape)} for positions of shape "
            f"{x.T.shape}, got {got}"
        )
    return np.broadcast_to(values, (n, *shape)).copy()


def choose(what: str, function: Callable[[Array], Any], x: Array) -> npt.NDArray[np.bool_]:
    """Positions at which a user's function is true. Not collective; see `call_together`.

    Args:
        what: Name of the function in messages.
        function: Function of positions in the layout of this module.
        x: Positions (m), shape (n, gdim). With n = 0 the function is not called.

    Returns:
        Whether the function is true at each position, shape (n,).

    Raises:
        ParameterError: The function fails, or does not return n booleans.
    """
    n = len(x)
    if n == 0:
        return np.zeros(0, bool)
    answer = _call(what, function, x)
    values = np.asarray(answer)
    if values.shape != (n,) or values.dtype != bool:
        raise ParameterError(
            f"{what} should return {n} booleans for positions of shape {x.T.shape}, got "
            f"{values.dtype} of shape {values.shape}; compare coordinates, as in x[0] < 1"
        )
    return values


def booleans(what: str, given: Any, x: Array) -> npt.NDArray[np.bool_]:
    """Booleans for positions (m), shape (n,), from an array or a function; see `choose`.

    Raises:
        ParameterError: They are no booleans, or the function fails.
        FieldShapeError: There are not n of them.
    """
    if callable(given):
        return choose(what, given, x)
    chosen = np.array(array_of(what, given))
    if chosen.dtype != bool and chosen.size:
        raise ParameterError(
            f"{what} = {shown(given)} must be booleans, got {chosen.dtype}: compare positions, as "
            'in points["x"][:, 1] > 2.0, take a shape, shape.contains(points["x"]), or give a '
            "function of positions"
        )
    if chosen.shape != (len(x),):
        raise FieldShapeError(
            f"{what} should be {len(x)} booleans, one for each point of this rank, got the shape "
            f"{chosen.shape}"
        )
    return chosen.astype(bool)


class VelocityByTime:
    """A velocity as a function of time; every value is checked.

    Args:
        name: Name of the argument in messages.
        given: A function of the time (s) that returns a velocity (m/s), or a number (m/s).
    """

    def __init__(self, name: str, given: Any):
        self._name, self._given = name, given

    @staticmethod
    def of(name: str, given: Any) -> VelocityByTime:
        """A given velocity as it is, or one of a function or a number."""
        return given if isinstance(given, VelocityByTime) else VelocityByTime(name, given)

    def __call__(self, t: float) -> float:
        """Velocity at time t (m/s)."""
        return number(self._name, at_time(self._name, self._given, t), unit="m/s")

    def mean_velocity(self, start: float, end: float) -> float:
        """Mean of the velocities at both ends of a step (m/s).

        Args:
            start, end: Times (s).
        """
        self.check_step(start, end)
        return 0.5 * (self(start) + self(end))

    def check_step(self, start: float, end: float) -> None:
        """Warn if a step misses too much of the velocity in it. A function cannot tell.

        Args:
            start, end: Times (s).
        """
