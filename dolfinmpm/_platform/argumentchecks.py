"""Checks of single arguments; their errors name the value, the limit and a way out."""

from __future__ import annotations

import difflib
import inspect
import math
import numbers
import operator
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import DolfinMPMError, ParameterError

__all__ = [
    "Tags", "array_of", "as_tags", "at_time", "check_dictionary", "check_function", "check_kind",
    "check_names", "check_takes", "choice", "coordinates", "cut",
    "floats", "is_endless", "nearest", "number", "refuse_idle", "shown", "truth", "vector",
    "whole",
]  # fmt: skip

Tags = tuple[int, ...] | None


# Number of words that a message lists at most
_MOST = 12
# Bound of motions, loads and places: their squares are numbers
_LARGEST = 1e100
# Largest whole number of an argument: those of NumPy and C end there
_MOST_WHOLE = 2**63 - 1


def shown(value: Any) -> str:
    """Short text for a value in a message."""
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    if isinstance(value, (list, tuple)):
        parts = [shown(part) for part in value[:4]] + ["..."] * (len(value) > 4)
        brackets = "[]" if isinstance(value, list) else "()"
        comma = "," * (isinstance(value, tuple) and len(value) == 1)
        return f"{brackets[0]}{', '.join(parts)}{comma}{brackets[1]}"
    # the default text of an object is an address; the text of a UFL expression can fill a page
    plain = isinstance(value, (str, bool, int, float, complex, type(None)))
    if not plain and not (isinstance(value, np.ndarray) and value.size <= 9):
        return f"a {type(value).__name__}"
    return cut(repr(value), 80)


def cut(text: str, most: int = 200) -> str:
    """A text in one line for a message, with at most so many characters."""
    text = " ".join(text.split())
    return text if len(text) <= most else text[: most - 3] + "..."


def check_kind(what: str, value: Any, kind: type, advice: str) -> None:
    """Raise ParameterError unless a value is an instance of a class.

    Args:
        what: Name of the argument.
        value: The argument.
        kind: The class.
        advice: Advice for the message.
    """
    if not isinstance(value, kind):
        raise ParameterError(f"{what} = {shown(value)} must be a {kind.__name__}: {advice}")


def check_dictionary(what: str, value: Any, kind: str, *, some: bool = False) -> None:
    """Raise ParameterError unless a value is a dictionary, and has entries if `some`.

    Args:
        what: Name of the argument.
        value: The argument.
        kind: Names and values of the dictionary, as text for the message.
        some: Whether it must not be empty.
    """
    if not isinstance(value, Mapping) or (some and not value):
        told = "{}, which is empty," if isinstance(value, Mapping) else shown(value)
        raise ParameterError(f"{what} = {told} must be a dictionary{kind}")


def check_names(what: str, names: Iterable[str], known: Iterable[str], of: str) -> None:
    """Raise ParameterError if an argument has a name that is not known.

    Args:
        what: Name of the argument.
        names: The names that it has.
        known: The known names.
        of: What has the known names, with its verb, as text for the message.
    """
    listed = list(known)
    for name in names:
        if name not in listed:
            raise ParameterError(f"{what} has '{name}', and {of} {', '.join(listed)}")


def check_function(what: str, value: Any, kind: str = "", *arguments: Any) -> None:
    """Raise ParameterError unless a value is a function, and takes arguments if these are given.

    Args:
        what, value: Name of the argument, and the argument.
        kind: Arguments and result of the function, as text for the message.
        arguments: Arguments with which it will be called.
    """
    if not callable(value):
        raise ParameterError(f"{what} = {shown(value)} must be a function{kind and f' {kind}'}")
    if arguments:
        check_takes(what, value, *arguments)


def at_time(what: str, given: Any, t: float) -> Any:
    """Value at a time t (s) of an argument that may be a function of time.

    Raises:
        ParameterError: The argument is a function, and does not take a time, or fails.
    """
    if not callable(given):
        return given
    try:
        return given(t)
    except DolfinMPMError:
        raise
    except Exception as error:
        wrong = _unfit(given, t) if isinstance(error, TypeError) else None
        if wrong is not None:
            raise ParameterError(
                f"{what} = {shown(given)} must be a function of the time (s) alone, such as "
                f"lambda t: 0.1 * t; {wrong}"
            ) from None
        raise ParameterError(
            f"{what}, a function of the time, failed at {t:g} s with {type(error).__name__}: "
            f"{cut(str(error))}"
        ) from error


