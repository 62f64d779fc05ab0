"""Objects that read their arguments when they are made, and tell who changes one later."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Iterable
from typing import Any, ClassVar

from dolfinmpm._platform.checks import shown
from dolfinmpm._platform.errors import ParameterError

__all__ = ["ReadOnce"]


class ReadOnce:
    """Base of classes whose arguments cannot be assigned to as attributes.

    What Python does without it is silent: the attribute is there, and nobody reads it.

    Raises:
        ParameterError: An argument is assigned to after the object was made.
    """

    # arguments that may be assigned to, and those that the object keeps under their own names
    _live: ClassVar[frozenset[str]] = frozenset()
    _attributes: ClassVar[frozenset[str]] = frozenset()
    _arguments: ClassVar[frozenset[str]] = frozenset()

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
        super().__setattr__(name, value)

    def _called(self) -> str:
        """What messages call it."""
        return f"this {type(self).__name__}"

    def _instead(self, name: str) -> str:
        """What to do where an argument is to be another one, for messages."""
        return f"make a new {type(self).__name__} with {name}=..."
