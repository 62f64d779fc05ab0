"""Motions and loads of rigid bodies as a user gives them: numbers, constants, functions of time."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm._platform.argumentchecks import at_time, cut, vector
from dolfinmpm._platform.errors import ParameterError

__all__ = ["Given", "Load"]

Array = npt.NDArray[np.float64]


class Given:
    """What a motion and a load have in common: a number, a function of t, or a constant."""

    given: Any

    def _refuse_constant(self) -> None:
        if isinstance(self.given, fem.Constant):
            raise ParameterError(
                "a RigidBody with a dolfinx.fem.Constant cannot be copied or pickled, because the "
                "constant belongs to the grid: make another body with the same arguments"
            )

    def __deepcopy__(self, memo: Any) -> Any:
        """A copy with the same functions, unless a constant of a grid is given."""
        self._refuse_constant()
        memo[id(self)] = copied = object.__new__(type(self))
        copied.__dict__.update(copy.deepcopy(self.__dict__, memo))
        return copied

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Refuse to be pickled with a constant, or with a function that `pickle` does not find."""
        self._refuse_constant()
        for function in filter(callable, self.__dict__.values()):
            try:
                pickle.dumps(function)
            except Exception as error:
                raise ParameterError(
                    "a RigidBody with a function of time can be pickled if the function is one of "
                    f"a module, made by def, and {cut(str(error))}: make such a function, or "
                    "another body with the same arguments; copy.deepcopy works"
                ) from error
        return super().__reduce_ex__(protocol)


class Load(Given):
    """A load: numbers, a DOLFINx constant, or a function of time."""

    def __init__(self, name: str, given: Any, size: int):
        self._name, self._size, self.given = name, size, given
        if given is not None and not isinstance(given, fem.Constant) and not callable(given):
            self.given = vector(name, given, size)
        if isinstance(given, fem.Constant) and given.value.size != size:
            raise ParameterError(f"{name} has {given.value.size} components and must have {size}")

    def refuse_held(self, free: npt.NDArray[np.intp]) -> None:
        """Raise ParameterError if all that it acts on are components that are not free."""
        held = np.setdiff1d(np.arange(self._size), free)
        numbers = self.given if isinstance(self.given, np.ndarray) else np.ones(self._size)
        if self.given is not None and numbers.any() and not np.delete(numbers, held).any():
            raise ParameterError(
                f"the {self._name} acts on components that are not free and would do nothing: let "
                "the body move there by free=..., or leave it out"
            )

    def value(self, t: float) -> Array:
        """Value at time t (N, N m or m/s²), shape (size,)."""
        given = self.given
        if given is None:
            return np.zeros(self._size)
        if isinstance(given, fem.Constant):
            return np.array(given.value, float).ravel()
        if callable(given):
            return vector(f"{self._name}({t:g})", at_time(self._name, given, t), self._size)
        return np.asarray(given)
