"""Calls that all ranks make together: they meet at the door, and compare what they were given.

Without this a call that one rank leaves out, or makes with another argument, ends in a hang or in
wrong numbers. Each public call that is collective therefore begins with one reduction of two whole
numbers: which call it is, and what it was given. Where ranks differ all of them raise. Where one
does not come the others wait at the door, and `dolfinmpm._platform.watchdog` tells so.
Calls within a call have no door, and on one rank there is none at all.
"""

from __future__ import annotations

import atexit
import functools
import inspect
import os
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar, overload

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform import sharedmemory
from dolfinmpm._platform.abort import end_all_ranks
from dolfinmpm._platform.errors import DifferentCallsError, ParameterError
from dolfinmpm._platform.plainvalues import Told, difference, digest, in_words, nearly, told
from dolfinmpm._platform.sharedmemory import Memory

__all__ = ["Ranks", "here", "line_of", "meet", "together"]

Function = TypeVar("Function", bound=Callable[..., Any])

_PACKAGE = str(Path(__file__).resolve().parents[1])


class Here:
    """What this process does now.

    Attributes:
        inside: Whether it is in one of these calls.
        call: Name of the last one that it came to.
        failed: Whether the last one that it left ended in an error.
        door: Ranks at whose door it stands, or None.
        memory: Where others see this; None if there are none.
        file: Its file.
    """

    def __init__(self) -> None:
        self.inside = False
        self.call = ""
        self.failed = False
        self.door: Ranks | None = None
        self.memory: Memory | None = None
        self.file = ""
        self._process = os.getpid()
        if MPI.COMM_WORLD.size > 1:
            self.memory, self.file = sharedmemory.own_memory(MPI.COMM_WORLD.rank)
            atexit.register(self.end)

    def write(self) -> None:
        """Tell others that it came to a call, entered or left one."""
        if self.memory is not None:
            m = self.memory
            m["inside"], m["since"] = self.inside, time.monotonic_ns()
            m["failed"], m["ended"] = self.failed, False

    def come(self, ranks: Ranks, doors: int) -> None:
        """Come to a door."""
        self.door = ranks
        if self.memory is not None:
            m = self.memory
            m["group"], m["doors"], m["at_door"] = ranks.number, doors, True
        self.write()

    def enter(self) -> None:
        """Go through the door, for all are here."""
        self.door = None
        if self.memory is not None:
            self.memory["at_door"] = False

    def end(self) -> None:
        """Tell others that the script has come to its end; not that of a copy of the process."""
        if self.memory is not None and os.getpid() == self._process:
            self.memory["ended"] = True
            sharedmemory.remove_all()


class Ranks:
    """Ranks that make collective calls together.

    Args:
        comm: Their communicator.

    Attributes:
        world: Their numbers among all ranks.
        number: What tells them from other ranks.
        files: Files of the slots of those of this node, by their numbers among all.
        comm: A communicator for their meetings alone.
    """

    def __init__(self, comm: MPI.Intracomm):
        whole = MPI.COMM_WORLD.Get_group()
        found = MPI.Group.Translate_ranks(comm.Get_group(), list(range(comm.size)), whole)
        self.world = [rank for rank in found if rank != MPI.UNDEFINED]
        self.number = zlib.crc32(repr(self.world).encode())
        self.files: dict[int, str] = {}
        self._doors = 0
        self._numbers = np.zeros(2, np.int64)
        here.come(self, 0)
        try:
            # that of the world serves all grids on all ranks
            all_ranks = self.world == list(range(MPI.COMM_WORLD.size))
            self.comm: MPI.Intracomm = (MPI.COMM_WORLD if all_ranks else comm).Dup()
            own = MPI.Get_processor_name(), MPI.COMM_WORLD.rank, here.file
            for node, rank, file in self.comm.allgather(own):
                if node == own[0] and file:
                    self.files[rank] = file
        finally:
            here.enter()

    def meet(self, given: Told) -> None:
        """Wait for all ranks, and raise on all of them unless they make the same call. Collective.

        Args:
            given: What `here.call` was given.

        Raises:
            DifferentCallsError: Ranks make other calls.
            ParameterError: Arguments differ; the message has the values of the first two ranks
                that do.
        """
        self._doors += 1
        numbers = self._numbers
        numbers[0] = number = zlib.crc32(here.call.encode()) << 31 ^ digest(given)
        numbers[1] = -number
        here.come(self, self._doors)
        try:
            self.comm.Allreduce(MPI.IN_PLACE, numbers, op=MPI.MIN)
        finally:
            here.enter()
        if numbers[0] != -numbers[1]:
            self._compare(given)

    def _compare(self, given: Told) -> None:
        """Raise unless a number is given in two ways, such as 1 and 1.0. Collective."""
        others = self.comm.allgather((here.call, line_of(sys._getframe()), given))
        first = others[0]
        for rank, other in enumerate(others):
            if other[0] != first[0]:
                raise DifferentCallsError(
                    f"the ranks make different calls: {first[0]} at {first[1]} on rank 0, "
                    f"{other[0]} at {other[1]} on rank {rank}; every rank must make the same calls "
                    "in the same order"
                )
        for rank, other in enumerate(others):
            found = difference(first[2], other[2])
            if found is not None:
                name, a, b = found
                bcast = "; a number that ranks compute goes from one to all by bcast"
                raise ParameterError(
                    f"{name} differs between ranks: {in_words(a)} on rank 0, {in_words(b)} on rank "
                    f"{rank}; every rank must build the same problem and take the same steps"
                    f"{bcast if nearly(a, b) else ''}"
                )


here = Here()


