"""Runs of a problem for many places of its body, or for many sizes of the cells."""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import check_function, coordinates, floats, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.io.progress import progress

__all__ = ["convergence", "observed_orders", "overall_order", "sweep", "worst"]

Row = dict[str, Any]


def _figures(scene: Callable[[Any], Any], place: Any) -> Row:
    """Figures that a scene returns for a place, by name.

    Raises:
        ParameterError: The scene is no function, or returns no figures.
    """
    check_function("scene", scene, "that returns figures for a place or size", place)
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
            "of figures, a Conditioning, or one number: check that it has a return"
        ) from None


def _several(what: str, given: Any) -> list[Any]:
    """The entries of a list.

    Raises:
        ParameterError: The list is empty, or it is no list.
    """
    try:
        found = [] if isinstance(given, (str, dict)) else list(given)
    except TypeError:
        found = []
    if not found:
        raise ParameterError(f"{what} = {shown(given)} must be a list with at least one entry")
    return found


def sweep(scene: Callable[..., Any], places: Sequence[Any], *, label: str = "") -> list[Row]:
    """Run a scene for many places of its body, with a progress bar. Collective.

    Args:
        scene: Function of a place that runs the problem and returns its `Conditioning`, a
            dictionary of figures, or one number.
        places: Offsets, angles, or pairs of these.
        label: Text next to the progress bar.

    Returns:
        One dictionary per place, with "place" and the figures. A single number gets the name
        "error".

    Raises:
        ParameterError: The list of places is empty, or the scene returns no figures.

    >>> import dolfinmpm as mpm
    >>> rows = mpm.study.sweep(lambda offset: {"fill": 1.0 - offset}, [0.25, 0.5])
    >>> rows
    [{'place': 0.25, 'fill': 0.75}, {'place': 0.5, 'fill': 0.5}]
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
    """Run a scene for cells of decreasing sizes, with a progress bar. Collective.

    Args:
        scene: Function of a size h that runs the problem and returns a dictionary of figures, or
            one error. A scene with slightly different cells can return the true size as "h".
        sizes: Sizes h of the cells (m), at least two for an order.
        label: Text next to the progress bar.
        errors: Names of the figures that are errors. By default, all floating-point numbers are
            errors, and whole numbers are counts. A run that did not finish has the error None.

    Returns:
        One dictionary per size, with "h", the figures, and an observed order "e_order" for every
        error e. The order is taken from the size before; it is None if it is not known.

    Raises:
        ParameterError: A size is not positive, or a named error is not among the figures.

    >>> import dolfinmpm as mpm
    >>> for row in mpm.study.convergence(lambda h: h**2, [0.5, 0.25, 0.125]):
    ...     print(row)
    {'h': 0.5, 'error': 0.25, 'error_order': None}
    {'h': 0.25, 'error': 0.0625, 'error_order': 2.0}
    {'h': 0.125, 'error': 0.015625, 'error_order': 2.0}
    """
    h = floats(sizes)
    if h is None or h.ndim != 1 or h.size == 0 or not np.all(np.isfinite(h) & (h > 0)):
        raise ParameterError(f"sizes = {shown(sizes)} must be some positive numbers")
    rows = [{"h": float(size), **_figures(scene, size)} for size in progress(sizes, label)]
    if errors is None:
        real = (float, np.floating)
        errors = [k for k in rows[0] if k != "h" and any(isinstance(r[k], real) for r in rows)]
    errors = [errors] if isinstance(errors, str) else errors
    if not isinstance(errors, (list, tuple)) or not all(isinstance(e, str) for e in errors):
        raise ParameterError(f"errors = {shown(errors)} must be a list of names of figures")
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
    """Observed orders between successive refinements, ln|e_i/e_{i+1}| / ln(h_i/h_{i+1}).

    Args:
        sizes: Sizes h of the cells.
        errors: Errors at these sizes; None for a run that did not finish. The sizes of errors with
            a sign count. An error that changes its sign is small there by chance, and so is no
            order.

    Returns:
        Orders, one fewer than sizes; NaN where an error is missing or both errors are zero.

    Raises:
        ParameterError: The numbers of errors and sizes differ, or two successive sizes are equal.

    >>> [round(order, 3) for order in observed_orders([0.4, 0.2, 0.1], [0.16, 0.04, 0.02])]
    [2.0, 1.0]
    """
    h, e = _of_equal_lengths(sizes, errors)
    if not np.all(np.diff(h)):
        raise ParameterError(
            f"sizes = {shown(sizes)} has one twice in a row, which gives no order: leave one out"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        return [float(order) for order in np.diff(np.log(np.abs(e))) / np.diff(np.log(h))]


def overall_order(
    sizes: Sequence[float] | npt.NDArray, errors: Sequence[float | None] | npt.NDArray
) -> float:
    """Order that fits all refinements best: least-squares slope of ln |e| over ln h.

    If errors scatter, it is more reliable than the order between two sizes.

    Args:
        sizes: Sizes h of the cells (m).
        errors: Errors at these sizes; None for a run that did not finish, which is left out. The
            sizes of errors with a sign count. Errors of zero are left out.

    Returns:
        The order, or NaN if fewer than two errors are left.

    Raises:
        ParameterError: The numbers of errors and sizes differ.

    >>> import dolfinmpm as mpm
    >>> round(mpm.study.overall_order([0.4, 0.2, 0.1], [0.16, 0.05, 0.01]), 3)
    2.0
    """
    h, e = _of_equal_lengths(sizes, errors)
    known = np.isfinite(e) & (e != 0)
    if np.unique(h[known]).size < 2:
        return math.nan
    x, y = np.log(h[known]), np.log(np.abs(e[known]))
    x = x - x.mean()
    return float(x @ y / (x @ x))


def worst(rows: Iterable[Row]) -> dict[str, float]:
    """Worst figures of a sweep: the largest condition numbers and the smallest critical steps.

    Args:
        rows: Result of `sweep` with a scene that returns its `Conditioning`.

    Returns:
        The figures "kappa_K", "kappa_M", "dt_consistent" and "dt_lumped".

    Raises:
        ParameterError: The list is empty, or a row lacks one of these figures, or has None or NaN.

    >>> import dolfinmpm as mpm
    >>> from dolfinmpm.study import Conditioning
    >>> found = {0.1: Conditioning(9.0, 2.0, 0.4, 0.6, 8), 0.2: Conditioning(8.0, 3.0, 0.3, 0.7, 8)}
    >>> mpm.study.worst(mpm.study.sweep(found.get, list(found)))
    {'kappa_K': 9.0, 'kappa_M': 3.0, 'dt_consistent': 0.3, 'dt_lumped': 0.6}
    """
    rows = _several("rows", rows)
    choose = {"kappa_K": max, "kappa_M": max, "dt_consistent": min, "dt_lumped": min}
    for row in rows:
        missing = [key for key in choose if not isinstance(row, dict) or key not in row]
        if missing:
            raise ParameterError(
                f"a row has no {', '.join(missing)}: {shown(row)}; give the result of study.sweep "
                "with a scene that returns a study.Conditioning"
            )
        for key in choose:
            value = row[key]
            # nan would count or not, by the order of the rows
            if not isinstance(value, numbers.Real) or math.isnan(value):
                place = f" at the place {shown(row['place'])}" if "place" in row else ""
                raise ParameterError(
                    f"{key} = {shown(value)}{place} must be a number: leave out the rows of runs "
                    "that did not finish"
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
