"""Numbers of what is made on a grid, in the order in which all ranks make it."""

from __future__ import annotations

from dolfinx.mesh import Mesh

__all__ = ["next_on"]


def next_on(grid: Mesh, kind: str) -> int:
    """The number of what is being made on a grid, from 1; ranks compare by it what they give.

    Args:
        grid: The grid.
        kind: What is made.
    """
    made = grid.__dict__.setdefault("_dolfinmpm_made", {})
    made[kind] = made.get(kind, 0) + 1
    return made[kind]
