"""Pictures of material points, and one look for all pictures."""

from __future__ import annotations

import contextlib
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.checks import check_kind, choice, file_path, number, shown
from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm._platform.errors import ParameterError, call_together, raise_together
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.lattice import lattice_of

__all__ = ["figure", "plot"]

Array = npt.NDArray[Any]
_AXES = "xyz"
_DRAW = ("deformed", "domains", "dots")
_SYMBOLS = {"stress": r"\sigma", "displacement": "u"}
# beyond these the grid would be a grey veil, not lines
_MOST_CELLS, _MOST_LINES_PER_INCH = 200_000, 25
# Okabe & Ito's colours can be told apart by the colour-blind
_LOOK = {
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.formatter.min_exponent": 2,
    "axes.axisbelow": True,
    "axes.prop_cycle": "cycler('color', ['0072B2', 'D55E00', '009E73', 'CC79A7', "
    "'E69F00', '56B4E9', '000000'])",
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "mathtext.fontset": "dejavusans",
}


@contextlib.contextmanager
def figure(
    path: str | os.PathLike[str],
    width: float = 3.5,
    height: float = 2.6,
    dpi: int = 300,
    **subplots: Any,
) -> Iterator[tuple[Any, Any]]:
    """A Matplotlib figure in the look of all pictures, saved when its context ends.

    `with mpm.figure("output/error.png") as (fig, ax): ax.loglog(h, error)`. Not
    collective: all ranks may enter or rank 0 alone, and only rank 0 saves.

    Args:
        path: File to write; its ending chooses the format (.png, .pdf, ...). Parent
            folders are created.
        width: Width (inch); 3.5 is one column of a paper.
        height: Height (inch).
        dpi: Dots per inch.
        subplots: Arguments of Matplotlib's `Figure.subplots`, such as nrows and ncols.

    Raises:
        ParameterError: An argument is not what it may be.
        OSError: The file cannot be written; on rank 0 only.
    """
    import matplotlib
    from matplotlib.figure import Figure

    _check_picture(path)
    _check_looks(None, math.inf, (width, height), dpi)
    with matplotlib.rc_context(_LOOK):
        result = Figure(figsize=(width, height), layout="constrained")
        try:
            axes = result.subplots(**subplots)
        except (TypeError, ValueError) as error:
            raise ParameterError(
                f"figure cannot make its axes: {error}; it takes the arguments of Matplotlib's "
                "Figure.subplots"
            ) from error
        yield result, axes
        if MPI.COMM_WORLD.rank == 0:
            _save(result, path, dpi)


