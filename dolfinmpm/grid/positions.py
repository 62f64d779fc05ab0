"""The one layout in which a user's function gets positions.

Arrays of positions have shape (points, gdim), a row per point, wherever they are given or told.
Functions of positions have the layout of DOLFINx:

Wherever dolfinmpm takes a function of positions (places and values of conditions, faces
of a surface, densities, parameters of laws, stresses, `Where`), it hands over one array x of
shape (gdim, n), one row a coordinate as DOLFINx has it, and takes n values. There is no
third row in 2D: `x[-1]` is the height in every dimension, and a function that asks for a
coordinate which is not there is told so, where a row of zeros would let it go wrong in
silence. Functions written for DOLFINx that use `x[0] ... x[gdim - 1]` work unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.checks import shown
from dolfinmpm._platform.errors import DolfinMPMError, ParameterError

__all__ = ["ask", "choose"]

Array = npt.NDArray[np.float64]


def _call(what: str, function: Callable[[Array], Any], x: Array) -> Any:
    n, d = x.shape
    try:
        return function(np.ascontiguousarray(x.T))
    except DolfinMPMError:
        raise  # says already what is wrong
    except Exception as error:
        text = " ".join(str(error).split())
        text = text if len(text) <= 200 else text[:197] + "..."
        raise ParameterError(
            f"{what} failed with {type(error).__name__}: {text}; it is called with one array of "
            f"positions (m) of shape ({d}, {n}), one row a coordinate"
        ) from error


def ask(
    what: str, function: Callable[[Array], Any], x: Array, shape: tuple[int, ...] = ()
) -> npt.NDArray[np.float64]:
    """Numbers that a user's function has at positions. Not collective; see `call_together`.

    Args:
        what: What the function is, for messages.
        function: Function of positions in the layout of this module.
        x: Positions (m), shape (n, gdim). Without any the function is not called, for many
            cannot answer about nothing.
        shape: Shape of one value.

    Returns:
        Shape (n, *shape); a single value is given to all positions.

    Raises:
        ParameterError: The function fails, or returns something else.
    """
    n = len(x)
    if n == 0:
        return np.empty((0, *shape))
    answer = _call(what, function, x)
    try:
        values = np.asarray(answer, float)
    except (TypeError, ValueError):
        values = None
    if values is None or values.shape not in (shape, (n, *shape)):
        got = shown(answer) if values is None else f"shape {values.shape}"
        raise ParameterError(
            f"{what} should return numbers of shape {(n, *shape)} for positions of shape "
            f"{x.T.shape}, got {got}"
        )
    return np.broadcast_to(values, (n, *shape)).copy()


def choose(what: str, function: Callable[[Array], Any], x: Array) -> npt.NDArray[np.bool_]:
    """Which positions a user's function holds for. Not collective; see `call_together`.

    Args:
        what: What the function is, for messages.
        function: Function of positions in the layout of this module.
        x: Positions (m), shape (n, gdim). Without any the function is not called.

    Returns:
        Shape (n,).

    Raises:
        ParameterError: The function fails, or returns anything but n booleans.
    """
    n = len(x)
    if n == 0:
        return np.zeros(0, bool)
    answer = _call(what, function, x)
    values = np.asarray(answer)
    if values.shape != (n,) or values.dtype != bool:
        raise ParameterError(
            f"{what} should return {n} booleans for positions of shape {x.T.shape}, got "
            f"{values.dtype} of shape {values.shape}; compare coordinates, as in x[0] < 1"
        )
    return values
