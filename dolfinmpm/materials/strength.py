"""Division of a law's strength by a factor."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.parametrised import Array

__all__ = ["reduced_angle", "weakened"]

# a strength that no stress reaches (Pa)
_ENDLESS = 1e300


def reduced_angle(angle: npt.ArrayLike, factor: float) -> Array:
    """Friction angle arctan(tan φ / F) (degrees).

    Args:
        angle: Friction angle φ (degrees), from 0 to below 90.
        factor: F, positive.
    """
    return np.asarray(np.degrees(np.arctan(np.tan(np.radians(angle)) / factor)), np.float64)


# Why a law has no strength to divide, and what to do; a law may say it better
_WITHOUT = (
    "does not tell what its strength is: name the parameters to be divided, as strengths = "
    '("cohesion",), and friction_angles, in the law\'s class; or give factor_of_safety a function '
    "of the factor that builds the body anew"
)


def weakened(law: Law, parameters: Array, factor: float) -> Array:
    """A law's parameters with its strength divided by a factor.

    Strengths and tangents of friction angles are divided by F. A dilation angle stays, unless it
    exceeds the reduced friction angle. Then it becomes the reduced friction angle.

    Args:
        law: The law.
        parameters: Parameters of the kernel, shape (n, parameters).
        factor: F, positive; or 0 for a body that does not yield.

    Returns:
        The reduced parameters, shape (n, parameters).

    Raises:
        ParameterError: The law does not declare its strength, or the reduced parameters contradict
            each other.
    """
    if law.strengths is None:
        raise ParameterError(f"{type(law).__name__} {getattr(law, '_without_strength', _WITHOUT)}")
    names = list(law.parameters)
    unknown = [name for name in (*law.strengths, *law.friction_angles) if name not in names]
    if unknown:
        raise ParameterError(
            f"{type(law).__name__}: strengths and friction_angles name {unknown[0]!r}, which is "
            f"none of its parameters: {', '.join(names)}"
        )
    values: dict[str, npt.NDArray[Any]] = dict(zip(names, parameters[:, : len(names)].T.copy()))
    for name in law.strengths:
        values[name] = values[name] / factor if factor else np.full(len(parameters), _ENDLESS)
    if factor:
        for name in law.friction_angles:
            # the largest value that the law accepts is the bound
            angle = reduced_angle(values[name], factor)
            values[name] = np.minimum(angle, law.parameters[name].high)
        if law.friction_angles and "dilation_angle" in values:
            smallest = np.minimum.reduce([values[name] for name in law.friction_angles])
            values["dilation_angle"] = np.minimum(values["dilation_angle"], smallest)
        law.admissible(values)
    return law.completed(np.column_stack([values[name] for name in names]))
