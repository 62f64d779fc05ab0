"""Tables of studies on disk, and their pictures in the look of all pictures."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.checks import check_kind, file_path, number, shown
from dolfinmpm._platform.errors import ParameterError, call_together
from dolfinmpm._platform.together import together
from dolfinmpm.io.figures import figure

__all__ = [
    "check_suffix",
    "draw_convergence",
    "draw_reduction",
    "draw_sweep",
    "plot_convergence",
    "plot_reduction",
    "plot_sweep",
    "read_table",
    "write_table",
]

Row = Mapping[str, Any]
PathLike = str | os.PathLike[str]
_MARKERS = "osD^vP*X"


@together(own=("rows",))
def write_table(rows: Iterable[Row], path: PathLike, comm: MPI.Comm = MPI.COMM_WORLD) -> None:
    """Write rows as CSV or as JSON; rank 0 writes them. Collective.

    Columns of a CSV file are all the names in the rows, in the order in which they
    first occur. What is None or missing is an empty cell there, and a pair or a list
    is in JSON's brackets.

    Args:
        rows: Dictionaries of numbers, words, None, and lists of them.
        path: File to write, ending in .csv or .json. Parent folders are created.
        comm: Ranks that make this call.

    Raises:
        ParameterError: The path has another ending, or rows are no dictionaries.
        OSError: The file cannot be written; on all ranks.
    """
    check_kind("comm", comm, MPI.Comm, "MPI.COMM_WORLD by default")
    path, rows = file_path("path", path), call_together(comm, lambda: _rows(rows))
    check_suffix(path)

    def write() -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".json":
            path.write_text(
                json.dumps([dict(row) for row in rows], indent=1, default=_plain) + "\n"
            )
            return
        names = list(dict.fromkeys(name for row in rows for name in row))
        with path.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(names)
            table.writerows([_cell(row.get(name)) for name in names] for row in rows)

    call_together(comm, write if comm.rank == 0 else _nothing)


@together
def read_table(path: PathLike, comm: MPI.Comm = MPI.COMM_WORLD) -> list[dict[str, Any]]:
    """Read what `write_table` wrote; rank 0 reads, all ranks get the rows. Collective.

    Pairs come back as lists.

    Args:
        path: File to read, ending in .csv or .json.
        comm: Ranks that make this call.

    Raises:
        ParameterError: The path has another ending, or there is no table in the file.
        OSError: The file cannot be read; on all ranks.
    """
    path = file_path("path", path)
    check_kind("comm", comm, MPI.Comm, "MPI.COMM_WORLD by default")
    check_suffix(path)

    def read() -> list[dict[str, Any]]:
        if path.suffix == ".json":
            try:
                return [dict(row) for row in _rows(json.loads(path.read_text()))]
            except (json.JSONDecodeError, UnicodeDecodeError) as error:
                raise ParameterError(f"'{path}' is no table in JSON: {error}") from error
        with path.open(newline="", encoding="utf-8") as file:
            return [{k: _value(v) for k, v in row.items()} for row in csv.DictReader(file)]

    return comm.bcast(call_together(comm, read if comm.rank == 0 else _nothing))


def _rows(given: Any, *names: str) -> list[Row]:
    """Rows of a table.

    Args:
        given: What was given for them.
        names: Figures that one row has at least.

    Raises:
        ParameterError: They are no dictionaries, or none has one of the figures.
    """
    listed = [] if isinstance(given, (str, Mapping)) or not isinstance(given, Iterable) else given
    rows = list(listed)
    if (listed is not given) or not all(isinstance(row, Mapping) for row in rows):
        raise ParameterError(
            f"rows = {shown(given)} must be a list of dictionaries, a figure by each name"
        )
    for name in names:
        if not any(name in row for row in rows):
            there = list(dict.fromkeys(key for row in rows for key in row))
            raise ParameterError(
                f"no row has a figure '{name}'; there are {', '.join(map(str, there)) or 'no rows'}"
            )
    return rows


def _check_axes(axes: Any) -> None:
    """Raise ParameterError unless it can be drawn on."""
    if not hasattr(axes, "semilogy"):
        raise ParameterError(
            f"axes = {shown(axes)} must be Matplotlib's axes, such as those of "
            "with mpm.figure(path) as (picture, axes)"
        )


def _nothing() -> Any:
    return None


def check_suffix(path: Path) -> None:
    """Raise ParameterError unless a table can be written to such a path."""
    if path.suffix not in (".csv", ".json"):
        raise ParameterError(f"a table is written to a path in .csv or .json, got '{path}'")


def _plain(value: Any) -> Any:
    """What JSON knows for NumPy's numbers and arrays."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written to a table")


def _cell(value: Any) -> str:
    if value is None:
        return ""
    # a word that would be read as a number, or as nothing, is put in quotes of its own
    if isinstance(value, str) and value and _value(value) == value:
        return value
    return json.dumps(value, default=_plain, ensure_ascii=False)


def _value(cell: str) -> Any:
    if not cell:
        return None
    try:
        return json.loads(cell)
    except json.JSONDecodeError:
        return cell


def plot_sweep(
    rows: Sequence[Row],
    path: PathLike,
    x: str | Callable[[Row], float] = "place",
    keys: Sequence[str] | Mapping[str, str] = ("kappa_K", "kappa_M"),
    *,
    xlabel: str = "",
    ylabel: str = "",
    width: float = 3.5,
    height: float = 2.6,
) -> None:
    """Draw figures of a sweep over its places into a picture of their own; see `draw_sweep`.

    Not collective: all ranks may call it or rank 0 alone, and only rank 0 writes.

    Args:
        rows: What `sweep` returned.
        path: Picture to write.
        x: Name of the figure on the horizontal axis, or a function of a row.
        keys: Names of the figures, or name → words in the legend.
        xlabel: Text at the horizontal axis; x by default.
        ylabel: Text at the vertical axis.
        width: Width (inch).
        height: Height (inch).
    """
    with figure(path, width, height) as (_, axes):
        draw_sweep(axes, rows, x, keys)
        axes.set(xlabel=xlabel or (x if isinstance(x, str) else ""), ylabel=ylabel)


