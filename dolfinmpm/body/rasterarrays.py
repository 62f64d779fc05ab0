"""Rasters of heights from arrays, and parts of rasters."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinmpm._platform.argumentchecks import coordinates, number, per_direction
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.rasterfiles import Raster

__all__ = ["raster_of_array", "refuse_marks", "windowed"]

# Values by which rasters mark cells without data; and heights that are none
_MARKS = -9999.0, -99999.0, -32767.0, -32768.0
_HIGHEST = 1e30


def raster_of_array(raster: Any, spacing: Any, corner: Any) -> Raster:
    """A raster from an array of heights.

    Args:
        raster: Heights (m), shape (ny, nx), the first row in the south.
        spacing: Distance of neighbouring heights (m): one number, or (dx, dy).
        corner: Position (m) of the first height.

    Raises:
        ParameterError: An argument has another shape, or the spacing is not positive.
    """
    z = coordinates("raster", raster)
    if z.ndim != 2 or min(z.shape) < 2:
        raise ParameterError(
            f"raster has the shape {z.shape} and must have at least two rows and two columns"
        )
    if spacing is None:
        raise ParameterError("an array needs its spacing (m): from_raster(heights, spacing=10.0)")
    size = per_direction("spacing", spacing, 2)
    for one in size:
        number("spacing", float(one), 0.0, unit="m")
    low = coordinates("corner", corner)
    if low.shape != (2,) or not np.isfinite(low).all():
        raise ParameterError(f"corner = {corner} must be two finite coordinates (m)")
    x, y = (a + h * np.arange(n) for a, h, n in zip(low, size, z.shape[::-1]))
    return Raster(x, y, z.T.copy())


def windowed(raster: Raster, window: Any) -> Raster:
    """The nodes of a raster in a window.

    Args:
        raster: The raster.
        window: The window, (x low, y low, x high, y high) (m).

    Raises:
        ParameterError: The window has no size, or has fewer than two heights in a direction.
    """
    x, y, z = raster.x, raster.y, raster.z
    box = coordinates("window", window)
    if box.shape != (4,) or not np.all(box[2:] > box[:2]):
        raise ParameterError(f"window = {window} must be (x low, y low, x high, y high) (m)")
    kept = [(line >= a) & (line <= b) for line, a, b in zip((x, y), box[:2], box[2:])]
    if min(int(one.sum()) for one in kept) < 2:
        raise ParameterError(
            f"window = {window} m has fewer than two heights in a direction; the raster reaches "
            f"from ({x[0]:g}, {y[0]:g}) to ({x[-1]:g}, {y[-1]:g}) m"
        )
    return Raster(x[kept[0]], y[kept[1]], z[np.ix_(*kept)])


def refuse_marks(raster: Raster) -> None:
    """Raise an error where heights are marks of missing data, which nothing has declared.

    Args:
        raster: The raster.

    Raises:
        ParameterError: A height is -9999 m or another common mark, or is beyond 1e30 m.
    """
    z = raster.z
    marked = np.isin(z, _MARKS) | (np.isfinite(z) & (np.abs(z) > _HIGHEST))
    if marked.any():
        raise ParameterError(
            f"{int(marked.sum())} of {z.size} heights are {z[marked][0]:g} m, a mark of missing "
            "data: fill them in, or give a window without them"
        )
