"""Angles of laws, which are in degrees."""

from __future__ import annotations

import math
from collections.abc import Mapping

from mpi4py import MPI

from dolfinmpm._platform.errors import DegreesWarning, warn
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.parametrised import Array

__all__ = ["warn_of_radians"]

# what is below it would be an angle below a degree in radians too, and is meant so
_LEAST = math.radians(1.0)


def warn_of_radians(law: Law, values: Mapping[str, Array]) -> None:
    """Warn on rank 0, once a law, if an angle is so small that it looks like one in radians.

    Of an angle that varies it takes the largest value.

    Args:
        law: The law.
        values: Parameter → values; those whose name ends in "angle" are in degrees.
    """
    if getattr(law, "_told_of_radians", False):
        return
    for name in (name for name in values if name.endswith("angle")):
        angle = float(values[name].max(initial=0.0))
        if _LEAST <= angle < 1.0:
            law._told_of_radians = True
            warn(
                MPI.COMM_WORLD,
                f"{type(law).__name__}: {name} = {angle:g} degrees is below 1 degree; if radians "
                f"were meant give {math.degrees(angle):.4g}",
                DegreesWarning,
            )
            return