def draw_sweep(
    axes: Any,
    rows: Sequence[Row],
    x: str | Callable[[Row], float] = "place",
    keys: Sequence[str] | Mapping[str, str] = ("kappa_K", "kappa_M"),
    **style: Any,
) -> None:
    """Draw figures of a sweep over its places, on a logarithmic vertical axis, with a legend.

    What is infinite or missing is left out.

    Args:
        axes: Matplotlib's axes.
        rows: What `sweep` returned.
        x: Name of the figure on the horizontal axis, or a function of a row.
        keys: Names of the figures, or name → words in the legend.
        style: Further arguments of Matplotlib's `plot`.
    """
    _check_axes(axes)
    if not isinstance(keys, (str, Mapping, list, tuple)):
        raise ParameterError(f"keys = {shown(keys)} must be names of figures")
    keys = (keys,) if isinstance(keys, str) else keys
    words = keys if isinstance(keys, Mapping) else {key: key.replace("_", " ") for key in keys}
    rows = _rows(rows, *words, *([x] if isinstance(x, str) else []))
    at = np.array([row[x] if isinstance(x, str) else x(row) for row in rows], float)
    order = np.argsort(at, kind="stable")
    for k, (key, label) in enumerate(words.items()):
        values = _numbers(rows, key)[order]
        axes.semilogy(at[order], values, **{"marker": _marker(k), "label": label, **style})
    _two_decades(axes)
    axes.legend()


def _two_decades(axes: Any) -> None:
    """Whole decades where the vertical axis would show fewer than two, and so fewer numbers."""
    low, high = np.log10(axes.get_ylim())
    if np.floor(high + 1e-9) - np.ceil(low - 1e-9) < 1:
        axes.set_ylim(10.0 ** np.floor(low + 1e-9), 10.0 ** np.ceil(high - 1e-9))


def plot_convergence(
    curves: Mapping[str, Sequence[Row]],
    path: PathLike,
    key: str = "error",
    *,
    orders: Sequence[int] = (1, 2),
    xlabel: str = "cell size h (m)",
    ylabel: str = "error",
    width: float = 3.5,
    height: float = 2.8,
) -> None:
    """Draw errors over sizes of cells into a picture of their own; see `draw_convergence`.

    Not collective: all ranks may call it or rank 0 alone, and only rank 0 writes.

    Args:
        curves: Words in the legend → what `convergence` returned.
        path: Picture to write.
        key: Name of the error.
        orders: Slopes to compare with.
        xlabel: Text at the horizontal axis.
        ylabel: Text at the vertical axis.
        width: Width (inch).
        height: Height (inch).
    """
    with figure(path, width, height) as (_, axes):
        draw_convergence(axes, curves, key, orders)
        axes.set(xlabel=xlabel, ylabel=ylabel)
        axes.legend()


def draw_convergence(
    axes: Any,
    curves: Mapping[str, Sequence[Row]],
    key: str = "error",
    orders: Sequence[int] = (1, 2),
    nested: bool = False,
) -> None:
    """Draw errors over sizes of cells, and below them a fan of the slopes to compare with.

    The legend is the caller's. Where errors fall towards the left, as they should, the
    upper left corner is free for it.

    Args:
        axes: Matplotlib's axes; both become logarithmic.
        curves: Words in the legend → what `convergence` returned.
        key: Name of the error.
        orders: Slopes of the fan; none if empty.
        nested: Whether markers are open, each smaller than the one before, so that curves
            that lie on each other can be told apart.
    """
    from matplotlib.ticker import NullLocator

    _check_axes(axes)
    if not isinstance(curves, Mapping) or not curves:
        raise ParameterError(
            f"curves = {shown(curves)} must be a dictionary, such as "
            '{"linear": study.convergence(...)}'
        )
    curves = {label: _rows(rows, "h", key) for label, rows in curves.items()}
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


def plot_reduction(
    rows: Sequence[Row],
    path: PathLike,
    scale: float | None = None,
    *,
    ylabel: str = "",
    width: float = 3.5,
    height: float = 2.6,
) -> None:
    """Draw a strength reduction into a picture of its own; see `draw_reduction`.

    Not collective: all ranks may call it or rank 0 alone, and only rank 0 writes.

    Args:
        rows: The table of `factor_of_safety`.
        path: Picture to write.
        scale: Displacement that others are divided by (m).
        ylabel: Text at the vertical axis.
        width: Width (inch).
        height: Height (inch).
    """
    with figure(path, width, height) as (_, axes):
        draw_reduction(axes, rows, scale)
        if ylabel:
            axes.set_ylabel(ylabel)


def draw_reduction(axes: Any, rows: Sequence[Row], scale: float | None = None) -> None:
    """Draw largest displacements over the factor that strength was divided by, with a legend.

    Runs that failed are crosses; they ended with the step that failed, so that their
    displacements are only those until then. The bracket of the factor of safety is shaded.

    Args:
        axes: Matplotlib's axes; the vertical one becomes logarithmic.
        rows: The table of `factor_of_safety`.
        scale: Displacement that others are divided by (m), such as γH²/E.
    """
    _check_axes(axes)
    unit = 1.0 if scale is None else number("scale", scale, 0.0, unit="m")
    rows = sorted(_rows(rows, "factor", "stands", "displacement"), key=lambda row: row["factor"])
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