def line_of(frame: FrameType | None) -> str:
    """The line of the user's script that a frame belongs to, in words."""
    while frame is not None and frame.f_code.co_filename.startswith(_libraries()):
        frame = frame.f_back
    if frame is None:
        return "an unknown line"
    return f"line {frame.f_lineno} of {Path(frame.f_code.co_filename).name}"


@functools.cache
def _libraries() -> tuple[str, ...]:
    """How the files of libraries begin, dolfinmpm's among them."""
    import sysconfig

    names = ("stdlib", "platstdlib", "purelib", "platlib")
    found = {sysconfig.get_path(name) for name in names} | {str(Path(np.__file__).parents[1])}
    return (_PACKAGE, *(folder for folder in found if folder), "<frozen")


# -- which ranks ----------------------------------------------------------------

_known: list[Ranks] = []
_key: list[int] = []


def ranks_of(comm: MPI.Intracomm) -> Ranks | None:
    """The ranks of a communicator, or None for one rank. Collective when first asked."""
    if comm.size == 1:
        return None
    if not _key:
        _key.append(MPI.Comm.Create_keyval())
    kept: Any = comm.Get_attr(_key[0])
    if kept is None:
        kept = _found_or_made(comm)
        comm.Set_attr(_key[0], kept)
    return kept


def _found_or_made(comm: MPI.Intracomm) -> Ranks:
    for ranks in _known:
        if MPI.Comm.Compare(comm, ranks.comm) in (MPI.IDENT, MPI.CONGRUENT):
            return ranks
    if not _known:
        end_all_ranks(MPI.COMM_WORLD)
    made = Ranks(comm)
    _known.append(made)
    return made


def _comm_of(value: Any) -> MPI.Intracomm | None:
    """The communicator of an argument, or None if it has none."""
    for _ in range(4):
        if isinstance(value, MPI.Intracomm):
            return value
        if hasattr(value, "tompi4py"):
            return value.tompi4py()
        for name in ("comm", "grid", "points", "surface"):
            inner = getattr(value, name, None)
            if inner is not None:
                value = inner
                break
        else:
            return None
    return None


# -- the calls ------------------------------------------------------------------


@overload
def together(function: Function) -> Function: ...
@overload
def together(
    *,
    own: Sequence[str] = (),
    given: Callable[..., Told] | None = None,
    of: Callable[..., MPI.Intracomm] | None = None,
) -> Callable[[Function], Function]: ...
def together(
    function: Function | None = None,
    *,
    own: Sequence[str] = (),
    given: Callable[..., Told] | None = None,
    of: Callable[..., MPI.Intracomm] | None = None,
) -> Any:
    """Mark a public function that is collective: `@together`, or `@together(own=("x",))`.

    Args:
        function: The function. The first of its arguments that has a communicator tells which
            ranks meet.
        own: Names of arguments of which each rank has its own.
        given: Tells from the arguments what ranks compare, by name; by default all of them. Of
            methods of what has a communicator.
        of: Tells from the arguments which ranks meet.
    """
    if function is None:
        return functools.partial(together, own=own, given=given, of=of)
    marked: Any = function
    if MPI.COMM_WORLD.size > 1:
        marked = _with_door(function, frozenset(own), given, of)
    marked.is_collective = True
    return marked


def _with_door(function: Callable, own: frozenset[str], given: Any, of: Any) -> Callable:
    signature = inspect.signature(function)
    plain = function.__qualname__ == function.__name__

    def meeting(arguments: tuple, options: dict[str, Any]) -> None:
        try:
            # for a step this would take too long, and what it is given is looked at below
            bound = signature.bind(*arguments, **options) if given is None else None
            pairs = given(*arguments, **options) if given is not None else []
        except TypeError:
            # the call itself says what is wrong with it
            return
        if bound is None:
            comm = arguments[0].comm
        else:
            bound.apply_defaults()
            comm = of(*arguments, **options) if of else _first_comm(bound.arguments.values())
        here.call = _name(function, None if plain else arguments[0])
        ranks = None if comm is None else ranks_of(comm)
        if ranks is not None:
            ranks.meet(pairs if bound is None else _pairs(bound, plain, own))

    @functools.wraps(function)
    def within(*arguments: Any, **options: Any) -> Any:
        if here.inside:
            return function(*arguments, **options)
        meeting(arguments, options)
        here.inside, here.failed = True, False
        here.write()
        try:
            return function(*arguments, **options)
        except BaseException:
            here.failed = True
            raise
        finally:
            here.inside = False
            here.write()

    return within


def _first_comm(values: Iterable[Any]) -> MPI.Intracomm | None:
    return next((comm for comm in map(_comm_of, values) if comm is not None), None)


def _name(function: Callable, owner: Any) -> str:
    """What messages call it: `fill`, `Space`, `QuasiStatic.step`."""
    if owner is None:
        return function.__name__
    kind = owner.__name__ if isinstance(owner, type) else type(owner).__name__
    return kind if function.__name__ == "__init__" else f"{kind}.{function.__name__}"


def _pairs(bound: inspect.BoundArguments, plain: bool, own: frozenset[str]) -> Told:
    """Arguments by name, those of `**options` by their own."""
    named: dict[str, Any] = dict(list(bound.arguments.items())[0 if plain else 1 :])
    for name, parameter in bound.signature.parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            named |= named.pop(name, {})
    return [(name, told(value)) for name, value in named.items() if name not in own]


def meet(comm: MPI.Intracomm, call: str, **given: Any) -> None:
    """The door of a call that is collective in some of its uses only. Collective.

    Args:
        comm: Whose ranks meet.
        call: Name of the call.
        given: What it is given, by name.
    """
    if MPI.COMM_WORLD.size == 1 or here.inside:
        return
    here.call = call
    ranks = ranks_of(comm)
    if ranks is not None:
        ranks.meet([(name, told(value)) for name, value in given.items()])
