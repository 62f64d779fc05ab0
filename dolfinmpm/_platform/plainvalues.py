"""Arguments in plain values, so that ranks can compare theirs."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

__all__ = ["Told", "difference", "digest", "in_words", "nearly", "told"]

# Names and plain values: numbers, words, None, and tuples of them
Told = list[tuple[str, Any]]

# Entries of an array beyond which a checksum stands for them
_MOST = 1000


@functools.singledispatch
def told(value: Any) -> Any:
    """An argument in plain values: numbers, words, None, and tuples of them.

    Of what is not known it is the kind. Other modules register theirs.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
        # arrays within are of each rank
        kept = [(name, told(part)) for name, part in parts if not isinstance(part, np.ndarray)]
        return (type(value).__name__, *kept)
    if callable(value):
        return "a function"
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return f"a {type(value).__name__}"


@told.register(str)
@told.register(int)
@told.register(float)
@told.register(type(None))
def _plain(value: Any) -> Any:
    # a word or a number of a subclass has a text of its own
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return kind(value)
    return value


@told.register(np.generic)
def _scalar(value: np.generic) -> Any:
    return told(value.item())


@told.register(np.ndarray)
def _array(value: np.ndarray) -> Any:
    if value.dtype == object or value.size <= _MOST:
        return told(value.tolist())
    shape = " × ".join(map(str, value.shape))
    return f"an array of {shape} with the checksum {zlib.crc32(np.ascontiguousarray(value))}"


@told.register(list)
@told.register(tuple)
def _several(value: Iterable[Any]) -> Any:
    return tuple(told(part) for part in value)


@told.register(set)
@told.register(frozenset)
def _unordered(value: Iterable[Any]) -> Any:
    return tuple(sorted((told(part) for part in value), key=repr))


@told.register(Mapping)
def _named(value: Mapping[Any, Any]) -> Any:
    return tuple((told(name), told(part)) for name, part in value.items())


def digest(plain: Any) -> int:
    """A number of 32 bits that goes with plain values; the same on all ranks."""
    return zlib.crc32(repr(plain).encode())


def difference(first: Told, other: Told) -> tuple[str, Any, Any] | None:
    """What differs between two ranks: its name and both values, or None.

    Rounding counts too: what hangs on whether a load has changed must be the same on all ranks.
    """
    ours, theirs = dict(first), dict(other)
    for name in dict.fromkeys((*ours, *theirs)):
        a, b = ours.get(name, "nothing"), theirs.get(name, "nothing")
        if not _same(a, b):
            return _within(name, a, b)
    return None


def _within(name: str, a: Any, b: Any) -> tuple[str, Any, Any]:
    """The named part that differs, of values that consist of such."""
    if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
        x, y = next((x, y) for x, y in zip(a, b) if not _same(x, y))
        pairs = all(isinstance(p, tuple) and len(p) == 2 and isinstance(p[0], str) for p in (x, y))
        if pairs and x[0] == y[0]:
            return _within(f"{x[0]} of {name}", x[1], y[1])
        if pairs:
            return name, x[0], y[0]
    return name, a, b


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if not (_is_number(a) and _is_number(b)):
        return type(a) is type(b) and a == b
    return a == b or (math.isnan(a) and math.isnan(b))


def nearly(a: Any, b: Any) -> bool:
    """Whether values may differ by rounding alone."""
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(nearly, a, b))
    if not (_is_number(a) and _is_number(b)):
        return type(a) is type(b) and a == b
    return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def in_words(plain: Any) -> str:
    """Plain values in a message, cut where they are long."""
    text = " ".join(repr(plain).split())
    return text if len(text) <= 200 else text[:197] + "..."
