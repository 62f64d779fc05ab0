"""Objects that read their arguments when they are made, and tell who changes one later."""

from __future__ import annotations

import difflib
import inspect
import sys
from collections.abc import Iterable
from typing import Any, ClassVar

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError, UnknownNameError

__all__ = ["ReadList", "ReadOnce"]


class ReadList(tuple):
    """A list that has been read: it can be looked at, and nothing can be added to it."""

    __slots__ = ()

    def __getattr__(self, name: str) -> Any:
        if name in ("append", "clear", "extend", "insert", "pop", "remove", "reverse", "sort"):
            raise UnknownNameError(
                f"{name}: this list has been read already, and a change would not be looked at; "
                "make a new problem of the same points, which goes on from their state"
            )
        raise AttributeError(name)


class ReadOnce:
    """Base of classes whose arguments cannot be assigned to as attributes.

    What Python does without it is silent: the attribute is there, and nobody reads it.

    Raises:
        ParameterError: An argument is assigned to after the object was made, or a name that is
            nearly one.
        UnknownNameError: What is asked for is not there.
    """

    # arguments that may be assigned to, and those that the object keeps under their own names
    _live: ClassVar[frozenset[str]] = frozenset()
    _attributes: ClassVar[frozenset[str]] = frozenset()
    _arguments: ClassVar[frozenset[str]] = frozenset()
    # names that others have, and what is said to those who ask for them
    _elsewhere: ClassVar[dict[str, str]] = {}

    @classmethod
    def _refuse_unknown(cls, names: Iterable[str], hints: dict[str, str]) -> None:
        """Raise for arguments that the class and those that it is made of do not have.

        Args:
            names: Names of the arguments given.
            hints: What is said of some of them.

        Raises:
            ParameterError: One is unknown; the message has the nearest.
        """
        for name in names:
            if name in cls._arguments:
                continue
            near = difflib.get_close_matches(name, cls._arguments, 1)
            hint = f"; did you mean {near[0]}?" if near else ""
            hint = f": {hints[name]}" if name in hints else hint
            raise ParameterError(f"{cls.__name__} has no argument {name}{hint}")

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        # what is collective has a door around it
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
        super().__setattr__(name, value)

    def __getattr__(self, name: str) -> Any:
        # only what is not there comes here
        if name.startswith("_"):
            raise AttributeError(name)
        near = difflib.get_close_matches(name, [n for n in dir(type(self)) if n[0] != "_"], 1)
        hint = self._elsewhere.get(name) or (f"did you mean {near[0]}?" if near else "")
        raise UnknownNameError(f"{type(self).__name__} has no {name}{hint and f': {hint}'}")

    def _refuse_new(self, name: str) -> None:
        """Raise ParameterError where a name that nobody reads, or may set, is assigned to.

        Names of the user's own are welcome, and those that the library itself sets.
        """
        kind = type(self)
        caller = sys._getframe(2).f_globals.get("__name__", "")
        if caller.partition(".")[0] == __name__.partition(".")[0] or name.startswith("_"):
            return
        found = getattr(kind, name, None)
        if callable(found) or (isinstance(found, property) and found.fset is None):
            raise ParameterError(f"{name} is what {self._called()} tells; it cannot be set")
        near = difflib.get_close_matches(name, kind._arguments, 1, 0.8)
        if found is None and near:
            raise ParameterError(
                f"{self._called()} has no {name}, and nobody would read it; did you mean {near[0]}?"
            )

    def _called(self) -> str:
        """What messages call it."""
        return f"this {type(self).__name__}"

    def _instead(self, name: str) -> str:
        """What to do where an argument is to be another one, for messages."""
        return f"make a new {type(self).__name__} with {name}=..."
