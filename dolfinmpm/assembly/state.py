"""The state of what goes from step to step, as values by name.

`state` and `set_state` of points, terms, schemes and solvers serve checkpoints, and states that are
put back. A plain value is the same on all ranks. `Local` and `OfCells` mark what is not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import check_kind
from dolfinmpm._platform.errors import ParameterError

__all__ = ["HasState", "Local", "OfCells", "gathered", "given_back"]


@dataclass(frozen=True)
class Local:
    """An array of this rank alone; it is lost where ranks or the partition of the grid differ."""

    values: npt.NDArray[Any]


@dataclass(frozen=True)
class OfCells:
    """An array of one row per cell that this rank owns."""

    values: npt.NDArray[Any]


class HasState(Protocol):
    """What keeps values from step to step."""

    def state(self) -> dict[str, Any]:
        """All of them, by name. Collective."""

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Take what `state` returned. Collective."""


def gathered(parts: Iterable[tuple[str, HasState]]) -> dict[str, Any]:
    """The states of some parts in one, with the name of each part before those of its values."""
    return {f"{part}: {k}": v for part, one in parts for k, v in one.state().items()}


def given_back(parts: Iterable[tuple[str, HasState]], values: Mapping[str, Any]) -> None:
    """Give each part what `gathered` had of it. Collective."""
    check_kind("state", values, Mapping, "give what state() of such a problem has returned")
    for part, one in parts:
        start = f"{part}: "
        own = {k.removeprefix(start): v for k, v in values.items() if k.startswith(start)}
        try:
            one.set_state(own)
        except KeyError as missing:
            raise ParameterError(
                f"the state has no {missing} of '{part}': give what state() of a problem with the "
                "same form, conditions and options has returned"
            ) from missing
