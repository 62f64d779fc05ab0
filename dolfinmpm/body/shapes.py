"""Shapes to fill with material points; they combine with `|`, `&` and `-`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import check_function, coordinates, number, shown
from dolfinmpm._platform.errors import DolfinMPMError, ParameterError
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm._platform.units import in_radians

__all__ = ["Ball", "Box", "Disc", "Polygon", "Shape", "TurnedBox", "Where"]

Array = npt.NDArray[np.float64]

# Length beyond which volumes in 3D are no numbers (m)
_LARGEST = 1e100


class Shape(Unchanged):
    """A region of space, the base class of all shapes; see `Where` for a region by a function.

    Args:
        contains: Function of positions (m), shape (n, gdim), that returns n booleans.
        low: Lower corner of a box around the shape (m), shape (gdim,), or None if not known.
        high: Upper corner of this box (m), shape (gdim,), or None if not known.

    `|` is the union of two shapes, `&` the intersection, and `-` the difference:

    >>> plate = Box((0, 0), (4, 2)) - Box((1, 0.5), (3, 1.5))
    >>> plate.contains(np.array([[0.5, 1.0], [2.0, 1.0]])).tolist()
    [True, False]

    Attributes:
        volume: Volume (m^d), or None if not known, as for combinations; it may be set.
        centroid: Centroid (m), shape (gdim,), or None if not known; it may be set.
    """

    _live = frozenset({"volume", "centroid"})

    volume: float | None = None
    centroid: Array | None = None

    def __init__(
        self,
        contains: Callable[[Array], npt.NDArray[np.bool_]],
        *,
        low: Array | None = None,
        high: Array | None = None,
    ):
        check_function("contains", contains, "of positions that tells which are inside")
        self._contains = contains
        self.low, self.high = (
            end if end is None else coordinates(name, end)
            for name, end in (("low", low), ("high", high))
        )
        ends = [end for end in (self.low, self.high) if end is not None]
        if any(end.ndim != 1 or np.isnan(end).any() or end.shape != ends[0].shape for end in ends):
            raise ParameterError(
                f"low = {shown(low)} and high = {shown(high)} must be corners (m), one number per "
                "direction"
            )

    def __deepcopy__(self, memo: Any) -> Shape:
        """A shape of its own; its arrays are not written after it was made."""
        copied = object.__new__(type(self))
        copied.__dict__.update(self.__dict__)
        return copied

    def __copy__(self) -> Shape:
        return self.__deepcopy__(None)

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        """Refuse `pickle`: a shape is a function of positions."""
        raise ParameterError(
            f"a {type(self).__name__} cannot be pickled, because it holds a function of positions: "
            "make another one with the same arguments; copy.copy works"
        )

    def contains(self, x: Array) -> npt.NDArray[np.bool_]:
        """Whether each position x (m), shape (n, gdim), is in the shape.

        Raises:
            ParameterError: Positions have another dimension, or the shape's function fails.
        """
        x = coordinates("x", x)
        if x.ndim != 2:
            raise ParameterError(
                f"x has the shape {x.shape} and must be positions, a row each: [(0.5, 0.5)]"
            )
        if self.low is not None and x.shape[1] != len(self.low):
            raise ParameterError(
                f"{type(self).__name__} has {len(self.low)} coordinates, the grid has {x.shape[1]}"
            )
        try:
            inside = np.asarray(self._contains(x))
        except DolfinMPMError:
            raise
        except Exception as error:
            raise ParameterError(
                f"{type(self).__name__} failed with {type(error).__name__}: {error}. Its function "
                f"gets coordinates of all {len(x)} positions at once, in {x.shape[1]}D: join "
                "conditions with & and |, each in brackets"
            ) from error
        if inside.shape != (len(x),) or inside.dtype != bool:
            raise ParameterError(
                f"{type(self).__name__} should tell of {len(x)} positions whether they are inside, "
                f"as an array of {len(x)} booleans; it returned {inside.dtype} of shape "
                f"{inside.shape}"
            )
        return inside

    def _joins(self, other: object) -> Shape:
        if not isinstance(other, Shape):
            raise ParameterError(f"shapes combine with shapes only, got a {type(other).__name__}")
        sizes = [len(s.low) for s in (self, other) if s.low is not None]
        if len(set(sizes)) > 1:
            raise ParameterError(
                f"a shape of {sizes[0]} coordinates cannot be combined with one of {sizes[1]}"
            )
        return other

    def __add__(self, other: object) -> Shape:
        raise ParameterError("shapes join with |, overlap with & and are cut with -: write a | b")

    def __or__(self, other: Shape) -> Shape:
        other = self._joins(other)
        low = high = None
        if self.low is not None and other.low is not None:
            low = np.minimum(self.low, other.low)
            high = np.maximum(self.high, other.high)  # type: ignore[arg-type]
        return Shape(lambda x: self.contains(x) | other.contains(x), low=low, high=high)

    def __and__(self, other: Shape) -> Shape:
        other = self._joins(other)
        lows = [s.low for s in (self, other) if s.low is not None]
        highs = [s.high for s in (self, other) if s.high is not None]
        low = np.max(lows, axis=0) if lows else None
        high = np.min(highs, axis=0) if highs else None
        return Shape(lambda x: self.contains(x) & other.contains(x), low=low, high=high)

    def __sub__(self, other: Shape) -> Shape:
        other = self._joins(other)
        return Shape(lambda x: self.contains(x) & ~other.contains(x), low=self.low, high=self.high)


class Box(Shape):
    """An axis-aligned box (an interval in 1D, a rectangle in 2D).

    Args:
        low: Lower corner (m).
        high: Upper corner (m).

    Raises:
        ParameterError: A corner is not finite, or the upper one is not above the lower one.

    >>> import dolfinmpm as mpm
    >>> mpm.Box((0, 0), (4, 2)).volume
    8.0
    """

    low: Array
    high: Array

    def __init__(self, low: float | Sequence[float], high: float | Sequence[float]):
        lower, upper = (
            np.atleast_1d(coordinates(what, at)) for what, at in (("low", low), ("high", high))
        )
        finite = np.isfinite(lower).all() and np.isfinite(upper).all()
        if lower.shape != upper.shape or not finite or np.any(upper <= lower):
            raise ParameterError(
                f"Box needs a lower and a higher corner, got {low} and {high}; "
                "each coordinate of the second must be larger"
            )
        super().__init__(
            lambda x: np.all((x >= lower) & (x <= upper), axis=1), low=lower, high=upper
        )
        self.volume, self.centroid = float(np.prod(upper - lower)), 0.5 * (lower + upper)


class TurnedBox(Shape):
    """A box in 2D or 3D, turned about its middle in the plane of the first two axes.

    Args:
        low: Lower corner (m) before it is turned.
        high: Upper corner (m), likewise.
        angle: Angle (degrees), counter-clockwise.

    Raises:
        ParameterError: The corners are no box, or have fewer than two coordinates, or the angle
            is no finite number.

    Warns:
        DegreesWarning: The angle looks like one in radians.

    >>> import dolfinmpm as mpm
    >>> block = mpm.TurnedBox((0, 0), (4, 2), angle=30)
    >>> block.volume, block.centroid.tolist()
    (8.0, [2.0, 1.0])
    """

    def __init__(self, low: Sequence[float], high: Sequence[float], angle: float):
        self.box = Box(low, high)
        if len(self.box.low) < 2:
            raise ParameterError(f"a turned box needs 2 or 3 coordinates, got {low}")
        angle = in_radians("angle", angle)
        self.middle = 0.5 * (self.box.low + self.box.high)
        self.rotation = np.eye(len(self.middle))
        self.rotation[:2, :2] = [
            [math.cos(angle), -math.sin(angle)],
            [math.sin(angle), math.cos(angle)],
        ]
        reach = np.abs(self.rotation) @ (self.box.high - self.middle)
        super().__init__(
            lambda x: self.box.contains(self.middle + (x - self.middle) @ self.rotation),
            low=self.middle - reach,
            high=self.middle + reach,
        )
        self.volume, self.centroid = self.box.volume, self.middle

    def turn(self, x: Array) -> Array:
        """Positions (m) of points of the box, shape (n, gdim), after it is turned."""
        return self.middle + (x - self.middle) @ self.rotation.T


class Ball(Shape):
    """A ball (a disc in 2D).

    Args:
        centre: Its centre (m).
        radius: Its radius (m).

    Raises:
        ParameterError: The radius is not positive, or the centre not finite.

    >>> import dolfinmpm as mpm
    >>> ball, disc = mpm.Ball((0, 0, 0), radius=1.0), mpm.Disc((0, 0), radius=1.0)
    >>> round(ball.volume, 4), round(disc.volume, 4)
    (4.1888, 3.1416)
    """

    def __init__(self, centre: float | Sequence[float], radius: float):
        radius = number("radius", radius, 0.0, _LARGEST, unit="m")
        middle = np.atleast_1d(coordinates("centre", centre))
        if middle.ndim != 1 or middle.size > 3 or not np.isfinite(middle).all():
            raise ParameterError(f"centre = {centre} m must be one to three finite coordinates")
        super().__init__(
            lambda x: np.sum((x - middle) ** 2, axis=1) <= radius**2,
            low=middle - radius,
            high=middle + radius,
        )
        d = middle.size
        self.volume = math.pi ** (d / 2) / math.gamma(d / 2 + 1) * radius**d
        self.centroid = middle


Disc = Ball


class Polygon(Shape):
    """A polygon in 2D, convex or not.

    Args:
        vertices: Its corners (m) in order, shape (n, 2), n ≥ 3; the last is joined to the first.

    Attributes:
        vertices: Its corners (m), shape (n, 2).
        turn: 1 if they are in counter-clockwise order, else -1.

    Raises:
        ParameterError: The corners are not of that shape or not finite, a corner occurs
            twice, two edges cross or touch, or there is no area.

    >>> import dolfinmpm as mpm
    >>> slope = mpm.Polygon([(0, 0), (6, 0), (6, 1), (4, 1), (2, 3), (0, 3)])
    >>> slope.volume
    12.0
    """

    def __init__(self, vertices: Sequence[Sequence[float]]):
        corners = coordinates("vertices", vertices)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
            raise ParameterError(
                f"Polygon needs corners of shape (n, 2) with n >= 3, got {corners.shape}"
            )

        _check_simple(corners)
        self.vertices = corners
        edges: Any = list(zip(corners, np.roll(corners, -1, axis=0)))

        def contains(x: Array) -> npt.NDArray[np.bool_]:
            inside = np.zeros(len(x), bool)
            for (x0, y0), (x1, y1) in edges:
                if y0 != y1:
                    crosses = (y0 > x[:, 1]) != (y1 > x[:, 1])
                    inside ^= crosses & (x[:, 0] < x0 + (x[:, 1] - y0) * (x1 - x0) / (y1 - y0))
            return inside

        super().__init__(contains, low=corners.min(axis=0), high=corners.max(axis=0))
        # from the first corner, for far from the origin the products would cancel
        a = corners - corners[0]
        b = np.roll(a, -1, axis=0)
        cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        self.volume = 0.5 * abs(float(cross.sum()))
        self.turn = float(np.sign(cross.sum()))
        self.centroid = corners[0] + cross @ (a + b) / (3 * cross.sum())


def _check_simple(corners: Array) -> None:
    """Raise if the polygon is not simple; see `Polygon`."""
    if not np.isfinite(corners).all():
        k = int(np.flatnonzero(~np.isfinite(corners).all(axis=1))[0])
        raise ParameterError(f"corner {k} of the polygon at {corners[k]} m must be finite")
    n, ends = len(corners), np.roll(corners, -1, axis=0)
    size = float(np.ptp(corners, axis=0).max())
    for k, corner in enumerate(corners):
        same = np.flatnonzero(np.abs(corners[k + 1 :] - corner).max(axis=1) <= 1e-12 * size)
        if same.size:
            raise ParameterError(
                f"corners {k} and {k + 1 + same[0]} of the polygon are the same, {corner} m; leave "
                "one out (the last corner is joined to the first by itself)"
            )

    def side(a: Array, b: Array, p: Array) -> Array:
        area = (b - a)[..., 0] * (p - a)[..., 1] - (b - a)[..., 1] * (p - a)[..., 0]
        return np.where(np.abs(area) <= 1e-12 * size**2, 0.0, np.sign(area))

    def within(a: Array, b: Array, p: Array) -> npt.NDArray[np.bool_]:
        slack = 1e-12 * size
        return np.all((p >= np.minimum(a, b) - slack) & (p <= np.maximum(a, b) + slack), axis=-1)

    for k in range(n):
        a, b = corners[k], ends[k]
        others = np.arange(k + 1, n)
        c, d = corners[others], ends[others]
        sides = side(a, b, c), side(a, b, d), side(c, d, a[None]), side(c, d, b[None])
        meet = (sides[0] * sides[1] < 0) & (sides[2] * sides[3] < 0)
        # an end of one edge on the other; edges that follow each other have one in common
        following, preceding = others == k + 1, (others + 1) % n == k
        for which, (start, end, p) in enumerate(((a, b, c), (a, b, d), (c, d, a), (c, d, b))):
            shared = following if which in (0, 3) else preceding
            meet |= (sides[which] == 0) & within(start, end, p) & ~shared
        if meet.any():
            j = int(others[np.argmax(meet)])
            raise ParameterError(
                f"edge {k} of the polygon, from {a} to {b} m, meets edge {j}, from {corners[j]} to "
                f"{ends[j]} m: which side is inside is not known; put the corners in order, or "
                "combine polygons with | and -"
            )


class Where(Shape):
    """All positions at which a function is true.

    Args:
        condition: Function of positions (m), shape (gdim, n), that returns n booleans.
        low, high: Corners of a box around the positions (m), or None if not known.

    >>> import dolfinmpm as mpm
    >>> import numpy as np
    >>> hill = mpm.Where(lambda x: x[1] < 1 + np.sin(x[0]))
    >>> hill.contains(np.array([[1.0, 1.5], [4.0, 1.5]])).tolist()
    [True, False]
    """

    def __init__(
        self,
        condition: Callable[[Array], npt.NDArray[np.bool_]],
        *,
        low: Array | None = None,
        high: Array | None = None,
    ):
        check_function("condition", condition, "of positions that tells which are inside")
        # a copy: functions may change their argument in place
        super().__init__(lambda x: condition(np.array(x.T, order="C")), low=low, high=high)
