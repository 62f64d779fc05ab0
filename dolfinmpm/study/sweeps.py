"""A scene evaluated at many places, or at many sizes of the cells."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.checks import coordinates, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.io.progress import progress

__all__ = ["convergence", "observed_orders", "overall_order", "sweep", "worst"]

Row = dict[str, Any]


def _figures(scene: Callable[[Any], Any], place: Any) -> Row:
    """What a scene returns of a place, by name.

    Raises:
        ParameterError: The scene is no function, or returns no figures.
    """
    if not callable(scene):
        raise ParameterError(
            f"scene = {shown(scene)} must be a function that returns figures of a place or size"
        )
    answer = scene(place)
    if is_dataclass(answer) and not isinstance(answer, type):
        return asdict(answer)
    if isinstance(answer, dict):
        return dict(answer)
    try:
        return {"error": float(answer)}
    except (TypeError, ValueError):
        raise ParameterError(
            f"the scene returned {shown(answer)} for {shown(place)} and should return a dictionary "
            "of figures, a Conditioning, or one number: has it a return?"
        ) from None


def _several(what: str, given: Any) -> list[Any]:
    """Some things, one at least.

    Raises:
        ParameterError: There is none, or they cannot be gone through.
    """
    try:
        found = [] if isinstance(given, (str, dict)) else list(given)
    except TypeError:
        found = []
    if not found:
        raise ParameterError(f"{what} = {shown(given)} must be a list with one entry at least")
    return found


def sweep(scene: Callable[..., Any], places: Sequence[Any], *, label: str = "") -> list[Row]:
    """Evaluate a scene at many places of its body, with a progress bar. Collective.

    Args:
        scene: Function of a place that returns its `Conditioning`, a dictionary of
            figures, or one number.
        places: Offsets, angles, or pairs of them.
        label: Text beside the bar.

    Returns:
        For every place a dictionary with "place" and the figures; one number is
        called "error".

    Raises:
        ParameterError: There is no place, or the scene returns no figures.
    """
    listed = _several("places", places)
    return [{"place": place, **_figures(scene, place)} for place in progress(listed, label)]


def convergence(
    scene: Callable[[float], Any],
    sizes: Sequence[float],
    *,
    label: str = "",
    errors: Sequence[str] | None = None,
) -> list[Row]:
    """Evaluate a scene for cells of decreasing sizes, with a progress bar. Collective.

    Args:
        scene: Function of a size h that returns a dictionary of figures, or one error.
        sizes: Sizes h of the cells, two at least to see an order.
        label: Text beside the bar.
        errors: Names of those figures that are errors; all floating-point numbers by
            default, so that counts, which are whole, are left out. A run that did not
            finish has the error None.

    Returns:
        For every size a dictionary with "h", the figures, and for every error e its
        observed order from the size before, "e_order", which is None where there is
        none. A scene whose cells are not quite of the size asked for returns an "h" of
        its own.

    Raises:
        ParameterError: A size is not positive, or an error was not among the figures.
    """
    try:
        h = np.asarray(sizes, float)
    except (TypeError, ValueError):
        h = np.empty(0)
    if h.ndim != 1 or h.size == 0 or not np.all(np.isfinite(h) & (h > 0)):
        raise ParameterError(f"sizes = {shown(sizes)} must be some positive numbers")
    rows = [{"h": float(size), **_figures(scene, size)} for size in progress(sizes, label)]
    if errors is None:
        floats = (float, np.floating)
        errors = [k for k in rows[0] if k != "h" and any(isinstance(r[k], floats) for r in rows)]
    errors = [errors] if isinstance(errors, str) else errors
    missing = [name for name in errors if any(name not in row for row in rows)]
    if missing:
        raise ParameterError(
            f"the scene returned no {', '.join(missing)}, but {', '.join(rows[0])}"
        )
    h = np.array([row["h"] for row in rows])
    for name in errors:
        orders = observed_orders(h, [row[name] for row in rows])
        for row, order in zip(rows, [math.nan, *orders]):
            row[f"{name}_order"] = float(order) if math.isfinite(order) else None
    return rows


def observed_orders(
    sizes: Sequence[float] | npt.NDArray, errors: Sequence[float | None] | npt.NDArray
) -> list[float]:
    """Observed orders between successive refinements, ln(e_i/e_{i+1}) / ln(h_i/h_{i+1}).

    Args:
        sizes: Sizes h of the cells.
        errors: Their errors; None for a run that did not finish.

    Returns:
        One order fewer than sizes; NaN where an error is missing or both are zero.

    Raises:
        ParameterError: There are not as many errors as sizes.

    >>> [round(order, 3) for order in observed_orders([0.4, 0.2, 0.1], [0.16, 0.04, 0.02])]
    [2.0, 1.0]
    """
    h, e = _of_equal_lengths(sizes, errors)
    if not np.all(np.diff(h)):
        raise ParameterError(f"sizes = {shown(sizes)} has one twice in a row, and no order there")
    with np.errstate(divide="ignore", invalid="ignore"):
        return [float(order) for order in np.diff(np.log(e)) / np.diff(np.log(h))]


def overall_order(
    sizes: Sequence[float] | npt.NDArray, errors: Sequence[float | None] | npt.NDArray
) -> float:
    """The one order that fits all refinements best: slope of ln e over ln h, least squares.

    Where errors scatter, it says more than the order between any two of them.

    Args:
        sizes: Sizes h of the cells.
        errors: Their errors; runs that did not finish, None, are left out.

    Returns:
        The order, or NaN where fewer than two errors are left.

    Raises:
        ParameterError: There are not as many errors as sizes.
    """
    h, e = _of_equal_lengths(sizes, errors)
    known = np.isfinite(e) & (e > 0)
    if np.unique(h[known]).size < 2:
        return math.nan
    x, y = np.log(h[known]), np.log(e[known])
    x = x - x.mean()
    return float(x @ y / (x @ x))


def worst(rows: Iterable[Row]) -> dict[str, float]:
    """The worst figures of a sweep: the largest condition numbers and the smallest steps.

    Args:
        rows: What `sweep` returned of a scene that returns its `Conditioning`.

    Raises:
        ParameterError: There is no row, or one has not all of them.
    """
    rows = _several("rows", rows)
    choose = {"kappa_K": max, "kappa_M": max, "dt_consistent": min, "dt_lumped": min}
    for row in rows:
        missing = [key for key in choose if not isinstance(row, dict) or key not in row]
        if missing:
            raise ParameterError(
                f"a row has no {', '.join(missing)}: {shown(row)}; give what study.sweep returned "
                "of a scene that returns a study.Conditioning"
            )
    return {key: extreme(row[key] for row in rows) for key, extreme in choose.items()}


def _of_equal_lengths(sizes, errors) -> tuple[npt.NDArray, npt.NDArray]:
    h, e = coordinates("sizes", sizes), coordinates("errors", errors)
    if h.ndim != 1 or h.shape != e.shape:
        raise ParameterError(
            f"sizes have the shape {h.shape} and errors {e.shape}; give one error for each size, "
            "None where a run did not finish"
        )
    if not np.all(np.isfinite(h) & (h > 0)):
        raise ParameterError(f"sizes = {shown(sizes)} must be positive")
    return h, e
