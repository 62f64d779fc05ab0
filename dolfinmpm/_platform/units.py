"""Numbers that may have been given in another unit: coefficients of friction, and angles."""

from __future__ import annotations

import math
from typing import Any

from mpi4py import MPI

from dolfinmpm._platform.checks import number
from dolfinmpm._platform.errors import DegreesWarning, warn

__all__ = ["friction_coefficient", "turn"]

# Coefficients in this range are none of any materials, and angles of friction in degrees of many
_DEGREES = 10.0, 60.0


def friction_coefficient(value: Any) -> float:
    """A coefficient μ of Coulomb's friction; warns if it looks like an angle in degrees.

    Raises:
        ParameterError: It is no number, or negative.
    """
    mu = number("friction", value, 0.0, math.inf, closed=True)
    if _DEGREES[0] <= mu <= _DEGREES[1]:
        warn(
            MPI.COMM_WORLD,
            f"friction = {mu:g} is a coefficient, the tangent of the angle of friction; if {mu:g} "
            f"degrees were meant give {math.tan(math.radians(mu)):.4g}",
            DegreesWarning,
        )
    return mu


def turn(what: str, value: Any) -> float:
    """An angle by which something is turned (rad); warns if it looks like one in degrees.

    More than a turn does, and so does a whole number beyond half of one.

    Args:
        what: What it is the angle of.
        value: The angle.

    Raises:
        ParameterError: It is no finite number.
    """
    angle = number(what, value, unit="rad")
    if abs(angle) > 2 * math.pi or (abs(angle) > math.pi and angle == round(angle)):
        warn(
            MPI.COMM_WORLD,
            f"{what} = {angle:g} is in radians, and more than half a turn; if {angle:g} degrees "
            f"were meant give {math.radians(angle):.4g}",
            DegreesWarning,
        )
    return angle
