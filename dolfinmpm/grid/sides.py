"""Sides of a grid by name, such as "left", or by axis, such as "x-"."""

from __future__ import annotations

from typing import Any

from dolfinmpm._platform.argumentchecks import choice
from dolfinmpm._platform.errors import ParameterError

__all__ = ["side_of"]


def _sides(gdim: int) -> dict[str, tuple[int, int]]:
    """Axis and end (0: lower, 1: upper) of each side; bottom and top are on the last axis."""
    last = gdim - 1
    sides = {"left": (0, 0), "right": (0, 1), "bottom": (last, 0), "top": (last, 1)}
    if gdim == 3:
        sides |= {"front": (1, 0), "back": (1, 1)}
    return sides


def side_of(where: str, gdim: int) -> tuple[str, int, int]:
    """Name, axis and end (0: lower, 1: upper) of a side of the grid.

    Args:
        where: Name of the side; see `prescribed`.
        gdim: Dimension of space.

    Raises:
        ParameterError: The grid has no side with this name.
    """
    name = _side(where, gdim)
    return (name, *_sides(gdim)[name])


def _side(where: str, gdim: int) -> str:
    """Name of a side, which may be given by its axis."""
    by_axis: dict[Any, str] = {}
    for name, (axis, end) in _sides(gdim).items():
        by_axis.setdefault(f"{'xyz'[axis]}{'-+'[end]}", name)
    if isinstance(where, str) and where.lower() in by_axis:
        return by_axis[where.lower()]
    try:
        return choice("side", where, _sides(gdim))
    except ParameterError as error:
        axes = ", ".join(f'"{side}"' for side in by_axis)
        raise ParameterError(
            f"{error}; or a function of positions; or a side by its axis, {axes}"
        ) from None
