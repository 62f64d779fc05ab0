"""Constants that the library puts into forms itself.

A number in a form is compiled into it, so that every new one compiles anew. A constant is
not; but it must not pass for a load of the user's, which steps scale and messages list.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinmpm._platform.checks import shown
from dolfinmpm._platform.errors import ParameterError

__all__ = ["begin_at_zero", "is_own", "own_constant", "reached", "take_reached"]


def own_constant(grid: Mesh, value: npt.ArrayLike) -> fem.Constant:
    """A constant that is no load.

    Args:
        grid: Background grid.
        value: Its value, of any shape.
    """
    constant = fem.Constant(grid, np.asarray(value, float))
    constant._dolfinmpm_own = True
    return constant


def begin_at_zero(what: str, constant: fem.Constant) -> None:
    """Tell that what a constant of the user's moves has not moved yet, whatever the constant holds.

    A load acts as it is given; a displacement that is not zero at first is a way still to go, which
    the first step divides as it does those of later ones.

    Args:
        what: Name of the argument.
        constant: The constant.

    Raises:
        ParameterError: It has moved something else to what it holds.
    """
    before = reached(constant)
    if before is not None and np.any(before) and np.array_equal(before, constant.value):
        raise ParameterError(
            f"{what} = {shown(constant.value)} is what steps have moved something else by already, "
            "and would move this by it once more: give it a constant of its own, "
            "dolfinx.fem.Constant(grid, 0.0) with as many components"
        )
    constant._dolfinmpm_reached = np.zeros_like(constant.value)


def reached(item: Any) -> npt.NDArray[np.float64] | None:
    """What a constant that moves something held in the last converged state; None of others."""
    return getattr(item, "_dolfinmpm_reached", None)


def take_reached(item: Any) -> None:
    """Take the value of a constant, if it moves something, for that of a converged state."""
    if reached(item) is not None:
        item._dolfinmpm_reached = np.array(item.value)


def is_own(item: Any) -> bool:
    """Whether a constant or a function of a form is the library's own."""
    return getattr(item, "_dolfinmpm_own", False)
