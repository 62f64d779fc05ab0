"""Pictures of studies' tables, in the common style.

`with mpm.figure("sweep.png") as (_, axes): study.draw_sweep(axes, rows)` makes a picture.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import check_dictionary, number, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.io.tables import Row, rows_of

__all__ = [
    "draw_convergence",
    "draw_reduction",
    "draw_sweep",
]

_MARKERS = "osD^vP*X"


def _check_axes(axes: Any) -> None:
    """Raise ParameterError unless `axes` are Matplotlib's axes."""
    if not hasattr(axes, "semilogy"):
        raise ParameterError(
            f"axes = {shown(axes)} must be Matplotlib's axes, such as those of "
            "with mpm.figure(path) as (picture, axes)"
        )


def draw_sweep(
    axes: Any,
    rows: Sequence[Row],
    *,
    x: str | Callable[[Row], float] = "place",
    keys: Sequence[str] | Mapping[str, str] = ("kappa_K", "kappa_M"),
    **style: Any,
) -> None:
    """Draw figures of a sweep over its places, on a logarithmic vertical axis, with a legend.

    Infinite and missing figures are left out.

    Args:
        axes: Matplotlib's axes.
        rows: Table returned by `sweep`.
        x: Name of the figure on the horizontal axis, or a function of a row.
        keys: Names of the figures, or name → words in the legend.
        style: Further arguments of Matplotlib's `plot`.

    >>> import dolfinmpm as mpm
    >>> from tempfile import mkdtemp
    >>> rows = mpm.study.sweep(lambda offset: {"kappa_K": 1 / offset}, [0.25, 0.5])
    >>> with mpm.figure(f"{mkdtemp()}/sweep.png", dpi=50) as (fig, ax):
    ...     mpm.study.draw_sweep(ax, rows, keys=["kappa_K"])
    >>> ax.get_yscale()
    'log'
    """
    _check_axes(axes)
    if not isinstance(keys, (str, Mapping, list, tuple)):
        raise ParameterError(f"keys = {shown(keys)} must be names of figures")
    keys = (keys,) if isinstance(keys, str) else keys
    words = keys if isinstance(keys, Mapping) else {key: key.replace("_", " ") for key in keys}
    rows = rows_of(rows, *words, *([x] if isinstance(x, str) else []))
    at = np.array([row[x] if isinstance(x, str) else x(row) for row in rows], float)
    order = np.argsort(at, kind="stable")
    for k, (key, label) in enumerate(words.items()):
        values = _numbers(rows, key)[order]
        axes.semilogy(at[order], values, **{"marker": _marker(k), "label": label, **style})
    _two_decades(axes)
    axes.legend()


def _two_decades(axes: Any) -> None:
    """Extend the vertical axis to whole decades if it shows fewer than two decades."""
    low, high = np.log10(axes.get_ylim())
    if np.floor(high + 1e-9) - np.ceil(low - 1e-9) < 1:
        axes.set_ylim(10.0 ** np.floor(low + 1e-9), 10.0 ** np.ceil(high - 1e-9))


def draw_convergence(
    axes: Any,
    curves: Mapping[str, Sequence[Row]],
    *,
    key: str = "error",
    orders: Sequence[int] = (1, 2),
    nested: bool = False,
) -> None:
    """Draw errors over sizes of cells, and below them a fan of the slopes to compare with.

    The caller adds the legend. Errors normally fall towards the left. Then the upper left corner
    is free for the legend.

    Args:
        axes: Matplotlib's axes; both become logarithmic.
        curves: Words in the legend → table returned by `convergence`.
        key: Name of the error.
        orders: Slopes of the fan; none if empty.
        nested: True draws open markers of decreasing size, so that coinciding curves stay
            visible.

    >>> import dolfinmpm as mpm
    >>> from tempfile import mkdtemp
    >>> rows = mpm.study.convergence(lambda h: 3 * h**2, [0.4, 0.2, 0.1])
    >>> with mpm.figure(f"{mkdtemp()}/error.png", dpi=50) as (fig, ax):
    ...     mpm.study.draw_convergence(ax, {"ours": rows})
    >>> ax.get_xscale(), len(ax.lines)
    ('log', 3)
    """
    from matplotlib.ticker import NullLocator

    _check_axes(axes)
    check_dictionary("curves", curves, ', such as {"linear": study.convergence(...)}', some=True)
    curves = {label: rows_of(rows, "h", key) for label, rows in curves.items()}
    if not isinstance(orders, (list, tuple)):
        raise ParameterError(f"orders = {shown(orders)} must be slopes, such as (1, 2)")
    for order in orders:
        number("orders", order)
    axes.set(xscale="log", yscale="log")
    drawn = []
    for k, (label, rows) in enumerate(curves.items()):
        h, error = _numbers(rows, "h"), _numbers(rows, key)
        look = {"markersize": max(9 - 1.2 * k, 2), "markerfacecolor": "none"} if nested else {}
        axes.plot(h, error, marker=_marker(k), label=label, **look)
        known = np.isfinite(h) & np.isfinite(error) & (error > 0)
        if known.any():
            order = np.argsort(h[known])
            drawn.append((h[known][order], error[known][order]))
    if not drawn:
        return
    sizes = np.unique(np.round(np.concatenate([h for h, _ in drawn]), 12))
    if sizes.size <= 6:
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(sizes, labels=[f"{size:.3g}" for size in sizes])
    if orders and sizes.size > 1:
        _fan(axes, drawn, sizes, orders)


