"""Objects that hold a grid, ranks and compiled code, and that cannot be copied."""

from __future__ import annotations

from typing import Any, NoReturn

from dolfinmpm._platform.errors import ParameterError

__all__ = ["Uncopied"]


class Uncopied:
    """Base of classes whose objects cannot be copied or pickled.

    Plain Python would end `copy.deepcopy` in a TypeError about the mesh. `copy.copy` would make an
    object that shares its arrays: steps of the copy would move the original.

    Raises:
        ParameterError: Such an object is copied or pickled.
    """

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        """Refuse copies: `copy.copy`, `copy.deepcopy` and `pickle` call it."""
        raise ParameterError(
            f"a {type(self).__name__} cannot be copied or pickled, because it holds the grid and "
            "its ranks: make another one with the same arguments. To come back to a state, keep it "
            "by problem.save(path), and call problem.load(path)"
        )
