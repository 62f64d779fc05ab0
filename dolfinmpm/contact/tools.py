"""Shapes that rigid bodies have besides those that are filled with points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.shapes import Shape

__all__ = ["Plane"]


class Plane(Shape):
    """All that lies behind a plane, in 2D behind a line.

    Args:
        point: A point of the plane (m).
        normal: Normal of the plane, out of what is behind it; of any length.

    Raises:
        ParameterError: The normal has no length, or the two have not as many coordinates.
    """

    def __init__(self, point: Sequence[float], normal: Sequence[float]):
        at, n = np.array(point, float), np.array(normal, float)
        size = float(np.linalg.norm(n))
        fits = at.ndim == 1 and at.shape == n.shape and 2 <= at.size <= 3
        if not fits or not np.isfinite(at).all() or not 0.0 < size < np.inf:
            raise ParameterError(
                f"a plane needs a point and a normal of 2 or 3 finite coordinates, got {point} and "
                f"{normal}"
            )
        self.point, self.normal = at, n / size
        super().__init__(lambda x: (x - self.point) @ self.normal <= 0.0)
