"""A picture of points or their domains with the background grid's lines."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import choice
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.io.figures import LOOK, save

__all__ = ["Scene"]

Array = npt.NDArray[Any]
_AXES = "xyz"
# more lines would look like a grey area
_MOST_LINES_PER_INCH = 25


@dataclass
class Scene:
    """Content of a picture: positions, half-edges of domains, scalars, style, facets of bodies."""

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
    bodies: list[Array] = field(default_factory=list)

    def write(self, path, extent, view, cut, title: str, dpi: int) -> None:
        """Choose the visible points and the visible box, and draw them in 1D, 2D or 3D."""
        import matplotlib

        kept = list(range(self.x.shape[1]))
        if cut is not None:
            normal = _AXES.index(cut[0])
            kept.remove(normal)
            self.bodies = [_section(facets, normal, cut[1]) for facets in self.bodies]
            reach = np.abs(self.edges[:, normal]).sum(axis=1)
            self._keep(np.abs(self.x[:, normal] - cut[1]) <= reach, f"plane {cut}")
        self.x, self.edges = self.x[:, kept], self.edges[:, kept][:, :, kept]
        reach = np.abs(self.edges).sum(axis=2)
        if isinstance(view, str) and choice("view", view, ("grid", "points")) == "points":
            box = np.array([(self.x - reach).min(axis=0), (self.x + reach).max(axis=0)]).T
        else:
            box = extent[kept] if isinstance(view, str) else np.array(view, float)
        seen = np.all((self.x + reach >= box[:, 0]) & (self.x - reach <= box[:, 1]), axis=1)
        self._keep(seen, f"view {box.tolist()}")
        names = [_AXES[k] for k in kept]
        with matplotlib.rc_context({**LOOK, "axes.grid": len(kept) != 2}):
            result = (self._line, self._plane, self._space)[len(kept) - 1](box, names)
            if title:
                result.axes[0].set_title(title)
            save(result, path, dpi)

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
            # antialiasing and snapping to pixels would leave white lines between neighbours
            drawn = PolyCollection([*corners], linewidths=0, antialiased=False, snap=False)
            ax.add_collection(drawn)
        drawn.set_rasterized(True)
        for segments in self.bodies:
            ax.add_collection(LineCollection([*segments], colors="black", linewidths=1.2, zorder=4))
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
            # the first number of y would overlap the last number of x
            _ticks(axis, length / 0.5, prune="lower" if name == "y" else None)
        notes = (f"${name}$ {text}" for name, text in zip(names, told) if text)
        ax.text2D(0.5, 0.95, ", ".join(notes), transform=ax.transAxes, ha="center")
        half = 1.5 * (np.abs(self.edges).sum(axis=2) * per_length).max(axis=1)
        drawn = ax.scatter(*self.x.T, s=_dot(half), linewidths=0, depthshade=False)
        for facets in self.bodies:
            from mpl_toolkits.mplot3d.art3d import Poly3DCollection

            look = {"facecolor": (0.4, 0.4, 0.4, 0.3), "edgecolor": (0.2, 0.2, 0.2, 0.3)}
            ax.add_collection3d(Poly3DCollection([*facets], linewidths=0.2, **look))
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
        found = np.unique(self.values)
        # between tags, and levels, there is nothing
        if self.limits is None and 1 < found.size <= 8 and (found == np.rint(found)).all():
            bar.set_ticks(found, labels=[f"{value:g}" for value in found])
        bar.set_label(self.label)
        bar.outline.set_linewidth(0.6)


def _section(triangles: Array, axis: int, at: float) -> Array:
    """Segments in which triangles, shape (n, 3, 3), meet a plane normal to an axis, (m, 2, 2)."""
    side = triangles[:, :, axis] - at
    found = []
    for k in range(len(triangles)):
        x, s = triangles[k], side[k]
        ends = [
            np.delete(x[i] + s[i] / (s[i] - s[j]) * (x[j] - x[i]), axis)
            for i, j in ((0, 1), (1, 2), (2, 0))
            if (s[i] < 0) != (s[j] < 0)
        ]
        if ends:
            found.append(ends)
    return np.array(found).reshape(-1, 2, 2)


def _stretched(box: Array, max_aspect: float) -> tuple[Array, list[str]]:
    """Stretch factor of each axis, and the notes about it for the axis labels."""
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
