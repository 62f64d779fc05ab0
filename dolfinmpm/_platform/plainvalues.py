"""Plain values of arguments, so that ranks can compare their arguments."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from dolfinmpm._platform.argumentchecks import cut

__all__ = ["PlainValues", "as_text", "difference", "digest", "equal_up_to_rounding", "plain_value"]

# Names and plain values: numbers, words, None, and tuples of them
PlainValues = list[tuple[str, Any]]

# Larger arrays are compared by a checksum
_MOST = 1000


@functools.singledispatch
def plain_value(value: Any) -> Any:
    """Plain value of an argument: a number, a word, None, or a tuple of plain values.

    An object of an unknown type gives the name of its type. Other modules register their types.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
        # arrays in a dataclass differ between ranks
        kept = [
            (name, plain_value(part)) for name, part in parts if not isinstance(part, np.ndarray)
        ]
        return (type(value).__name__, *kept)
    if callable(value):
        return "a function"
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return f"a {type(value).__name__}"


@plain_value.register(str)
@plain_value.register(int)
@plain_value.register(float)
@plain_value.register(type(None))
def _plain(value: Any) -> Any:
    # a subclass of a word or number may have another text
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return kind(value)
    return value


@plain_value.register(np.generic)
def _scalar(value: np.generic) -> Any:
    return plain_value(value.item())


@plain_value.register(np.ndarray)
def _array(value: np.ndarray) -> Any:
    if value.dtype == object or value.size <= _MOST:
        return plain_value(value.tolist())
    shape = " × ".join(map(str, value.shape))
    return f"an array of {shape} with the checksum {zlib.crc32(np.ascontiguousarray(value))}"


@plain_value.register(list)
@plain_value.register(tuple)
def _several(value: Iterable[Any]) -> Any:
    return tuple(plain_value(part) for part in value)


@plain_value.register(set)
@plain_value.register(frozenset)
def _unordered(value: Iterable[Any]) -> Any:
    return tuple(sorted((plain_value(part) for part in value), key=repr))


@plain_value.register(Mapping)
def _named(value: Mapping[Any, Any]) -> Any:
    return tuple((plain_value(name), plain_value(part)) for name, part in value.items())


def digest(plain: Any) -> int:
    """Checksum of plain values (32 bits); the same on all ranks."""
    return zlib.crc32(repr(plain).encode())


def difference(first: PlainValues, other: PlainValues) -> tuple[str, Any, Any] | None:
    """First difference between two ranks: its name and both values, or None.

    Rounding counts as a difference: all ranks must agree on whether a load has changed.
    """
    ours, theirs = dict(first), dict(other)
    for name in dict.fromkeys((*ours, *theirs)):
        a, b = ours.get(name, "nothing"), theirs.get(name, "nothing")
        if not _same(a, b):
            return _within(name, a, b)
    return None


def _within(name: str, a: Any, b: Any) -> tuple[str, Any, Any]:
    """First named part that differs, if the values have named parts."""
    if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
        x, y = next((x, y) for x, y in zip(a, b) if not _same(x, y))
        pairs = all(isinstance(p, tuple) and len(p) == 2 and isinstance(p[0], str) for p in (x, y))
        if pairs and x[0] == y[0]:
            return _within(f"{x[0]} of {name}", x[1], y[1])
        if pairs:
            return name, x[0], y[0]
    elif _are_names(a) and _are_names(b):
        # of long lists only what differs
        return name, tuple(x for x in a if x not in b), tuple(y for y in b if y not in a)
    return name, a, b


def _are_names(value: Any) -> bool:
    return isinstance(value, tuple) and all(isinstance(part, str) for part in value)


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if not (_is_number(a) and _is_number(b)):
        return type(a) is type(b) and a == b
    return a == b or (math.isnan(a) and math.isnan(b))


def equal_up_to_rounding(a: Any, b: Any) -> bool:
    """Whether values differ by no more than rounding."""
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(equal_up_to_rounding, a, b))
    if not (_is_number(a) and _is_number(b)):
        return type(a) is type(b) and a == b
    try:
        return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12)
    except OverflowError:
        # a whole number beyond floats
        return bool(a == b)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def as_text(plain: Any) -> str:
    """Plain values as text for a message; a long text is cut."""
    return cut(repr(plain))
