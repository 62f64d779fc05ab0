"""The command line of a study, from the fields of a dataclass.

A study writes its options once, as names with a type, a default and a help text:

    @dataclass
    class Input(Options):
        '''A cantilever under a load at its tip.'''

        h: float = positive(0.25, "size of the cells (m)")
        poisson: float = 0.3
        steps: int = natural(50)

    args = Input.parse()

`--h 0.5 --steps 20` then sets `args.h` and `args.steps`. A type `float | None` is a number that
need not be given, `list[float]` is numbers with commas between, `bool` is a flag.
"""

from __future__ import annotations

import argparse
import types
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self, get_args, get_origin, get_type_hints

import dolfinmpm as mpm

__all__ = [
    "BASES",
    "Options",
    "command_line",
    "natural",
    "option",
    "other_default",
    "positive",
    "switch",
    "values",
]

OUTPUT = Path(__file__).resolve().parents[2] / "output"
BASES = "linear", "gimp", "bspline2", "bspline3"
# the words of an error about each bound, and what holds within the bound
BOUNDS = {
    "above": ("above", lambda value, bound: value > bound),
    "least": ("at least", lambda value, bound: value >= bound),
    "below": ("below", lambda value, bound: value < bound),
    "most": ("at most", lambda value, bound: value <= bound),
}


def option(default: Any = None, text: str | None = None, **more: Any) -> Any:
    """A field of a dataclass with a default and a help text.

    Args:
        default: Value where the command line gives none.
        text: Help text.
        more: Bounds of the value, or of each value of a list: `above`, `least`, `below`, `most`;
            `flag`, where the flag is not the name of the field; `either`, the name of a group of
            options of which a command line has one at most; `one_of`, a help text per value, where
            each value is a flag; arguments of `ArgumentParser.add_argument`.
    """
    about = {"help": text, **more}
    if isinstance(default, list):
        return field(default_factory=lambda: list(default), metadata=about)
    return field(default=default, metadata=about)


def positive(default: float | None, text: str | None = None, **more: Any) -> Any:
    """A field above zero."""
    return option(default, text, above=0, **more)


def natural(default: int | None, text: str | None = None, **more: Any) -> Any:
    """A field of one at least."""
    return option(default, text, **{"least": 1, **more})


def switch(default: str | None, text: str | None = None) -> Any:
    """A field that is "on" or "off"."""
    return option(default, text, choices=("on", "off"))


def other_default(options: type[Options], name: str, default: Any) -> Any:
    """The field of a dataclass that a study inherits from, with another default."""
    about = options.__dataclass_fields__[name].metadata
    return option(default, about["help"], **{k: v for k, v in about.items() if k != "help"})


def values(kind: type, choices: Sequence[str] = ()) -> Any:
    """Values with commas between on the command line, each of the choices if there are any."""

    def read(text: str) -> list[Any]:
        # a list of words may be empty
        found = [kind(item) for item in text.split(",") if text or kind is not str]
        for each in found:
            if choices and each not in choices:
                raise argparse.ArgumentTypeError(f"{each} is not one of {', '.join(choices)}")
        return found

    return read


@dataclass
class Options:
    """The options that every study takes."""

    json: str | None = option(
        None, "write inputs and figures there; - for the last line printed", metavar="PATH"
    )
    no_plot: bool = option(False, "no picture, no ParaView file")
    output: Path = option(OUTPUT, "folder for pictures and files")

    @classmethod
    def parse(cls, words: Sequence[str] | None = None) -> Self:
        """The options of a command line.

        Args:
            words: The command line; by default the command line of this process.

        Raises:
            SystemExit: A word is unknown, or a value is refused.
        """
        parser = command_line(cls, cls.__doc__ or "")
        given = cls(**vars(parser.parse_args(words)))
        try:
            given._check_bounds()
            given._check()
        except ValueError as error:
            parser.error(str(error))
        return given

    def fill(self, **values: Any) -> None:
        """Give options values that the command line gave none."""
        for name, value in values.items():
            if getattr(self, name) is None:
                setattr(self, name, value)

    def _check(self) -> None:
        """Fill in values that hang on other values, and refuse bad values with a ValueError."""

    def _check_bounds(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            for name, (words, holds) in BOUNDS.items():
                if value is None or name not in one.metadata:
                    continue
                bound = one.metadata[name]
                for each in value if isinstance(value, list) else [value]:
                    if not holds(each, bound):
                        flag = one.name.replace("_", "-")
                        raise ValueError(f"{flag} = {each:g} must be {words} {bound:g}")


def command_line(options: type[Options], description: str) -> argparse.ArgumentParser:
    """The parser of the options of a dataclass; stages of steps are measured from now on."""
    mpm.measure_stages()
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    hints, groups = get_type_hints(options), {"": parser}
    for one in fields(options):
        more = {name: value for name, value in one.metadata.items() if name not in BOUNDS}
        flag = more.pop("flag", "--" + one.name.replace("_", "-"))
        either = more.pop("either", "")
        if either not in groups:
            groups[either] = parser.add_mutually_exclusive_group()  # type: ignore[assignment]
        if "one_of" in more:
            for word, text in more["one_of"].items():
                parser.add_argument(
                    f"--{word}", dest=one.name, action="store_const", const=word, help=text
                )
            continue
        kind = hints[one.name]
        if isinstance(kind, types.UnionType):
            (kind,) = (k for k in get_args(kind) if k is not types.NoneType)
        if kind is bool:
            more["action"] = "store_true"
        else:
            more["default"] = (
                one.default_factory() if callable(one.default_factory) else one.default
            )
            if get_origin(kind) is list:
                (kind,) = get_args(kind)
                if "nargs" not in more:
                    kind = values(kind, more.pop("choices", ()))
            if kind is not str:
                more.setdefault("type", kind)
        groups[either].add_argument(flag, dest=one.name, **more)
    return parser
