"""The ground as it is surveyed: surfaces from rasters and boreholes, and the bodies below them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import (
    check_function,
    check_kind,
    coordinates,
    number,
    shown,
    vector,
    whole,
)
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm.body.heightvolumes import closed_mesh, volume_between
from dolfinmpm.body.rasters import raster_of_array, read_raster, refuse_marks, windowed
from dolfinmpm.body.shapes import Polygon, Shape
from dolfinmpm.grid.userfunctions import call_function

__all__ = ["GroundBelow", "Terrain"]

Array = npt.NDArray[np.float64]

# Positions this far outside the raster, as a share of its size, are on its edge
_SLACK = 1e-9
# Most parts of a section
_MOST_PARTS = 100_000


class Terrain(Unchanged):
    """A surface of heights: bilinear between the nodes of a raster, linear along a section in 2D.

    A terrain is a function of positions x, shape (gdim, n), that returns n heights. So it serves as
    `surface` and `water_table` of a `Deposit`, and as `bottom` of a `Layer`. Beyond its edges it
    goes on level. `ground` is the body below the surface, for `fill`. `solid` is a rigid bed for
    `RigidBody`.

    Args:
        lines: Coordinates of the raster's lines (m): (x, y) in 3D, (x,) in 2D, each increasing.
        heights: Heights at the nodes (m), shape (nx, ny), or (nx,) in 2D.

    Attributes:
        lines, heights: The arguments, as arrays.
        gdim: Dimension of space: 2 or 3.

    Raises:
        ParameterError: The lines do not increase, or heights are not finite or have another shape.

    A hillside that falls by 1 m over 4 m, and the volume of ground above z = 0:

    >>> import dolfinmpm as mpm
    >>> hill = mpm.Terrain(([0, 4], [0, 2]), [[3, 3], [2, 2]])
    >>> hill([[1.0], [0.5]]).tolist(), hill.ground(bottom=0.0).volume
    ([2.75], 20.0)
    """

    def __init__(self, lines: Sequence[Any], heights: Any):
        several = lines if isinstance(lines, Sequence) or np.ndim(lines) > 0 else ()
        own = tuple(coordinates("lines", line) for line in several)
        z = coordinates("heights", heights)
        if not 1 <= len(own) <= 2 or any(line.ndim != 1 or line.size < 2 for line in own):
            raise ParameterError(
                "a terrain needs lines (x, y), or (x,) in 2D, of at least two coordinates each, as "
                "in mpm.Terrain(([0, 10, 30],), [8, 8, 2]); "
                f"got shapes {[line.shape for line in own]}"
            )
        for name, line in zip("xy", own):
            if not np.isfinite(line).all() or not np.all(np.diff(line) > 0.0):
                raise ParameterError(f"the {name} of the lines of a terrain must increase")
        if z.shape != tuple(line.size for line in own):
            raise ParameterError(
                f"heights have the shape {z.shape} and must have one value per node, "
                f"{tuple(line.size for line in own)}: the first index goes along x"
            )
        bad = np.argwhere(~np.isfinite(z))
        if len(bad):
            at = [float(line[k]) for line, k in zip(own, bad[0])]
            raise ParameterError(
                f"{len(bad)} of {z.size} heights are not known, such as that at {at} m: give a "
                "window without gaps, or fill them in"
            )
        self.lines, self.heights, self.gdim = own, z, len(own) + 1

    @classmethod
    def from_raster(
        cls,
        raster: Any,
        *,
        spacing: float | Sequence[float] | None = None,
        corner: Sequence[float] = (0.0, 0.0),
        window: Sequence[float] | None = None,
        origin: Sequence[float] = (0.0, 0.0),
    ) -> Terrain:
        """A terrain from a raster of heights.

        Args:
            raster: A file: an ESRI ASCII grid (.asc), or what rasterio reads, such as GeoTIFF. Or
                an array of heights (m), shape (ny, nx), with the first row in the south.
            spacing: Distance of neighbouring heights of an array (m): one number, or (dx, dy).
            corner: Position (m) of the first height of an array.
            window: Part to take, (x low, y low, x high, y high) in the raster's coordinates (m).
                By default all of it.
            origin: Position in the raster's coordinates (m) that becomes (0, 0). Heights keep
                their datum.

        Raises:
            ParameterError: An argument is out of range, heights in the window are not known, or
                the file says that it is not in metres.
            OSError: The file is missing or broken.
            MissingPackageError: The file needs rasterio, and rasterio is not installed.

        >>> import dolfinmpm as mpm
        >>> valley = mpm.Terrain.from_raster([[4, 2, 4], [3, 1, 3]], spacing=10.0)
        >>> valley([[10.0], [5.0]]).tolist()
        [1.5]
        """
        if isinstance(raster, (str, os.PathLike)):
            if spacing is not None:
                raise ParameterError(
                    "spacing is for arrays: a file has its own spacing; leave it out"
                )
            found = read_raster(raster)
        else:
            found = raster_of_array(raster, spacing, corner)
        if window is not None:
            found = windowed(found, window)
        refuse_marks(found)
        shift = vector("origin", origin, 2, "m")
        return cls((found.x - shift[0], found.y - shift[1]), found.z)

    def from_boreholes(
        self, positions: Any, heights: Any, *, most: Terrain | None = None
    ) -> Terrain:
        """The boundary of a layer, between the heights that boreholes found, on these lines.

        Heights are interpolated by radial functions −|r|, which is universal kriging with a linear
        variogram (Matheron 1969): exact at the boreholes, and a plane where the boreholes are on
        one. With fewer than three boreholes, or with all on one line, the trend is level.

        Args:
            positions: Positions of the boreholes (m), shape (n, 2), or (n,) in 2D.
            heights: Heights of the boundary there (m), shape (n,).
            most: Upper bound of the boundary: the surface, or the boundary above. By default this
                terrain.

        Raises:
            ParameterError: The arrays do not fit each other, or two boreholes are at one place.

        >>> import dolfinmpm as mpm
        >>> flat = mpm.Terrain(([0, 10], [0, 10]), [[5, 5], [5, 5]])
        >>> clay = flat.from_boreholes([(0, 0), (10, 0), (0, 10)], [1.0, 2.0, 1.0])
        >>> clay([[5.0], [5.0]]).round(9).tolist()
        [1.5]
        """
        from scipy.interpolate import RBFInterpolator
        from scipy.spatial.distance import pdist

        at, z = coordinates("positions", positions), coordinates("heights", heights)
        at = at[:, None] if at.ndim == 1 and self.gdim == 2 else at
        if at.ndim != 2 or at.shape[1] != self.gdim - 1 or z.shape != (len(at),) or not len(at):
            raise ParameterError(
                f"positions have the shape {at.shape} and heights {z.shape}: give one position of "
                f"{self.gdim - 1} coordinates and one height per borehole"
            )
        if not np.isfinite(at).all() or not np.isfinite(z).all():
            raise ParameterError("positions and heights of boreholes must be finite")
        apart = pdist(at).min(initial=np.inf)
        if apart <= _SLACK * np.ptp(at, axis=0).max():
            raise ParameterError("two boreholes are at the same position: give their mean")
        nodes = np.stack(np.meshgrid(*self.lines, indexing="ij"), axis=-1).reshape(
            -1, self.gdim - 1
        )
        if len(at) == 1:
            found = np.full(len(nodes), z[0])
        else:
            spread = np.linalg.svd(at - at.mean(axis=0), compute_uv=False)
            plane = len(at) >= self.gdim and spread[-1] > 1e-6 * spread[0]
            rule = RBFInterpolator(at, z, kernel="linear", degree=int(plane))
            found = rule(nodes)
        bound = self if most is None else most
        check_function("most", bound, "of positions, such as a Terrain")
        places = np.column_stack([nodes, 0 * nodes[:, :1]])
        found = np.minimum(found, call_function("most", bound, places))
        return Terrain(self.lines, found.reshape(self.heights.shape))

    def __call__(self, x: Any) -> Array:
        """Heights (m) at positions x (m), shape (gdim, n) or (gdim - 1, n); shape (n,).

        Raises:
            ParameterError: Positions have another dimension.
        """
        at = coordinates("x", x)
        if at.ndim != 2 or at.shape[0] not in (self.gdim - 1, self.gdim):
            raise ParameterError(
                f"x has the shape {at.shape} and must have one row per coordinate, shape "
                f"({self.gdim}, n)"
            )
        return _interpolated(self.lines, self.heights, at[: self.gdim - 1])

    def section(self, start: Sequence[float], end: Sequence[float], *, count: int = 0) -> Terrain:
        """A vertical section of a terrain in 3D, as a terrain in 2D.

        Args:
            start, end: Ends of the section (m), shape (2,). The new x is the distance from `start`.
            count: Number of equal parts of the section. By default the section has nodes where it
                meets lines of the raster.

        Raises:
            ParameterError: The terrain is a section already, or the ends are at one place.

        >>> import dolfinmpm as mpm
        >>> hill = mpm.Terrain(([0, 4], [0, 3]), [[0, 0], [2, 2]])
        >>> cut = hill.section((0, 0), (4, 3))
        >>> cut.lines[0].tolist(), cut.heights.tolist()
        ([0.0, 5.0], [0.0, 2.0])
        """
        a, b = coordinates("start", start), coordinates("end", end)
        if self.gdim != 3 or a.shape != (2,) or b.shape != (2,) or not np.any(a != b):
            raise ParameterError(
                "a section of a terrain in 3D needs two different ends (x, y), got "
                f"{start} and {end}"
            )
        low, high = np.array([line[[0, -1]] for line in self.lines]).T
        slack = _SLACK * np.max(high - low)
        if not all(np.all((low - slack <= at) & (at <= high + slack)) for at in (a, b)):
            raise ParameterError(
                f"start = {shown(start)} and end = {shown(end)} m must be within the raster, from "
                f"{low} to {high} m"
            )
        whole("count", count, 0, _MOST_PARTS)
        share = np.linspace(0.0, 1.0, max(count, 1) + 1)
        if count == 0:
            for k, line in enumerate(self.lines):
                if a[k] != b[k]:
                    share = np.concatenate([share, (line - a[k]) / (b[k] - a[k])])
            share = np.unique(share[(share >= 0.0) & (share <= 1.0)].round(12))
        z = self(a[:, None] + (b - a)[:, None] * share)
        return Terrain((share * float(np.linalg.norm(b - a)),), z)

    def raised(self, thickness: Any) -> Terrain:
        """A terrain with a layer on top, such as the snow or debris that is let go.

        Args:
            thickness: Thickness (m): a number, or values at the nodes, of the shape of `heights`.

        Raises:
            ParameterError: The thickness has another shape.
        """
        more = coordinates("thickness", thickness)
        if more.shape not in ((), self.heights.shape):
            raise ParameterError(
                f"thickness has the shape {more.shape} and must be a number or have the shape "
                f"{self.heights.shape}, one value per node"
            )
        return Terrain(self.lines, self.heights + more)

    def ground(
        self,
        bottom: float | Terrain,
        *,
        low: Sequence[float] | float | None = None,
        high: Sequence[float] | float | None = None,
    ) -> GroundBelow:
        """The body between this surface and a bottom, with exact volume and centroid, for `fill`.

        Args:
            bottom: Height (m), or the terrain below, on lines of its own.
            low, high: Horizontal corners of the body (m). By default those of the raster.

        Raises:
            ParameterError: The corners are outside the raster, or the body is empty.
        """
        return GroundBelow(self, bottom, low, high)

    def solid(self, bottom: float) -> Any:
        """A rigid bed below the surface, for `RigidBody`: a mesh of triangles, or in 2D a polygon.

        Two triangles divide each cell of the raster along its lower diagonal. So the bed is within
        the ground below the bilinear surface, and ground on top of it is outside the bed.

        Args:
            bottom: Height of the level bottom (m), below the surface.

        Raises:
            ParameterError: The bottom is not below the surface.
        """
        number("bottom", bottom, unit="m")
        if bottom >= self.heights.min():
            raise ParameterError(
                f"bottom = {bottom:g} m must be below the lowest height, {self.heights.min():g} m"
            )
        if self.gdim == 2:
            (x,) = self.lines
            top = np.column_stack([x, self.heights])[::-1]
            return Polygon([(x[0], bottom), (x[-1], bottom), *top])
        x, y = self.lines
        return closed_mesh(x, y, self.heights, float(bottom))


class GroundBelow(Shape):
    """The body between a terrain and a bottom; see `Terrain.ground`.

    Args:
        top: The surface.
        bottom: Height (m), or the terrain below.
        low, high: Horizontal corners (m), or None for those of the surface.

    Raises:
        ParameterError: The corners are outside the raster, or the body is empty.
    """

    def __init__(self, top: Terrain, bottom: float | Terrain, low: Any = None, high: Any = None):
        check_kind("top", top, Terrain, "make it with mpm.Terrain.from_raster")
        both = [top]
        if isinstance(bottom, Terrain):
            if bottom.gdim != top.gdim:
                raise ParameterError("surface and bottom must both be sections, or both be in 3D")
            both.append(bottom)
        else:
            number("bottom", bottom, unit="m")
        least = np.max([[line[0] for line in one.lines] for one in both], axis=0)
        most = np.min([[line[-1] for line in one.lines] for one in both], axis=0)
        if np.any(least >= most):
            raise ParameterError(
                f"surface and bottom have no common ground: one begins at {least} m, where the "
                f"other has ended at {most} m"
            )
        first = least if low is None else np.atleast_1d(coordinates("low", low))
        last = most if high is None else np.atleast_1d(coordinates("high", high))
        slack = _SLACK * (most - least)
        if first.shape != least.shape or last.shape != least.shape:
            raise ParameterError(f"low and high must have {least.size} horizontal coordinates")
        if np.any(first < least - slack) or np.any(last > most + slack) or np.any(last <= first):
            raise ParameterError(
                f"low = {first} and high = {last} m must be corners within the raster, from "
                f"{least} to {most} m"
            )
        # on the lines of both rasters, both surfaces stay as they are
        lines = []
        for k, (a, b) in enumerate(zip(first, last)):
            own = np.unique(np.concatenate([one.lines[k] for one in both]))
            lines.append(np.concatenate([[a], own[(own > a) & (own < b)], [b]]))
        nodes = np.stack(np.meshgrid(*lines, indexing="ij")).reshape(len(lines), -1)
        upper = top(nodes)
        lower = bottom(nodes) if isinstance(bottom, Terrain) else np.full(upper.size, float(bottom))
        if top.gdim == 2:
            # a strip of width 1
            lines, upper, lower = [*lines, np.array([0.0, 1.0])], upper.repeat(2), lower.repeat(2)
        shape = tuple(line.size for line in lines)
        volume, middle = volume_between(
            lines[0], lines[1], upper.reshape(shape), lower.reshape(shape)
        )
        if not volume > 0.0:
            raise ParameterError(
                f"the ground is empty: its surface, at most {upper.max():g} m high, is nowhere "
                f"above its bottom, at least {lower.min():g} m high"
            )
        thick = upper > lower

        def contains(x: Array) -> npt.NDArray[np.bool_]:
            at = x[:, :-1]
            inside = np.all((at >= first) & (at <= last), axis=1)
            inside &= x[:, -1] <= top(x.T)
            return inside & (x[:, -1] >= (bottom(x.T) if isinstance(bottom, Terrain) else bottom))

        super().__init__(
            contains,
            low=np.array([*first, lower[thick].min()]),
            high=np.array([*last, upper[thick].max()]),
        )
        self.volume = volume
        self.centroid = middle if top.gdim == 3 else middle[[0, 2]]


def _interpolated(lines: Sequence[Array], z: Array, at: Array) -> Array:
    """Multilinear interpolation; positions outside take the nearest edge."""
    cells, shares = [], []
    for line, x in zip(lines, at):
        k = np.clip(np.searchsorted(line, x, side="right") - 1, 0, line.size - 2)
        cells.append(k)
        shares.append(np.clip((x - line[k]) / (line[k + 1] - line[k]), 0.0, 1.0))
    if len(lines) == 1:
        (i,), (s,) = cells, shares
        return np.asarray((1 - s) * z[i] + s * z[i + 1])
    (i, j), (s, t) = cells, shares
    first = (1 - s) * z[i, j] + s * z[i + 1, j]
    return np.asarray((1 - t) * first + t * ((1 - s) * z[i, j + 1] + s * z[i + 1, j + 1]))
