"""Objects that read their arguments only once; later changes of an argument are refused."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable
from typing import Any, ClassVar

from dolfinmpm._platform.argumentchecks import nearest, shown
from dolfinmpm._platform.errors import ParameterError, UnknownNameError

__all__ = ["ReadList", "ReadOnce", "set_by_user"]

_LIBRARY = __name__.partition(".")[0]


def set_by_user(owner: type, name: str, depth: int = 2) -> bool:
    """Whether a script sets a public attribute of an object of the library.

    The library, and classes that a user derives from its own, may set all names.

    Args:
        owner: Class of the object.
        name: Name of the attribute.
        depth: Number of calls from the script's line to this function.
    """
    if name.startswith("_") or owner.__module__.partition(".")[0] != _LIBRARY:
        return False
    caller = sys._getframe(depth).f_globals.get("__name__", "")
    return caller.partition(".")[0] != _LIBRARY


class ReadList(tuple):
    """A list that a problem has read: its entries can be read, and not changed."""

    __slots__ = ()

    def __getattr__(self, name: str) -> Any:
        if name in ("append", "clear", "extend", "insert", "pop", "remove", "reverse", "sort"):
            raise UnknownNameError(
                f"{name}: the problem has read this list already, and a change has no effect; "
                "make a new problem of the same points, which goes on from their state"
            )
        raise AttributeError(name)


class ReadOnce:
    """Base of classes whose arguments cannot be set later as attributes.

    Plain Python would store such an attribute without effect.

    Raises:
        ParameterError: An argument, or a similar name, is set after the object was made.
        UnknownNameError: The object has no attribute with a name.
    """

    # arguments that may be set later, and arguments that the object keeps as attributes
    _live: ClassVar[frozenset[str]] = frozenset()
    _attributes: ClassVar[frozenset[str]] = frozenset()
    _arguments: ClassVar[frozenset[str]] = frozenset()
    # names of attributes of other classes, with hints for messages
    _elsewhere: ClassVar[dict[str, str]] = {}
    # advice for messages about names that are no arguments
    _hints: ClassVar[dict[str, str]] = {}

    @classmethod
    def _refuse_unknown(cls, names: Iterable[str], hints: dict[str, str]) -> None:
        """Raise for unknown arguments.

        Args:
            names: Names of the given arguments.
            hints: Hints for messages, by the name of the argument.

        Raises:
            ParameterError: An argument is unknown; the message has the nearest name.
        """
        for name in names:
            if name in cls._arguments:
                continue
            hint = f": {hints[name]}" if name in hints else nearest(name, cls._arguments)
            raise ParameterError(f"{cls.__name__} has no argument {name}{hint}")

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        # a collective constructor is wrapped by its barrier
        code = inspect.unwrap(cls.__init__).__code__
        own = code.co_varnames[1 : code.co_argcount + code.co_kwonlyargcount]
        cls._arguments = cls._arguments | frozenset(own)

    def __setattr__(self, name: str, value: Any) -> None:
        first = name in self._attributes and name not in self.__dict__
        if name in self._arguments and name not in self._live and not first:
            raise ParameterError(
                f"{name} = {shown(value)}: {self._called()} has read this argument already, and "
                f"does not look at another one: {self._instead(name)}"
            )
        if name not in self.__dict__:
            self._refuse_new(name)
        elif not first and name not in self._live and set_by_user(type(self), name):
            hint = self._hints.get(name, self._instead(name))
            raise ParameterError(
                f"{self._called()} sets {name} itself, and a script cannot: {hint}"
            )
        super().__setattr__(name, value)

    def __getattr__(self, name: str) -> Any:
        # Python calls this only for missing attributes
        if name.startswith("_"):
            raise AttributeError(name)
        elsewhere, known = self._elsewhere.get(name), (n for n in dir(type(self)) if n[0] != "_")
        hint = f": {elsewhere}" if elsewhere else nearest(name, known)
        raise UnknownNameError(f"{type(self).__name__} has no {name}{hint}")

    def _refuse_new(self, name: str) -> None:
        """Raise ParameterError if a script sets a result, or a name that nothing reads."""
        kind = type(self)
        if not set_by_user(kind, name, 3):
            return
        found = getattr(kind, name, None)
        if callable(found) or (isinstance(found, property) and found.fset is None):
            raise ParameterError(f"{name} is a result of {self._called()}; it cannot be set")
        if found is None:
            near = nearest(name, kind._arguments)
            hint = near or f": {self._hints.get(name, 'keep a value of your own in a variable')}"
            raise ParameterError(
                f"{self._called()} has no argument {name}, and setting it has no effect{hint}"
            )

    def _called(self) -> str:
        """Name of the object in messages."""
        return f"this {type(self).__name__}"

    def _instead(self, name: str) -> str:
        """Advice for a changed argument, for messages."""
        return f"make a new {type(self).__name__} with {name}=..."
