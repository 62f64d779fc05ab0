"""Angles of laws, in degrees."""

from __future__ import annotations

from collections.abc import Mapping

from dolfinmpm._platform import units
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.parametrised import Array

__all__ = ["warn_of_radians"]


def warn_of_radians(law: Law, values: Mapping[str, Array]) -> None:
    """Warn on rank 0, once per law, if an angle is so small that it may be in radians.

    For an angle that varies over the points the largest value counts.

    Args:
        law: The law.
        values: Parameter → values. Parameters with a name that ends in "angle" are in degrees.
    """
    if getattr(law, "_told_of_radians", False):
        return
    for name in (name for name in values if name.endswith("angle")):
        angle = float(values[name].max(initial=0.0))
        if units.warn_of_radians(f"{type(law).__name__}: {name}", angle):
            law._told_of_radians = True
            return
