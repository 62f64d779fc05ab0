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

__all__ = ["is_own", "own_constant"]


def own_constant(grid: Mesh, value: npt.ArrayLike) -> fem.Constant:
    """A constant that is no load.

    Args:
        grid: Background grid.
        value: Its value, of any shape.
    """
    constant = fem.Constant(grid, np.asarray(value, float))
    constant._dolfinmpm_own = True
    return constant


def is_own(item: Any) -> bool:
    """Whether a constant or a function of a form is the library's own."""
    return getattr(item, "_dolfinmpm_own", False)