def draw_reduction(axes: Any, rows: Sequence[Row], *, scale: float | None = None) -> None:
    """Draw largest displacements over the reduction factor of strength, with a legend.

    Failed runs are crosses. Their displacements are those before the failed step. The bracket of
    the factor of safety is shaded.

    Args:
        axes: Matplotlib's axes; the vertical axis becomes logarithmic.
        rows: The table of `factor_of_safety`.
        scale: Reference displacement (m), such as γH²/E. Displacements are divided by it.

    >>> import dolfinmpm as mpm
    >>> from tempfile import mkdtemp
    >>> stands = {"factor": 1.0, "stands": True, "displacement": 0.01}
    >>> fails = {"factor": 2.0, "stands": False, "displacement": 0.05}
    >>> with mpm.figure(f"{mkdtemp()}/factor.png", dpi=50) as (fig, ax):
    ...     mpm.study.draw_reduction(ax, [stands, fails])
    >>> ax.get_xlabel()
    'strength divided by'
    """
    _check_axes(axes)
    unit = 1.0 if scale is None else number("scale", scale, 0.0, unit="m")
    rows = sorted(rows_of(rows, "factor", "stands", "displacement"), key=lambda row: row["factor"])
    stands = np.array([row["stands"] for row in rows], bool)
    factors, moved = _numbers(rows, "factor"), _numbers(rows, "displacement") / unit
    for chosen, marker, word in ((stands, "o", "stands"), (~stands, "x", "fails")):
        axes.semilogy(factors[chosen], moved[chosen], marker, label=word)
    if stands.any() and not stands.all():
        axes.axvspan(factors[stands].max(), factors[~stands].min(), color="0.85", zorder=0)
    _two_decades(axes)
    largest = "largest displacement"
    axes.set(xlabel="strength divided by", ylabel=f"{largest} (m)" if scale is None else largest)
    axes.legend()


def _fan(axes: Any, drawn: list[tuple[npt.NDArray, npt.NDArray]], sizes, orders) -> None:
    """Lines of known slopes from one corner, below all curves at the right."""
    run = (sizes[-1] / sizes[0]) ** 0.3
    # room for the numbers
    right = sizes[-1] / run**0.2
    h = np.geomspace(right / run, right, 8)
    below = min(
        np.exp(np.interp(np.log(h), np.log(size), np.log(error))).min() for size, error in drawn
    )
    corner = below / 2 / run ** max(orders)
    for order in orders:
        top = corner * run**order
        axes.plot([right / run, right], [corner, top], color="0.5", linewidth=0.8, zorder=1)
        axes.annotate(
            f"{order}", (right, top), xytext=(3, 0), textcoords="offset points", va="center",
            color="0.4", fontsize=6,
        )  # fmt: skip


def _numbers(rows: Sequence[Row], key: str) -> npt.NDArray[np.float64]:
    """A column, NaN where a figure is missing, None or infinite."""
    column = np.array([row.get(key) for row in rows], float)
    return np.where(np.isfinite(column), column, np.nan)


def _marker(k: int) -> str:
    return _MARKERS[k % len(_MARKERS)]
