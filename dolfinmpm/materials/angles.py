"""Angles of laws, which are in degrees."""

from __future__ import annotations

import math
from collections.abc import Mapping

from mpi4py import MPI

from dolfinmpm._platform.errors import DegreesWarning, warn
from dolfinmpm.materials.base import Array, Law

__all__ = ["warn_of_radians"]

# what is below it would be an angle below a degree in radians too, and is meant so
_LEAST = math.radians(1.0)


def warn_of_radians(law: Law, values: Mapping[str, Array]) -> None:
    """Warn on rank 0, once a law, if an angle is so small that it looks like one in radians.

    Args:
        law: The law.
        values: Parameter → values; those whose name ends in "angle" are in degrees.
    """
    for name, angles in values.items():
        doubtful = angles[(angles >= _LEAST) & (angles < 1.0)] if name.endswith("angle") else ()
        if len(doubtful) and not getattr(law, "_told_of_radians", False):
            law._told_of_radians = True  # type: ignore[attr-defined]
            angle = float(doubtful[0])
            warn(
                MPI.COMM_WORLD,
                f"{type(law).__name__}: {name} = {angle:g} degrees is below 1 degree; if radians "
                f"were meant give {math.degrees(angle):.4g}",
                DegreesWarning,
            )