def check_takes(what: str, function: Any, *arguments: Any) -> None:
    """Raise ParameterError if a function does not take some arguments.

    Args:
        what, function: Its name, and the function.
        arguments: Arguments with which it will be called.
    """
    wrong = _unfit(function, *arguments)
    if wrong is not None:
        # parameters of runs are dictionaries to the user
        names = ("dict" if isinstance(one, dict) else type(one).__name__ for one in arguments)
        kinds = ", ".join(f"a {name}" for name in names)
        raise ParameterError(f"{what} is called with {kinds or 'no arguments'}: {wrong}")


def _unfit(function: Any, *arguments: Any) -> TypeError | None:
    """Why a function does not take some arguments, or None if it does or if that is unknown."""
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError as error:
        return error
    except ValueError:
        # a function of another language has no signature
        pass
    return None


def number(
    what: str,
    value: Any,
    low: float = -math.inf,
    high: float | None = None,
    unit: str = "",
    closed: bool = False,
) -> float:
    """A real number between two limits.

    Args:
        what: Name of the argument.
        value: The argument; words and truth values are no numbers.
        low: Lower limit.
        high: Upper limit; None is no limit, but infinity is refused.
        unit: Unit of the value and the limits.
        closed: Whether the limits themselves are allowed, also an upper limit of infinity.

    Raises:
        ParameterError: The value is no number, or not between the limits.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        # a masked number has a value, which does not count
        value = math.nan if np.ma.is_masked(value) else value.item()
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        raise ParameterError(f"{what} = {shown(value)} must be a number{unit and f' ({unit})'}")
    try:
        given = float(value)
    except OverflowError:
        # a whole number or a fraction beyond 1e308
        raise ParameterError(
            f"{what} = {shown(value)} is beyond the largest floating point number, 1.8e308"
            f"{unit and f' {unit}'}: give a smaller number"
        ) from None
    most = math.inf if high is None else high
    inside = low <= given <= most if closed else low < given < most
    if not inside or (math.isinf(given) and not (closed and given == high)):
        left = f"{'at least' if closed else 'above'} {low:g}" if low > -math.inf else ""
        right = f"{'at most' if closed else 'below'} {most:g}" if most < math.inf else ""
        limits = " and ".join(limit for limit in (left, right) if limit) or "finite"
        undefined = "; nan is the result of a failed computation" * math.isnan(given)
        raise ParameterError(f"{what} = {given:g}{unit and f' {unit}'} must be {limits}{undefined}")
    return given


def is_endless(value: Any, sign: float = 1.0) -> bool:
    """Whether a value is the number infinity, of this sign."""
    # whole numbers beyond 1e308 compare, and do not convert
    return isinstance(value, numbers.Real) and value == sign * math.inf


def whole(what: str, value: Any, least: int, most: float = _MOST_WHOLE) -> int:
    """A whole number from `least` to `most`.

    Raises:
        ParameterError: The value is no whole number, or is less or more.
    """
    try:
        given = None if isinstance(value, (bool, np.bool_)) else operator.index(value)
    except TypeError:
        given = None
    if given is None or given < least:
        raise ParameterError(f"{what} = {shown(value)} must be a whole number of at least {least}")
    if given > most:
        raise ParameterError(f"{what} = {shown(value)} must be a whole number of at most {most:g}")
    return given


def refuse_idle(what: str, given: Any, usual: Any, why: str) -> None:
    """Raise ParameterError if an argument that would do nothing is not the usual one.

    Args:
        what: Name of the argument.
        given: The argument, which has been checked.
        usual: Its default.
        why: Why it would do nothing, and what to do, as text for the message.
    """
    if given != usual:
        raise ParameterError(f"{what} = {shown(given)} would do nothing: {why}")


def per_direction(what: str, given: Any, directions: int) -> npt.NDArray[np.float64]:
    """One number per direction, shape (directions,); one number counts for all.

    Raises:
        ParameterError: The argument has something else, or another count.
    """
    values = coordinates(what, given)
    if values.shape not in {(), (directions,)}:
        raise ParameterError(
            f"{what} = {shown(given)} must be one number, or {directions}: one per direction"
        )
    return np.array(np.broadcast_to(values, (directions,)))


def vector(what: str, given: Any, size: int, unit: str = "") -> npt.NDArray[np.float64]:
    """A given number of finite numbers as an array, shape (size,).

    Raises:
        ParameterError: The values are not finite numbers, or their number is wrong.
    """
    found = floats(given, truths=False)
    values = np.empty(0) if found is None else np.atleast_1d(found)
    if values.shape != (size,) or not np.all(np.abs(values) < _LARGEST):
        raise ParameterError(
            f"{what} = {shown(given)} must be {size} finite numbers{unit and f' ({unit})'}"
        )
    return values


def coordinates(what: str, given: Any) -> npt.NDArray[np.float64]:
    """Numbers as an array of any shape; the caller checks the shape. Masked values become nan.

    Raises:
        ParameterError: The argument has something else than numbers, such as truth values.
    """
    found = floats(given, truths=False)
    if found is None:
        raise ParameterError(f"{what} = {shown(given)} must be numbers, such as (0.0, 1.0)")
    return found


def array_of(what: str, given: Any) -> npt.NDArray[Any]:
    """An argument as an array of any kind and shape; the caller checks both.

    Raises:
        ParameterError: It is none, such as rows of different lengths.
    """
    try:
        return np.asarray(given)
    except ValueError:
        raise ParameterError(
            f"{what} = {shown(given)} must be an array, with rows of one length"
        ) from None


def floats(given: Any, truths: bool = True) -> npt.NDArray[np.float64] | None:
    """Numbers as an array of any shape, or None if they are none; the caller raises.

    Masked values become nan.

    Args:
        given: The numbers.
        truths: Whether truth values count as 0 and 1, as in fields that mark points.
    """
    try:
        if isinstance(given, np.ma.MaskedArray):
            given = np.ma.filled(given.astype(np.float64), np.nan)
        # NumPy would drop imaginary parts, read words, and count days
        plain = np.asarray(given)
        none = plain.dtype.kind in ("cmMSU" if truths else "cmMSUb")
        return None if none else np.array(plain, np.float64)
    except (TypeError, ValueError, OverflowError):
        return None


def truth(what: str, value: Any, *words: str) -> bool:
    """True or False; other values are refused, such as 1 or "no".

    Args:
        what: Name of the argument.
        value: The argument.
        words: Other allowed values, for the message.

    Raises:
        ParameterError: The value is neither True nor False.
    """
    if not isinstance(value, (bool, np.bool_)):
        others = "".join(f" or {word!r}" for word in words)
        raise ParameterError(f"{what} = {shown(value)} must be True or False{others}")
    return bool(value)


def nearest(given: Any, known: Iterable[str], quote: str = "", least: float = 0.6) -> str:
    """Question at the end of a message about an unknown word, or nothing if no word is near.

    Args:
        given: The unknown word, or something else.
        known: The known words.
        quote: Mark before and after the known word.
        least: Least similarity (-).
    """
    near = difflib.get_close_matches(given, known, 1, least) if isinstance(given, str) else []
    return f"; did you mean {quote}{near[0]}{quote}?" if near else ""


def _plain(word: str) -> str:
    """A word without differences of spelling."""
    plain = word.lower().replace("_", "-").replace(" ", "-")
    for british, american in (("centre", "center"), ("isation", "ization"), ("ised", "ized")):
        plain = plain.replace(british, american)
    return plain.replace("our", "or").replace("-", "")


def choice(what: str, value: Any, known: Iterable[str]) -> str:
    """One of some words, in the spelling of `known`.

    Capitals, hyphens, and British or American spelling make no difference.

    Args:
        what: Name of the argument.
        value: The argument.
        known: The words.

    Raises:
        ParameterError: The value is another word; the message lists the first dozen words, and
            the nearest word.
    """
    words = list(known)
    if isinstance(value, str):
        for word in words:
            if _plain(word) == _plain(value):
                return word
    listed = ", ".join(f'"{word}"' for word in words[:_MOST])
    listed += ", ..." if len(words) > _MOST else ""
    hint = nearest(value, words, '"')
    raise ParameterError(f"{what} = {shown(value)} must be one of {listed}{hint}")


def as_tags(tag: Any) -> Tags:
    """Tags of points in increasing order, from one tag or several; None for all points.

    Raises:
        ParameterError: A tag is no whole number from 0, or there is no tag.
    """
    if tag is None:
        return None
    several = tag if isinstance(tag, (tuple, list)) else (tag,)
    whole = all(isinstance(t, (int, np.integer)) and not isinstance(t, bool) for t in several)
    if not (several and whole and min(several) >= 0):
        raise ParameterError(
            f"tag = {shown(tag)} must be a whole number from 0, a tuple of such, or None for all "
            "points"
        )
    return tuple(sorted({int(t) for t in several}))