def plot(
    points: MaterialPoints,
    path: str | os.PathLike[str],
    colour: str = "stress",
    component: int | tuple[int, int] | str | None = None,
    *,
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
) -> None:
    """Draw the material points coloured by a field; rank 0 writes the picture. Collective.

    In 1D the field is drawn over the position; in 3D the points as dots in
    perspective, or those that a plane cuts as in 2D.

    Args:
        points: Material points.
        path: Picture to write; its ending chooses the format (.png, .pdf, ...).
            Parent folders are created.
        colour: Name of a field of the points, or "displacement" (m).
        component: Of a vector the direction, from 0, its magnitude by default; of a
            tensor (i, j), "mean" (a third of the trace of a 3 × 3 one) or "mises",
            by default the normal component of the last direction, the vertical one.
        draw: "deformed" (the points' first domains under F), "domains" (2 l wide,
            as GIMP uses them) or "dots"; by default the first on rectangular grids,
            else dots, for there the domains do not fill the body.
        cut: Direction and position (m) of the plane through 3D points: ("y", 0.5).
        limits: Range of colours, in the field's unit; that of the values by default.
        view: "grid", "points" or ranges (m) of the two axes, ((x0, x1), (y0, y1)).
        grid: Whether the background grid's lines are drawn.
        max_aspect: Ratio of the picture's sides beyond which the short direction is
            stretched, by a factor that its axis then tells; math.inf for never.
        title: Text above the picture.
        label: Text beside the colour bar; name, symbol and unit by default.
        cmap: Matplotlib colour map.
        size: Largest width and height of the axes with the colour bar (inch).
        dpi: Dots per inch.

    Raises:
        ParameterError: An argument is not of the kind above, or no point is seen.
        OSError: The file cannot be written.
    """
    check_kind("points", points, MaterialPoints, "plot(points, path)")
    if draw is None:
        draw = "dots" if lattice_of(points.grid) is None else "deformed"
    draw = choice("draw", draw, _DRAW)
    derived = colour == "displacement" and colour not in points.fields

    def check() -> None:
        _check_scene(points, colour, component, cut, view, derived)
        _check_looks(limits, max_aspect, size, dpi)
        if points.comm.rank == 0:  # the others need no Matplotlib
            _check_picture(path, cmap)

    call_together(points.comm, check)
    extent = _extent(points.grid)
    lines = _grid_lines(points.grid, cut) if grid and points.gdim > 1 else None
    gathered = points.gather("x", "F", "l", "l0", "x0" if derived else colour)
    error: Exception | None = None
    if gathered is not None:
        x, F, half, half0, values = gathered
        unit = "m" if derived else getattr(getattr(points, colour, None), "unit", "")
        scalars, symbol = _scalar(x - values if derived else values, component, points.gdim)
        missing = np.flatnonzero(~np.isfinite(scalars))
        if missing.size and limits is None:
            error = ParameterError(
                f"'{colour}' is {scalars[missing[0]]} at {missing.size} of {len(x)} points, as at "
                f"{x[missing[0]]} m; give limits to leave such points blank"
            )
        scale, prefix = _prefix(scalars, limits) if unit == "Pa" else (1.0, "")
        unit = prefix + unit.replace("^d", f"^{points.gdim}")
        # columns are the half-edges of the points' domains
        edges = half[:, None] * np.eye(points.gdim) if draw == "domains" else F * half0[:, None]
        scene = _Scene(
            x, edges, scalars / scale, label or _label(colour, symbol, unit), draw == "dots", lines,
            None if limits is None else np.divide(limits, scale), max_aspect, cmap, size,
        )  # fmt: skip
        try:
            if error is not None:
                raise error
            scene.write(path, extent, view, cut, title, dpi)
        except Exception as cause:
            # whatever it is, the other ranks wait
            error = cause
    raise_together(points.comm, error)


