"""Objects that hold a grid, ranks and compiled code: they cannot be copied, or changed by hand."""

from __future__ import annotations

from typing import Any, NoReturn

from dolfinmpm._platform.argumentchecks import nearest, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.readonce import set_by_user

__all__ = ["Settled", "Unchanged", "Uncopied"]


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


class Unchanged:
    """Base of classes whose attributes only the library sets.

    Plain Python would take a misspelt name without a word, and another value of a known one, which
    those who have read it already would not see.

    Raises:
        ParameterError: A script sets an attribute.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if set_by_user(type(self), name):
            kind = type(self).__name__
            known = hasattr(type(self), name) or name in self.__dict__
            why = "is read once" if known else "is no attribute of it, and would do nothing"
            near = "" if known else nearest(name, self.__dict__)
            raise ParameterError(
                f"{name} = {shown(value)} of this {kind}: {name} {why}. Make a new {kind} with "
                f"other arguments, and give it to a new problem{near}"
            )
        super().__setattr__(name, value)


class Settled(Uncopied, Unchanged):
    """Base of classes that cannot be copied, and whose attributes only the library sets.

    Raises:
        ParameterError: A script sets an attribute, or such an object is copied.
    """
