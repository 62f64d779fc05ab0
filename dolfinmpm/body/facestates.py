"""Displacements of the faces of a surface in a given state of its points."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import FieldShapeError
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surfacechecks import numbers_of

__all__ = ["displaced_faces"]

Array = npt.NDArray[np.float64]


def displaced_faces(points: MaterialPoints, offset: Array, x: Any, F: Any) -> Array:
    """Total displacements of faces (m), shape (points, gdim).

    Args:
        points: Material points.
        offset: Initial offsets from the points to their faces R (m), shape (points, gdim).
        x, F: Positions (m) and deformation gradients, as the points' fields have them.

    Raises:
        FieldShapeError: An array has another shape. NumPy would stretch one row to all points.
    """
    at, gradients = numbers_of("x", x), numbers_of("F", F)
    n, d, k = len(points), points.gdim, points.strain_dim
    for what, values, shape in (("x", at, (n, d)), ("F", gradients, (n, k, k))):
        if values.shape != shape:
            raise FieldShapeError(
                f"{what} should have shape {shape} (this rank's points first), as points['{what}'] "
                f"has, got {values.shape}"
            )
    now = np.einsum("pij,pj->pi", in_section(points, gradients), offset)
    return at - points["x0"] + (now - offset)
