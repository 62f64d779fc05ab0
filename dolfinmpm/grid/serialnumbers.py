"""Serial numbers of objects on a grid, in the order in which all ranks make the objects."""

from __future__ import annotations

from dolfinx.mesh import Mesh

__all__ = ["next_number"]


def next_number(grid: Mesh, kind: str) -> int:
    """The next serial number of a kind of object on a grid, from 1.

    Ranks compare their arguments by this number.

    Args:
        grid: The grid.
        kind: Kind of the object, such as "spaces".
    """
    made = grid.__dict__.setdefault("_dolfinmpm_made", {})
    made[kind] = made.get(kind, 0) + 1
    return made[kind]
