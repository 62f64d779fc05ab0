"""Loads of a step: DOLFINx constants and functions on their way to new values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

__all__ = ["Loads"]


class Loads:
    """The constants and functions of a form, between the last converged step and the next.

    The user sets them to what the next step is to reach. A part of a step takes
    them that part of the way.

    Args:
        items: Constants and functions; each is taken once.
        increments: Functions that are solved for and carry no load.
    """

    def __init__(self, items: Sequence[Any], increments: Sequence[fem.Function]):
        self._items: list[Any] = []
        for item in items:
            if not any(item is known for known in (*self._items, *increments)):
                self._items.append(item)
        self._start = self._read()
        self._target = self._start

    @staticmethod
    def _array(item: Any) -> npt.NDArray[np.float64]:
        return item.x.array if isinstance(item, fem.Function) else item.value

    def _read(self) -> list[npt.NDArray[np.float64]]:
        return [np.array(self._array(item), copy=True) for item in self._items]

    def aim(self) -> None:
        """Take the present values as those to reach."""
        self._target = self._read()

    def set(self, share: float) -> None:
        """Set the values at that share of the way."""
        for item, start, target in zip(self._items, self._start, self._target):
            self._array(item)[...] = target if share >= 1 else start + share * (target - start)

    def release(self) -> None:
        """Take the present values as those of a converged state."""
        self._start = self._read()

    def converged(self) -> list[tuple[Any, npt.NDArray[np.float64]]]:
        """Each constant and function, with its values in the last converged state."""
        return list(zip(self._items, self._start))

    def describe(self) -> str:
        """The constants' present values, for messages."""
        values = [f"{item.value}" for item in self._items if isinstance(item, fem.Constant)]
        return "constants " + ", ".join(values) if values else "no constants"
