"""How many material points are too many: for a cell, or for the machine."""

from __future__ import annotations

import os

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError

__all__ = ["check_amount", "check_per_cell"]

# Points of a cell beyond which a number is a slip, and what a point takes at least (bytes)
_MOST_OF_A_CELL = 10_000
_BYTES = 300


def check_per_cell(per_cell: int, gdim: int) -> None:
    """Raise ParameterError if a cell would have too many points to be meant."""
    if per_cell > _MOST_OF_A_CELL or per_cell**gdim > _MOST_OF_A_CELL:
        many = f"{float(per_cell) ** gdim:.4g}" if per_cell < 1e100 else "far too many"
        raise ParameterError(
            f"per_cell = {shown(per_cell)} puts {many} points into each cell, and must not put "
            f"more than {_MOST_OF_A_CELL}; 2 to 4 a direction are usual: refine the grid"
        )


def check_amount(count: int, per_cell: int) -> None:
    """Raise ParameterError if this rank's memory does not hold so many points."""
    memory = _memory()
    if memory is not None and count * _BYTES > memory:
        raise ParameterError(
            f"per_cell = {per_cell} makes {count:.4g} points or parts of cells on one rank, which "
            f"take {count * _BYTES / 1e9:.4g} GB at least, and the machine has {memory / 1e9:.4g} "
            "GB: take fewer points per cell, a coarser grid, or more machines"
        )


def _memory() -> float | None:
    """Memory of this machine (bytes), or None where the system does not tell."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return None
