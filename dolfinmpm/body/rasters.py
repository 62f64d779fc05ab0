"""Rasters of heights, from arrays and from files, and parts of rasters.

Files are ESRI ASCII grids, and all that rasterio reads, such as GeoTIFF.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import coordinates, number, per_direction, vector
from dolfinmpm._platform.errors import MissingPackageError, ParameterError
from dolfinmpm._platform.filepaths import existing_file, text_of

__all__ = ["Raster", "raster_of_array", "read_raster", "refuse_marks", "windowed"]

Array = npt.NDArray[np.float64]

_HEIGHTS = "nan", "inf", "infinity"
_TEXT = {".asc", ".txt", ".grd"}
_METRES = {"m", "metre", "metres", "meter", "meters"}
_REQUIRED = "ncols", "nrows"
# Values by which rasters mark cells without data; and heights that are none
_MARKS = -9999.0, -99999.0, -32767.0, -32768.0
_HIGHEST = 1e30


@dataclass(frozen=True)
class Raster:
    """Heights at the centres of the cells of a raster.

    Attributes:
        x, y: Coordinates of the centres (m), shapes (nx,) and (ny,), increasing.
        z: Heights (m), shape (nx, ny); nan where the raster has no data.
    """

    x: Array
    y: Array
    z: Array


def read_raster(path: Any) -> Raster:
    """Read a raster. Every rank reads the file.

    Args:
        path: ESRI ASCII grid (.asc, .txt, .grd), or a file that rasterio reads.

    Raises:
        OSError: There is no such file, or it is broken.
        ParameterError: The argument is no path, the raster is turned or has several
            bands, or its unit is no metre.
        MissingPackageError: The file is no ASCII grid, and rasterio is not installed.
    """
    file = existing_file("raster", path)
    return _ascii(file) if file.suffix.lower() in _TEXT else _by_rasterio(file)


def _ascii(file: Path) -> Raster:
    """Read an ESRI ASCII grid; rows go from north to south."""
    words = text_of("raster", file).split()
    header: dict[str, str] = {}
    at = 0
    twice: list[str] = []
    # "nan" and "inf" are heights
    while at + 1 < len(words) and words[at][0].isalpha() and words[at].lower() not in _HEIGHTS:
        twice += [words[at]] * (words[at].lower() in header)
        header[words[at].lower()] = words[at + 1]
        at += 2
    # GDAL writes dx and dy where the cells are no squares
    sizes = ("dx", "dy") if "dx" in header or "dy" in header else ("cellsize", "cellsize")
    missing = [name for name in (*_REQUIRED, *sizes) if name not in header]
    corners = [name for axis in "xy" for name in (f"{axis}llcorner", f"{axis}llcenter")]
    try:
        if twice:
            raise ValueError(f"its header has {twice[0]} twice")
        if missing or sum(name in header for name in corners) != 2:
            raise ValueError(f"its header has {', '.join(header) or 'no entries'}")
        columns, rows = int(header["ncols"]), int(header["nrows"])
        size = [float(header[name]) for name in sizes]
        low = []
        for axis, half in zip("xy", size):
            centred = f"{axis}llcenter" in header
            given = float(header[f"{axis}llcenter" if centred else f"{axis}llcorner"])
            low.append(given if centred else given + 0.5 * half)
        values = np.array(words[at:], np.float64)
        if not all(0.0 < one < np.inf for one in size) or not np.isfinite(low).all():
            raise ValueError(f"its cells are {size} m large, and its corner is at {low} m")
        if min(columns, rows) < 1 or values.size != columns * rows:
            raise ValueError(f"it has {values.size} heights, not {columns} x {rows}")
        none = float(header.get("nodata_value", -9999.0))
    except ValueError as error:
        raise OSError(
            f"{file} is no ESRI ASCII grid: {error}; the header needs ncols, nrows, xllcorner, "
            "yllcorner and cellsize (or dx and dy), and one height per cell follows"
        ) from error
    values[values == none] = np.nan
    z = values.reshape(rows, columns)[::-1].T
    x, y = (at + step * np.arange(n) for at, step, n in zip(low, size, (columns, rows)))
    return Raster(x, y, np.ascontiguousarray(z))


def _by_rasterio(file: Path) -> Raster:
    """Read a file of rasterio, which has one band."""
    try:
        import rasterio
    except ImportError:
        raise MissingPackageError(
            f"{file} needs rasterio: pip install rasterio; ESRI ASCII grids (.asc) need nothing, "
            "and gdal_translate -of AAIGrid writes them"
        ) from None
    try:
        with rasterio.open(file) as data:
            band = data.read(1, masked=True).astype(np.float64).filled(np.nan)
            to, system = data.transform, data.crs
            # files of whole numbers store heights by a scale
            scale, offset, unit = data.scales[0], data.offsets[0], data.units[0]
            bands = data.count
    except rasterio.errors.RasterioError as error:
        raise OSError(f"rasterio cannot read {file}: {error}") from error
    if bands != 1:
        raise ParameterError(
            f"the raster {file} has {bands} bands, and a raster of heights has one: take out "
            "that of the heights, gdal_translate -b 1 for the first"
        )
    _check_units(file, system, unit)
    if to.b != 0.0 or to.d != 0.0:
        raise ParameterError(
            f"the raster {file} is turned against north (terms {to.b:g} and {to.d:g} of its "
            "transform must be 0): resample it with gdalwarp"
        )
    x = to.c + to.a * (np.arange(band.shape[1]) + 0.5)
    y = to.f + to.e * (np.arange(band.shape[0]) + 0.5)
    z = scale * band.T + offset
    if to.a < 0.0:
        x, z = x[::-1], z[::-1]
    if to.e < 0.0:
        y, z = y[::-1], z[:, ::-1]
    return Raster(x.copy(), y.copy(), np.ascontiguousarray(z))


def _check_units(file: Path, system: Any, unit: str | None) -> None:
    """Check that coordinates and heights are in metres, as far as the file tells.

    Args:
        file: The file, for messages.
        system: Coordinate reference system of rasterio, or None.
        unit: Unit of the heights, or None.

    Raises:
        ParameterError: Coordinates are in degrees or feet, or heights are not in metres.
    """
    if system and system.is_geographic:
        raise ParameterError(
            f"the raster {file} has coordinates in degrees, not in metres: project it with "
            "gdalwarp -t_srs, to UTM for instance"
        )
    if system and system.is_projected and abs(system.linear_units_factor[1] - 1.0) > 1e-9:
        raise ParameterError(
            f"the raster {file} has coordinates in {system.linear_units}, not in metres: project "
            "it with gdalwarp -t_srs"
        )
    if unit and unit.lower() not in _METRES:
        raise ParameterError(
            f"the raster {file} has heights in '{unit}', not in metres: convert them, and give "
            "them as an array, or set the unit of the file with gdal_edit -units m"
        )


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
    low = vector("corner", corner, 2, "m")
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
