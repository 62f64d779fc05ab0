"""Constants in forms: the library's own constants, and constants that move something.

A number in a form is compiled into the form, and every new number compiles the form again. The
library therefore takes constants. It marks its own constants, so that steps do not scale them as
loads, and messages do not list them as loads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError

__all__ = [
    "begin_at_zero", "first_step_share", "is_own", "mark_moving", "own_constant", "reached",
    "take_reached",
]  # fmt: skip


def own_constant(grid: Mesh, value: npt.ArrayLike) -> fem.Constant:
    """A constant of the library, which is no load.

    Args:
        grid: Background grid.
        value: Value of the constant, of any shape.
    """
    constant = fem.Constant(grid, np.asarray(value, float))
    constant._dolfinmpm_own = True
    return constant


def begin_at_zero(what: str, constant: fem.Constant) -> None:
    """Mark a user's constant as a displacement, and begin its motion at zero.

    A load acts in full from the start. A displacement that is not zero at the start is still to be
    travelled: the first step divides it into substeps, as later steps divide later increments.

    Args:
        what: Name of the argument.
        constant: The constant, a displacement (m).

    Raises:
        ParameterError: The constant has moved something else already, by its present value.
    """
    before = reached(constant)
    if before is not None and np.any(before) and np.array_equal(before, constant.value):
        raise ParameterError(
            f"{what} = {shown(constant.value)} is a constant by which steps have moved something "
            f"else already; {what} would move by the same displacement once more: give it its own "
            "constant, dolfinx.fem.Constant(grid, 0.0), with the same number of components"
        )
    constant._dolfinmpm_reached = np.zeros_like(constant.value)


def mark_moving(constant: fem.Constant) -> None:
    """Mark a constant on which a displacement depends. It begins at its present value.

    In time, such a constant changes evenly over a step. A load may jump at the start of a step.
    """
    if reached(constant) is None:
        constant._dolfinmpm_reached = np.array(constant.value)


def first_step_share(grid: Mesh) -> fem.Constant:
    """A constant that goes from 0 to 1 in the first step, the factor of a given displacement."""
    share = own_constant(grid, 1.0)
    begin_at_zero("share", share)
    return share


def reached(item: Any) -> npt.NDArray[np.float64] | None:
    """Value of a moving constant in the last converged state (m); None for other constants."""
    return getattr(item, "_dolfinmpm_reached", None)


def take_reached(item: Any) -> None:
    """Keep the value of a constant as converged, if the constant moves something."""
    if reached(item) is not None:
        item._dolfinmpm_reached = np.array(item.value)


def is_own(item: Any) -> bool:
    """Whether a constant or a function in a form belongs to the library."""
    return getattr(item, "_dolfinmpm_own", False)
