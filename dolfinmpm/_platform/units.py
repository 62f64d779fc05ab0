"""Numbers that may have been given in another unit: coefficients of friction, and angles."""

from __future__ import annotations

import math
from typing import Any

from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import number
from dolfinmpm._platform.errors import DegreesWarning, ParameterError, warn

__all__ = [
    "FAR_MODULI",
    "LARGEST_FRICTION",
    "LARGEST_MODULUS",
    "LARGEST_PENALTY",
    "LEAST_PENALTY",
    "friction_coefficient",
    "in_radians",
    "refuse_number_of",
    "warn_of_radians",
]

# Coefficient in place of an infinite one, in a product with a pressure that may be 0
LARGEST_FRICTION = 1e30

# Penalties in units of a stiffness: beyond the largest, rounding is all that is left of the other
# forces, and balances may be found in bodies that cannot move; below the least nothing is held
LEAST_PENALTY, LARGEST_PENALTY = 1e-6, 1e12
# Ratio of two moduli of one body from which on they have different units
FAR_MODULI = 100.0
# Modulus (Pa) that no material has, and no unit of it makes
LARGEST_MODULUS = 1e20

# Coefficients in this range are none of any materials, and angles of friction in degrees of many
_DEGREES = 10.0, 60.0
# an angle below this would be below a degree in radians too, and is meant so
_LEAST = math.radians(1.0)


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


def refuse_number_of(what: str, value: float, low: float, high: float, told: str) -> None:
    """Raise ParameterError if a number lies in a range that only another unit of it makes.

    Args:
        what: The argument.
        value: Its number.
        low, high: The range.
        told: What the number is, and what to give.
    """
    if low <= value <= high:
        raise ParameterError(f"{what} = {value:g} {told}")


def warn_of_radians(what: str, angle: float) -> bool:
    """Warn on rank 0 if an angle (degrees) is so small that it looks like one in radians.

    Args:
        what: Name of the angle.
        angle: The angle (degrees).

    Returns:
        Whether it does.
    """
    if not _LEAST <= abs(angle) < 1.0:
        return False
    warn(
        MPI.COMM_WORLD,
        f"{what} = {angle:g} degrees is below 1 degree; if radians were meant give "
        f"{math.degrees(angle):.4g}",
        DegreesWarning,
    )
    return True


def in_radians(what: str, value: Any, low: float = -math.inf, high: float = math.inf) -> float:
    """An angle in radians from one in degrees; warns if it looks like one in radians.

    Args:
        what: Name of the angle.
        value: The angle (degrees).
        low, high: Bounds (degrees).

    Raises:
        ParameterError: It is no finite number, or not between these.
    """
    angle = number(what, value, low, high, "degrees")
    warn_of_radians(what, angle)
    return math.radians(angle)
