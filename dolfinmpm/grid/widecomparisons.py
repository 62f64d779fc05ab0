"""Functions of places that compare map coordinates by NumPy's default tolerance."""

from __future__ import annotations

from collections.abc import Callable
from types import CodeType
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import WideComparisonWarning, warn
from dolfinmpm.grid.linecells import FAR

__all__ = ["warn_of_wide_comparison"]

# Default of `rtol` in np.isclose
_SHARE = 1e-5


def warn_of_wide_comparison(
    comm: MPI.Comm,
    where: Callable[[npt.NDArray[np.float64]], Any],
    low: npt.NDArray[np.float64],
    high: npt.NDArray[np.float64],
) -> None:
    """Warn on rank 0 if np.isclose takes a layer of nodes for one line or plane.

    Its tolerance is 1e-5 of the coordinate: 50 m at 5e6 m. A function that was to hold the bottom
    of a body then holds all of the body.

    Args:
        comm: Communicator of the grid.
        where: The function of places.
        low, high: Lowest and highest coordinates of the nodes that it chose (m), shape (gdim,).
    """
    width, far = high - low, np.maximum(np.abs(low), np.abs(high))
    thick = np.all(width > 2 * FAR * far)
    wide = np.flatnonzero(width <= 2 * _SHARE * far)
    if not thick or not wide.size or not _compares(getattr(where, "__code__", None)):
        return
    d = wide[0]
    warn(
        comm,
        f"the function of places chooses nodes from {low} to {high} m, on no single line or plane. "
        f"np.isclose compares with a tolerance of {_SHARE * far[d]:.3g} m at x[{d}] = "
        f"{far[d]:.8g} m, 1e-5 of it: give np.isclose(x[{d}], ..., rtol=0.0, atol=1e-6), or "
        "subtract an origin near the body",
        WideComparisonWarning,
    )


def _compares(code: CodeType | None) -> bool:
    """Whether a function, or one within it, calls np.isclose without a tolerance of its own."""
    if code is None:
        return False
    inner = [one for one in code.co_consts if isinstance(one, CodeType)]
    # names of keywords are a tuple among the constants
    keywords = [name for one in code.co_consts if isinstance(one, tuple) for name in one]
    return ("isclose" in code.co_names and "rtol" not in keywords) or any(map(_compares, inner))
