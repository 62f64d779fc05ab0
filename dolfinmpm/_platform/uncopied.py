"""Classes whose objects cannot be copied, and classes whose attributes scripts cannot set."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NoReturn, TypeVar

from dolfinmpm._platform.argumentchecks import nearest, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.readonce import set_by_user

__all__ = ["FOUND", "Settled", "Unchanged", "Uncopied", "unchanged"]

Kind = TypeVar("Kind")
# What to do instead, for objects that a script makes, and for results
MADE = "Make a new {kind} with other arguments, and use it in place of this one"
FOUND = "A {kind} is a result: keep a value of your own in a variable"


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


def _refuse_set(thing: Any, name: str, value: Any) -> None:
    """Raise ParameterError if a script sets an attribute that it may not set."""
    owner = type(thing)
    if name in getattr(owner, "_live", ()) or not set_by_user(owner, name, 3):
        return
    kind = owner.__name__.lstrip("_")
    remedy = getattr(owner, "_remedy", MADE)
    if isinstance(getattr(owner, name, None), property):
        why, near, remedy = "is a result", "", "Keep a value of your own in a variable"
    elif hasattr(owner, name) or name in thing.__dict__:
        why, near = "is read once", ""
    else:
        why = "is no attribute of it, and would do nothing"
        near = nearest(name, [one for one in thing.__dict__ if one[0] != "_"])
    raise ParameterError(
        f"{name} = {shown(value)} of this {kind}: {name} {why}. {remedy.format(kind=kind)}{near}"
    )


class Unchanged:
    """Base of classes whose attributes only the library sets.

    Plain Python would take a misspelt name without a word, and another value of a known one, which
    those who have read it already would not see. A class may give `_remedy`, what to do instead,
    and `_live`, names that scripts may set.

    Raises:
        ParameterError: A script sets an attribute.
    """

    _remedy: ClassVar[str] = MADE
    _live: ClassVar[frozenset[str]] = frozenset()

    def __setattr__(self, name: str, value: Any) -> None:
        _refuse_set(self, name, value)
        super().__setattr__(name, value)


def unchanged(remedy: str = MADE) -> Callable[[type[Kind]], type[Kind]]:
    """Decorator of dataclasses whose attributes only the library sets, as of `Unchanged`.

    Frozen dataclasses would raise Python's own FrozenInstanceError, which tells no remedy.

    Args:
        remedy: What to do instead; {kind} is the name of the class.
    """

    def decorate(cls: type[Kind]) -> type[Kind]:
        former = cls.__setattr__

        def __setattr__(self: Any, name: str, value: Any) -> None:
            _refuse_set(self, name, value)
            former(self, name, value)

        cls.__setattr__, cls._remedy = __setattr__, remedy  # type: ignore
        return cls

    return decorate


class Settled(Uncopied, Unchanged):
    """Base of classes that cannot be copied, and whose attributes only the library sets.

    Raises:
        ParameterError: A script sets an attribute, or such an object is copied.
    """
