"""Records of bodies: forces that calculate as vectors, and names that messages know."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dolfinmpm._platform.errors import UnknownNameError

__all__ = ["BodyRecords", "Components"]


def _as_array(name: str) -> Any:
    def calculate(self: Components, *others: Any) -> Any:
        return getattr(np.asarray(self, float), name)(*(np.asarray(o, float) for o in others))

    return calculate


class Components(list[float]):
    """Components of a vector: a list, for files and comparisons, that calculates as an array.

    Python repeats a list that is multiplied by 2, and joins lists that are added.
    """

    __add__ = __iadd__ = _as_array("__add__")
    __radd__ = _as_array("__radd__")
    __sub__ = _as_array("__sub__")
    __rsub__ = _as_array("__rsub__")
    __mul__ = __rmul__ = __imul__ = _as_array("__mul__")
    __truediv__ = _as_array("__truediv__")
    __neg__ = _as_array("__neg__")


class BodyRecords(dict[str, dict[str, Any]]):
    """Name of a body or a contact → its record; see `StepRecord.bodies`.

    Raises:
        UnknownNameError: There is no such body or contact.
    """

    def __init__(self, given: Mapping[str, Mapping[str, Any]] | Any = ()):
        super().__init__()
        for name, record in dict(given).items():
            self[name] = {
                key: Components(value) if isinstance(value, list) else value
                for key, value in record.items()
            }

    def __missing__(self, name: str) -> dict[str, Any]:
        known = f"there are {', '.join(map(repr, self))}" if self else "there is none"
        raise UnknownNameError(
            f"no rigid body and no contact in the form is named {name!r}; {known}: a body has the "
            "name of mpm.RigidBody(..., name=...), and its contact is added to the form"
        )