@dataclass
class _Scene:
    """What is drawn: positions, half-edges of domains, scalars, and how."""

    x: Array
    edges: Array
    values: Array
    label: str
    dots: bool
    lines: Array | None
    limits: Array | None
    max_aspect: float
    cmap: str
    size: tuple[float, float]

    def write(self, path, extent, view, cut, title: str, dpi: int) -> None:
        """Choose the points and the box to be seen, and draw them in 1D, 2D or 3D."""
        import matplotlib

        kept = list(range(self.x.shape[1]))
        if cut is not None:
            normal = _AXES.index(cut[0])
            kept.remove(normal)
            reach = np.abs(self.edges[:, normal]).sum(axis=1)
            self._keep(np.abs(self.x[:, normal] - cut[1]) <= reach, f"plane {cut}")
        self.x, self.edges = self.x[:, kept], self.edges[:, kept][:, :, kept]
        reach = np.abs(self.edges).sum(axis=2)
        if view == "points":
            box = np.array([(self.x - reach).min(axis=0), (self.x + reach).max(axis=0)]).T
        else:
            box = extent[kept] if isinstance(view, str) else np.array(view, float)
        seen = np.all((self.x + reach >= box[:, 0]) & (self.x - reach <= box[:, 1]), axis=1)
        self._keep(seen, f"view {box.tolist()}")
        names = [_AXES[k] for k in kept]
        with matplotlib.rc_context({**_LOOK, "axes.grid": len(kept) != 2}):
            result = (self._line, self._plane, self._space)[len(kept) - 1](box, names)
            if title:
                result.axes[0].set_title(title)
            _save(result, path, dpi)

    def _keep(self, which: Array, where: str) -> None:
        if not which.any():
            raise ParameterError(f"no material point is in the {where}")
        self.x, self.edges, self.values = self.x[which], self.edges[which], self.values[which]

    def _line(self, box: Array, names: list[str]):
        from matplotlib.figure import Figure

        width = self.size[0]
        result = Figure(figsize=(width, 0.7 * width))
        ax = result.add_axes((0, 0, 1, 1))
        ax.plot(self.x[:, 0], self.values, ".", markersize=3)
        ax.set(xlim=box[0], ylim=self.limits, xlabel=f"${names[0]}$ (m)", ylabel=self.label)
        return result

    def _plane(self, box: Array, names: list[str]):
        from matplotlib.collections import LineCollection, PolyCollection
        from matplotlib.figure import Figure

        drawn: Any
        factors, told = _stretched(box, self.max_aspect)
        labels = [f"${name}$ (m){text and ', '}{text}" for name, text in zip(names, told)]
        sides = (box[:, 1] - box[:, 0]) * factors
        upright = sides[1] > 0.8 * sides[0]
        room = np.array(self.size) - ((0.9, 0.0) if upright else (0.0, 0.8))
        per_length = factors * np.min(room / sides)
        width, height = (box[:, 1] - box[:, 0]) * per_length
        result = Figure(figsize=(width, height))
        ax = result.add_axes((0, 0, 1, 1))
        ax.set(xlim=box[0], ylim=box[1], xlabel=labels[0], ylabel=labels[1])
        _ticks(ax.xaxis, width / 0.4)
        _ticks(ax.yaxis, height / 0.3)
        if self.lines is not None:
            inches = np.linalg.norm(np.diff(self.lines, axis=1) * per_length, axis=-1).sum()
            if inches <= 2 * _MOST_LINES_PER_INCH * width * height:
                drawn = LineCollection([*self.lines], colors="black", alpha=0.2, linewidths=0.4)
                drawn.set_zorder(0 if self.dots else 2)
                ax.add_collection(drawn)
        if self.dots:
            half = (np.abs(self.edges).sum(axis=2) * per_length).min(axis=1)
            drawn = ax.scatter(self.x[:, 0], self.x[:, 1], s=_dot(half), linewidths=0)
        else:
            x, a, b = self.x, self.edges[:, :, 0], self.edges[:, :, 1]
            corners = np.stack([x - a - b, x + a - b, x + a + b, x - a + b], axis=1)
            # smooth edges and whole pixels would let the paper shine through between neighbours
            drawn = PolyCollection([*corners], linewidths=0, antialiased=False, snap=False)
            ax.add_collection(drawn)
        drawn.set_rasterized(True)
        if upright:
            bar = result.add_axes((1 + 0.1 / width, 0, 0.1 / width, 1))
        else:
            bar = result.add_axes((0, -0.6 / height, 1, 0.1 / height))
        self._colour(drawn, bar, "vertical" if upright else "horizontal")
        return result

    def _space(self, box: Array, names: list[str]):
        from matplotlib.figure import Figure

        factors, told = _stretched(box, self.max_aspect)
        sides = (box[:, 1] - box[:, 0]) * factors
        width = min(self.size)
        result = Figure(figsize=(width, width))
        ax: Any = result.add_axes((0, 0, 1, 1), projection="3d")
        ax.set(xlim=box[0], ylim=box[1], zlim=box[2])
        # less than 1 leaves room for the labels, which Matplotlib does not count
        ax.set_box_aspect(tuple(sides), zoom=0.75)
        per_length = factors * 0.65 * width / np.linalg.norm(sides)
        inches = (box[:, 1] - box[:, 0]) * per_length
        for axis, name, length in zip((ax.xaxis, ax.yaxis, ax.zaxis), names, inches):
            axis.set_label_text(f"${name}$ (m)")
            axis.set_pane_color((1, 1, 1, 0))
            # the first number of y would stand on the last of x
            _ticks(axis, length / 0.5, prune="lower" if name == "y" else None)
        notes = (f"${name}$ {text}" for name, text in zip(names, told) if text)
        ax.text2D(0.5, 0.95, ", ".join(notes), transform=ax.transAxes, ha="center")
        half = 1.5 * (np.abs(self.edges).sum(axis=2) * per_length).max(axis=1)
        drawn = ax.scatter(*self.x.T, s=_dot(half), linewidths=0, depthshade=False)
        self._colour(drawn, result.add_axes((1, 0.15, 0.1 / width, 0.7)), "vertical")
        return result

    def _colour(self, drawn, axes, orientation: str) -> None:
        """Colour what is drawn by the values, and draw the colour bar."""
        low, high = self.values.min(), self.values.max()
        if self.limits is not None:
            below, above = low < self.limits[0], high > self.limits[1]
            low, high = self.limits
            extend = [["neither", "max"], ["min", "both"]][int(below)][int(above)]
        else:
            extend = "neither"
        if not high > low:
            low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
        drawn.set(array=self.values, cmap=self.cmap, clim=(low, high))
        bar = drawn.figure.colorbar(drawn, cax=axes, orientation=orientation, extend=extend)
        bar.set_label(self.label)
        bar.outline.set_linewidth(0.6)


