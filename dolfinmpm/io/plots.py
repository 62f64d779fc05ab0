"""Pictures of material points."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import (
    array_of,
    check_kind,
    choice,
    floats,
    number,
    shown,
    truth,
)
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, call_together
from dolfinmpm.body.location import bounds
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.rigidbody import RigidBody, check_bodies
from dolfinmpm.grid.lattice import lattice_of
from dolfinmpm.io.figures import check_picture, check_size, two_numbers
from dolfinmpm.io.frames import is_derived, present_frame
from dolfinmpm.io.gridlines import grid_lines
from dolfinmpm.io.scene import Scene

__all__ = [
    "check_colour",
    "check_limits",
    "default_draw",
    "label_of",
    "plot",
    "prefix_of",
    "scalar_of",
]

Array = npt.NDArray[Any]
_AXES = "xyz"
DRAW = ("deformed", "domains", "dots")
_SYMBOLS = {"stress": r"\sigma", "displacement": "u"}


@collective
def plot(
    points: MaterialPoints,
    path: str | os.PathLike[str],
    colour: str = "stress",
    *,
    component: int | tuple[int, int] | str | None = None,
    draw: str | None = None,
    cut: tuple[str, float] | None = None,
    limits: tuple[float, float] | None = None,
    view: str | tuple = "grid",
    grid: bool = True,
    max_aspect: float = 5.0,
    title: str = "",
    label: str | None = None,
    cmap: str = "viridis",
    size: tuple[float, float] = (3.5, 4.2),
    dpi: int = 300,
    bodies: Sequence[RigidBody] = (),
) -> None:
    """Draw the material points, coloured by a field. Rank 0 writes the picture. Collective.

    In 1D the field is drawn over the position. In 3D the points are dots in perspective. With a
    cut plane, 3D points on the plane are drawn as in 2D.

    Args:
        points: Material points.
        path: Picture to write. Its ending selects the format (.png, .pdf, ...). Parent folders
            are created.
        colour: Name of a field of the points, or "displacement" (m).
        component: For a vector: the direction, from 0; by default the magnitude. For a tensor:
            (i, j), "mean" (a third of the trace of a 3 × 3 tensor) or "mises"; by default the
            normal component of the last direction, which is vertical.
        draw: "deformed" (the points' first domains, deformed by F), "domains" (2 l wide, as in
            GIMP) or "dots". The default is "deformed" on rectangular grids. It is "dots" on other
            grids, because domains do not fill the body there.
        cut: Direction and position (m) of the plane through 3D points: ("y", 0.5).
        limits: Range of colours, in the field's unit; by default the range of the values.
        view: "grid", "points" or ranges (m) of the two axes, ((x0, x1), (y0, y1)).
        grid: Whether the lines of the background grid are drawn, or those of the leaves of its
            last refined space.
        max_aspect: Largest ratio of the picture's sides. Beyond it the short direction is
            stretched, and its axis shows the factor. math.inf never stretches.
        title: Text above the picture.
        label: Text beside the colour bar; name, symbol and unit by default.
        cmap: Matplotlib colour map.
        size: Largest width and height of the axes with the colour bar (inch).
        dpi: Dots per inch.
        bodies: Rigid bodies to draw at their present positions.

    Raises:
        ParameterError: An argument has the wrong type or value, or no point is in view.
        OSError: The file cannot be written.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> file = Path(mkdtemp(), "points.png")
    >>> mpm.plot(points, file, "displacement", size=(2, 2), dpi=50)
    >>> file.stat().st_size > 1000
    True
    """
    check_kind("points", points, MaterialPoints, "plot(points, path)")
    draw = choice("draw", default_draw(points) if draw is None else draw, DRAW)
    truth("grid", grid)

    def check() -> None:
        check_colour(points, colour, component, cut, view)
        check_limits(limits)
        check_kind("title", title, str, "the text above the picture")
        check_kind("label", "" if label is None else label, str, "the text beside the colour bar")
        check_size(size, dpi)
        check_bodies(bodies, points.gdim)
        number("max_aspect", max_aspect, 1.0, math.inf, closed=True)
        if points.comm.rank == 0:  # the others need no Matplotlib
            check_picture(path, cmap)

    call_together(points.comm, check)
    extent = np.column_stack(bounds(points.grid))
    lines = grid_lines(points.grid, cut) if grid and points.gdim > 1 else None
    frame = present_frame(points, colour, bodies, extent)

    def draw_on_root() -> None:
        if frame is None:
            return
        unit = points.unit_of(colour)
        scalars, symbol = scalar_of(frame.values, component, points.gdim)
        missing = np.flatnonzero(~np.isfinite(scalars))
        if missing.size and limits is None:
            raise ParameterError(
                f"'{colour}' is {scalars[missing[0]]} at {missing.size} of {len(frame.x)} points, "
                f"as at {frame.x[missing[0]]} m; give limits to leave such points blank"
            )
        scale, prefix = prefix_of(scalars, limits) if unit == "Pa" else (1.0, "")
        scene = Scene(
            frame.x, frame.edges(draw), scalars / scale,
            label or label_of(colour, symbol, prefix + unit), draw == "dots", lines,
            None if limits is None else np.divide(limits, scale), max_aspect, cmap, size,
            frame.bodies,
        )  # fmt: skip
        scene.write(path, extent, view, cut, title, dpi)

    call_together(points.comm, draw_on_root)


def default_draw(points: MaterialPoints) -> str:
    """How points are drawn by default. Collective."""
    return "dots" if lattice_of(points.grid) is None else "deformed"


def check_limits(limits: Any) -> None:
    """Raise ParameterError unless a range of colours is None, or two numbers that rise."""
    if limits is not None and not np.less(*two_numbers("limits", limits)):
        raise ParameterError(f"limits = {shown(limits)} must rise, from the lowest to the highest")


def _components(shape: tuple[int, ...]) -> str:
    """The components that a field of a shape has, in words."""
    if len(shape) == 1:
        return f"give a direction from 0 to {shape[0] - 1}, such as 1 for y"
    if len(shape) == 2:
        words = ', "mean" or "mises"' if shape == (3, 3) else ""
        return f"give a pair of directions from 0, such as (1, 1) for yy{words}"
    return "leave it out"


def check_colour(points, colour, component, cut, view) -> None:
    """Raise ParameterError if the points lack a field, component or direction of `plot`."""
    known = [*points.fields, "displacement"]
    if not isinstance(colour, str) or colour not in known:
        raise ParameterError(f"no field {shown(colour)} to colour by; there are {', '.join(known)}")
    shape = (points.gdim,) if is_derived(points, colour) else points[colour].shape[1:]
    if isinstance(component, str):
        fits = component in ("mean", "mises") and shape == (3, 3)
    else:
        index = () if component is None else tuple(np.ravel(array_of("component", component)))
        fits = len(shape) <= 2 and len(index) == (0 if component is None else len(shape))
        fits = fits and all(_is_index(i, n) for i, n in zip(index, shape))
    if not fits:
        raise ParameterError(
            f"component = {shown(component)} does not fit '{colour}' of shape {shape}: "
            f"{_components(shape)}"
        )
    pair = isinstance(cut, (tuple, list)) and len(cut) == 2
    if cut is not None and not (points.gdim == 3 and pair and cut[0] in tuple(_AXES)):
        raise ParameterError(f'cut = {shown(cut)} must be as ("y", 0.5), for points in 3D')
    if cut is not None:
        number("the position of the cut", cut[1], unit="m")
    axes = points.gdim - (cut is not None)
    if isinstance(view, str):
        choice("view", view, ("grid", "points"))
        return
    box = floats(view)
    if (
        box is None
        or box.shape != (axes, 2)
        or not (np.isfinite(box).all() and (box[:, 0] < box[:, 1]).all())
    ):
        raise ParameterError(
            f'view = {shown(view)} must be "grid", "points" or {axes} rising ranges (m)'
        )


def _is_index(i: Any, n: int) -> bool:
    return isinstance(i, (int, np.integer)) and not isinstance(i, bool) and bool(0 <= i < n)


def scalar_of(values: Array, component, gdim: int) -> tuple[Array, str]:
    """The number to colour by, shape (n,), and its printed index."""
    if values.ndim == 1:
        return values.astype(float), ""
    if isinstance(component, str):
        mean = np.trace(values, axis1=1, axis2=2) / 3
        if component == "mean":
            return mean, "mean"
        deviator = values - mean[:, None, None] * np.eye(3)
        return np.sqrt(1.5 * np.sum(deviator**2, axis=(1, 2))), "Mises"
    if component is None and values.ndim == 2 and values.shape[1] > 1:
        return np.linalg.norm(values, axis=1), "magnitude"
    if component is None:
        component = (min(gdim, *values.shape[1:]) - 1,) * (values.ndim - 1)
    index = tuple(np.atleast_1d(component))
    names = _AXES if max(values.shape[1:]) <= 3 else "0123456789"
    return values[(slice(None), *index)], "".join(names[i] for i in index)


def label_of(name: str, index: str, unit: str) -> str:
    """Text beside the colour bar."""
    unit = re.sub(r"\^(\d+)", r"$^{\1}$", unit)
    name = name.replace("_", " ")
    if index in ("mean", "Mises", "magnitude"):
        symbol = {"mean": "mean ", "Mises": "von Mises ", "magnitude": ""}[index] + name
    else:
        letter = _SYMBOLS.get(name, name if len(name) == 1 else rf"\mathrm{{{name}}}")
        symbol = f"${letter}{f'_{{{index}}}' if index else ''}$".replace(" ", r"\ ")
        if name in _SYMBOLS:
            symbol = f"{name} {symbol}"
    return f"{symbol.strip()} ({unit})" if unit else symbol.strip()


def prefix_of(values: Array, limits) -> tuple[float, str]:
    """The power of 1000 that makes pressures short to print."""
    largest = np.abs(values if limits is None else limits).max(initial=0.0)
    for scale, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if largest >= scale:
            return scale, prefix
    return 1.0, ""
