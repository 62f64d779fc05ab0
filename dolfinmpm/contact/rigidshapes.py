"""Shapes for rigid bodies only."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dolfinmpm._platform.argumentchecks import coordinates, number, vector
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.units import in_radians
from dolfinmpm.body.shapes import Polygon, Shape

__all__ = ["Cone", "Plane", "Wedge"]


class Plane(Shape):
    """The half-space behind a plane, in 2D behind a line.

    Args:
        point: A point of the plane (m).
        normal: Normal of the plane, out of the half-space; of any length.

    Raises:
        ParameterError: The normal is zero, or point and normal differ in dimension.

    >>> import dolfinmpm as mpm
    >>> floor = mpm.RigidBody(mpm.Plane(point=(0, 0), normal=(0, 1)), name="floor")
    >>> floor.position.tolist()
    [0.0, 0.0]
    """

    def __init__(self, point: Sequence[float], normal: Sequence[float]):
        at, n = coordinates("point", point), coordinates("normal", normal)
        size = float(np.linalg.norm(n))
        fits = at.ndim == 1 and at.shape == n.shape and 2 <= at.size <= 3
        if not fits or not np.isfinite(at).all() or not 0.0 < size < np.inf:
            raise ParameterError(
                f"a plane needs a point and a normal of 2 or 3 finite coordinates, got {point} and "
                f"{normal}"
            )
        self.point, self.normal = at, np.asarray(n / size, np.float64)
        super().__init__(lambda x: (x - self.point) @ self.normal <= 0.0)


class Wedge(Polygon):
    """A wedge in 2D that points downwards, symmetric about the vertical through its tip.

    Args:
        tip: Its tip (m).
        semi_angle: Angle between its sides and the vertical (degrees).
        height: Its height (m).

    Raises:
        ParameterError: The angle is not between 0 and 90 degrees, or the height not positive.

    >>> import dolfinmpm as mpm
    >>> shape = mpm.Wedge(tip=(2, 2), semi_angle=30, height=1)
    >>> wedge = mpm.RigidBody(shape, increment=(0.0, -0.01), name="wedge")
    >>> wedge.position.round(6).tolist()
    [2.0, 2.5]
    """

    def __init__(self, tip: Sequence[float], semi_angle: float, height: float):
        slope = math.tan(in_radians("semi_angle", semi_angle, 0.0, 90.0))
        number("height", height, 0.0, 1e100, unit="m")
        at, reach = vector("tip", tip, 2, "m"), height * slope
        self.tip, self.semi_angle = at, float(semi_angle)
        x, y = float(at[0]), float(at[1])
        super().__init__([(x, y), (x + reach, y + height), (x - reach, y + height)])


class Cone(Shape):
    """A cone in 3D on a shaft, such as a penetrometer. The tip points against the axis.

    Args:
        tip: Its tip (m).
        radius: Radius of the shaft, and of the cone's base (m).
        semi_angle: Angle between the cone's side and the axis (degrees): 30 for a tip of 60°.
        length: Length from the tip to the upper end of the shaft (m).
        axis: Direction from the tip to the shaft.

    Raises:
        ParameterError: A size is not positive, or the shaft ends within the cone.

    >>> import dolfinmpm as mpm
    >>> tip = mpm.Cone(tip=(0, 0, 1), radius=0.0178, semi_angle=30, length=0.5)
    >>> cone = mpm.RigidBody(tip, velocity=(0.0, 0.0, -0.02), name="cone")
    >>> cone.position.round(6).tolist()
    [0.0, 0.0, 1.25]
    """

    def __init__(
        self,
        tip: Sequence[float],
        radius: float,
        semi_angle: float,
        length: float,
        *,
        axis: Sequence[float] = (0.0, 0.0, 1.0),
    ):
        number("radius", radius, 0.0, unit="m")
        slope = math.tan(in_radians("semi_angle", semi_angle, 0.0, 90.0))
        base = radius / slope
        number("length", length, base, unit="m")
        self.tip, along = coordinates("tip", tip), coordinates("axis", axis)
        size = float(np.linalg.norm(along))
        finite = np.isfinite(self.tip).all() and 0.0 < size < np.inf
        if self.tip.shape != (3,) or along.shape != (3,) or not finite:
            raise ParameterError(f"a cone needs a tip and an axis in 3D, got {tip} and {axis}")
        self.axis = np.asarray(along / size, np.float64)
        self.profile = np.array(
            [(0, 0), (radius, base), (radius, length), (-radius, length), (-radius, base)], float
        )

        def contains(x):
            z = (x - self.tip) @ self.axis
            r = np.linalg.norm(x - self.tip - z[:, None] * self.axis, axis=1)
            return (z <= length) & (r <= np.minimum(radius, slope * z))

        ends = self.tip, self.tip + length * self.axis
        across = radius * np.sqrt(np.maximum(1.0 - self.axis**2, 0.0))
        super().__init__(contains, low=np.minimum(*ends) - across, high=np.maximum(*ends) + across)