def _check_scene(points, colour, component, cut, view, derived) -> None:
    """Raise ParameterError if `plot` is asked for what the points do not have."""
    known = [*points.fields, "displacement"]
    if colour not in known:
        raise ParameterError(f"no field '{colour}' to colour by; there are {', '.join(known)}")
    shape = (points.gdim,) if derived else points[colour].shape[1:]
    if isinstance(component, str):
        fits = component in ("mean", "mises") and shape == (3, 3)
    else:
        index = () if component is None else tuple(np.atleast_1d(component))
        fits = len(shape) <= 2 and (not index or len(index) == len(shape))
        fits = fits and all(_is_index(i, n) for i, n in zip(index, shape))
    if not fits:
        raise ParameterError(f"component = {component!r} does not fit '{colour}' of shape {shape}")
    pair = isinstance(cut, (tuple, list)) and len(cut) == 2
    if cut is not None and not (points.gdim == 3 and pair and cut[0] in tuple(_AXES)):
        raise ParameterError(f'cut = {shown(cut)} must be as ("y", 0.5), for points in 3D')
    if cut is not None:
        number("the position of the cut", cut[1], unit="m")
    axes = points.gdim - (cut is not None)
    if isinstance(view, str):
        choice("view", view, ("grid", "points"))
        return
    try:
        box = np.array(view, float)
    except (TypeError, ValueError):
        box = np.empty(0)
    if box.shape != (axes, 2) or not np.isfinite(box).all() or np.any(box[:, 0] >= box[:, 1]):
        raise ParameterError(
            f'view = {shown(view)} must be "grid", "points" or {axes} rising ranges (m)'
        )


def _is_index(i: Any, n: int) -> bool:
    return isinstance(i, (int, np.integer)) and not isinstance(i, bool) and bool(0 <= i < n)


def _check_looks(limits, max_aspect, size, dpi) -> None:
    """Raise ParameterError if a number of `plot` is not what it may be."""
    for what, pair in (("limits", limits), ("size", size)):
        if pair is None and what == "limits":
            continue
        if not isinstance(pair, (tuple, list, np.ndarray)) or len(pair) != 2:
            raise ParameterError(f"{what} = {shown(pair)} must be two numbers")
        low, high = (number(f"{what}[{k}]", value) for k, value in enumerate(pair))
        if what == "limits" and not low < high:
            raise ParameterError(
                f"limits = {shown(pair)} must rise, from the lowest to the highest"
            )
        if what == "size" and min(low, high) <= 0:
            raise ParameterError(f"size = {shown(pair)} inch must be two positive numbers")
    number("max_aspect", max_aspect, 1.0, math.inf, closed=True)
    number("dpi", dpi, 0.0)


def _check_picture(path: Any, cmap: Any = None) -> None:
    """Raise ParameterError if Matplotlib cannot write such a file, or has no such colours."""
    import matplotlib
    from matplotlib.backend_bases import FigureCanvasBase
    from matplotlib.colors import Colormap

    ending = file_path("path", path).suffix[1:].lower()
    known = FigureCanvasBase.filetypes
    if ending not in known:
        raise ParameterError(
            f"the path of a picture ends in .png, .pdf, ..., got '{path}'; Matplotlib writes "
            f"{', '.join(sorted(known))}"
        )
    if cmap is not None and not isinstance(cmap, Colormap) and cmap not in matplotlib.colormaps:
        names = [name for name in matplotlib.colormaps if not name.endswith("_r")]
        choice("cmap", cmap, names)


