"""Arrays of the points' fields, and the fields that may have changed since a moment."""

from __future__ import annotations

import sys
from collections import UserDict
from collections.abc import Mapping
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

__all__ = ["FieldArrays", "checksums"]

Array = npt.NDArray[Any]
Rows = slice | npt.NDArray[np.bool_]


class FieldArrays(UserDict[str, Array]):
    """Arrays by the names of their fields, as a dictionary.

    A change inside an array cannot be seen. But an array is unchanged since a moment under two
    conditions: nobody else held the array at the moment, and nobody has asked for it since. An
    object that keeps results computed from the fields therefore asks for a `moment` at the end of
    its work. Later it asks for the fields `touched` since then.

    Python's count of references tells whether somebody else holds an array. If all arrays counted
    as held, an explicit step called alone would take 2.8 times as long with 56 points, and 1.7
    times as long with 3100 points.

    An array that only steps may change gets a seal, made of sums of its values. A change inside the
    array breaks the seal. An array that replaces it has none.

    Args:
        arrays: The first arrays.
    """

    def __init__(self, arrays: Mapping[str, Array] | None = None):
        self._moment = 0
        # the moment in which an array was last returned or stored
        self._handed: dict[str, int] = {}
        self._seals: dict[str, tuple[float, ...]] = {}
        super().__init__(arrays)

    def __getitem__(self, name: str) -> Array:
        array = self.data[name]
        self._handed[name] = self._moment
        return array

    def __setitem__(self, name: str, array: Array) -> None:
        self.data[name] = array
        self._handed[name] = self._moment
        self._seals.pop(name, None)

    def __delitem__(self, name: str) -> None:
        del self.data[name], self._handed[name]
        self._seals.pop(name, None)

    def read(self, name: str) -> Array:
        """An array for reading at once, not for keeping; the array does not count as touched."""
        return self.data[name]

    def moment(self) -> int:
        """This moment, for `touched`. Arrays that others hold count as touched from now on."""
        self._moment += 1
        for name in self.data:
            if self._held(name):
                self._handed[name] = self._moment
        return self._moment

    def touched(self, since: int | None) -> set[str]:
        """Names of the fields that may have changed since a moment; None means all fields."""
        if since is None:
            return set(self.data)
        return {name for name, moment in self._handed.items() if moment >= since}

    def seal(self, name: str, rows: Rows = slice(None)) -> None:
        """Note the present values of some rows of an array."""
        self._seals[name] = checksums(self.data[name][rows])

    def unseal(self, *names: str) -> None:
        """Allow changes inside arrays until the next seal."""
        for name in names:
            self._seals.pop(name, None)

    def broken(self, name: str, rows: Rows = slice(None)) -> bool:
        """Whether the rows of an array have other values than at its seal, if it has one."""
        seal = self._seals.get(name)
        return seal is not None and not np.array_equal(
            seal, checksums(self.data[name][rows]), equal_nan=True
        )

    def _held(self, name: str) -> bool:
        """Whether somebody else holds an array or a view of it."""
        array = self.data[name]
        if array.base is not None or not array.flags.owndata:
            # the array is a view, and others may hold its base
            return True
        del array
        return sys.getrefcount(self.data[name]) > _alone


def checksums(values: Array) -> tuple[float, ...]:
    """Sums of both halves of the values, of squares, and of products of neighbours.

    The last one tells most changes of the order, and the halves tell a reversed order.
    """
    return _sums(values.ravel())


# compiled code sums in the same order each time, which some libraries do not
@numba.njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _sums(flat):
    """See `checksums`; one pass over the values."""
    half, last = flat.size // 2, flat.size - 1
    lower = upper = squares = neighbours = 0.0
    for i in range(half):
        value = float(flat[i])
        lower += value
        squares += value * value
        neighbours += value * float(flat[i + 1])
    for i in range(half, last):
        value = float(flat[i])
        upper += value
        squares += value * value
        neighbours += value * float(flat[i + 1])
    if last >= 0:
        value = float(flat[last])
        upper += value
        squares += value * value
    return lower, upper, squares, neighbours


def _references() -> int:
    """Number of references if nobody else holds an array."""
    arrays = {"": np.empty(0)}
    return sys.getrefcount(arrays[""])


_alone = _references()