def _scalar(values: Array, component, gdim: int) -> tuple[Array, str]:
    """The number to colour by, shape (n,), and its index in print."""
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


def _label(name: str, index: str, unit: str) -> str:
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


def _prefix(values: Array, limits) -> tuple[float, str]:
    """The power of 1000 that makes pressures short to print."""
    largest = np.abs(values if limits is None else limits).max(initial=0.0)
    for scale, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if largest >= scale:
            return scale, prefix
    return 1.0, ""


def _extent(grid) -> Array:
    """Lowest and highest coordinates of the grid (m), shape (gdim, 2). Collective."""
    x = grid.geometry.x[:, : grid.geometry.dim]
    low = grid.comm.allgather(x.min(axis=0, initial=math.inf))
    high = grid.comm.allgather(x.max(axis=0, initial=-math.inf))
    return np.column_stack([np.min(low, axis=0), np.max(high, axis=0)])


def _grid_lines(grid, cut) -> Array | None:
    """Ends of the grid's lines (m) in a plane, shape (lines, 2, 2), on rank 0. Collective."""
    lattice, dim = lattice_of(grid), grid.geometry.dim
    if lattice is not None and (dim == 2 or cut is not None):
        kept = [d for d in range(dim) if cut is None or _AXES[d] != cut[0]]
        a, b = (lattice.lines[d] for d in kept)
        return np.array([((s, b[0]), (s, b[-1])) for s in a] + [((a[0], s), (a[-1], s)) for s in b])
    cells = grid.topology.index_map(grid.topology.dim)
    if dim == 3 or cells.size_global > _MOST_CELLS:
        return None
    corners = grid.geometry.x[geometry_dofmap(grid)[: cells.size_local], :2]
    order = {3: (0, 1, 2), 4: (0, 1, 3, 2)}[corners.shape[1]]
    pieces = grid.comm.gather(np.stack([corners[:, order], np.roll(corners[:, order], -1, 1)], 2))
    if pieces is None:
        return None
    ends = np.concatenate([piece.reshape(-1, 2, 2) for piece in pieces])
    # an edge of two cells, in opposite directions, is drawn once
    first, last = ends[:, 0], ends[:, 1]
    turned = (first[:, 0] > last[:, 0]) | ((first[:, 0] == last[:, 0]) & (first[:, 1] > last[:, 1]))
    ends[turned] = ends[turned, ::-1]
    return np.unique(ends, axis=0)


def _stretched(box: Array, max_aspect: float) -> tuple[Array, list[str]]:
    """Factors by which each axis is drawn longer, and what tells the reader so."""
    sides = box[:, 1] - box[:, 0]
    factors = np.ones(len(sides))
    for k, ratio in enumerate(sides.max() / sides / max_aspect):
        if ratio > 1:
            digit = 10.0 ** math.floor(math.log10(ratio))
            factors[k] = next(m * digit for m in (1, 2, 5, 10) if m * digit >= ratio * (1 - 1e-9))
    return factors, [f"stretched {f:g}×" if f > 1 else "" for f in factors]


def _ticks(axis, room: float, prune: str | None = None) -> None:
    from matplotlib.ticker import MaxNLocator

    number = max(1, min(8, int(room)))
    axis.set_major_locator(MaxNLocator(nbins=number, steps=[1, 2, 5, 10], prune=prune))


def _dot(half: Array) -> float:
    """Area of a dot (point²) a little narrower than most domains, half-widths in inch."""
    return float(np.clip((0.9 * 72 * 2 * np.median(half)) ** 2, 0.3, 40.0))


def _save(result, path: str | os.PathLike[str], dpi: int) -> None:
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        result.savefig(path, dpi=dpi, bbox_inches="tight", pad_inches=0.03)
    except OSError as cause:
        raise OSError(f"cannot write the picture {path}: {cause}") from cause
