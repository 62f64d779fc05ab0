"""Collective calls: all ranks make the same call with the same arguments.

Without a check, a call that one rank leaves out ends in a hang. A call with another argument gives
wrong numbers. Each public collective call therefore begins with a barrier. The barrier is one
reduction of two whole numbers: the name of the call, and its arguments. If ranks differ, all ranks
raise an error. If one rank does not come, the other ranks wait at the barrier, and
`dolfinmpm._platform.watchdog` reports it. A call within a call has no barrier, and a run on one
rank has none.
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
from dolfinmpm._platform.plainvalues import (
    PlainValues,
    as_text,
    difference,
    digest,
    equal_up_to_rounding,
    plain_value,
)
from dolfinmpm._platform.sharedmemory import Memory

__all__ = ["RankGroup", "check_same_call", "collective", "process", "script_line"]

Function = TypeVar("Function", bound=Callable[..., Any])

_PACKAGE = str(Path(__file__).resolve().parents[1])


class ProcessState:
    """What this process does now.

    Attributes:
        inside: Whether the process is in a collective call.
        call: Name of the last collective call.
        failed: Whether the last finished call ended in an error.
        waits_with: Ranks at whose barrier the process waits, or None.
        memory: Memory in which other processes see this state; None on one rank.
        file: File of the memory.
    """

    def __init__(self) -> None:
        self.inside = False
        self.call = ""
        self.failed = False
        self.waits_with: RankGroup | None = None
        self.memory: Memory | None = None
        self.file = ""
        self._process = os.getpid()
        if MPI.COMM_WORLD.size > 1:
            self.memory, self.file = sharedmemory.own_memory(MPI.COMM_WORLD.rank)
            atexit.register(self.end)

    def publish(self) -> None:
        """Show other processes that this process came to a call, entered it or left it."""
        if self.memory is not None:
            m = self.memory
            m["inside"], m["since"] = self.inside, time.monotonic_ns()
            m["failed"], m["ended"] = self.failed, False

    def wait_with(self, ranks: RankGroup, calls: int) -> None:
        """Begin to wait at a barrier.

        Args:
            ranks: Ranks of the barrier.
            calls: Number of the barriers of these ranks so far.
        """
        self.waits_with = ranks
        if self.memory is not None:
            m = self.memory
            m["group"], m["calls"], m["waiting"] = ranks.number, calls, True
        self.publish()

    def go_on(self) -> None:
        """Leave the barrier."""
        self.waits_with = None
        if self.memory is not None:
            self.memory["waiting"] = False

    def end(self) -> None:
        """Show other processes that the script has ended. A forked copy does nothing."""
        if self.memory is not None and os.getpid() == self._process:
            self.memory["ended"] = True
            sharedmemory.remove_all()


class RankGroup:
    """Ranks that make collective calls together.

    Args:
        comm: Communicator of the ranks.

    Attributes:
        world: Numbers of the ranks in MPI's world.
        number: Number that identifies the group.
        files: Files of the ranks on this node, by number in MPI's world.
        comm: Communicator for the barriers only.
    """

    def __init__(self, comm: MPI.Intracomm):
        whole = MPI.COMM_WORLD.Get_group()
        found = MPI.Group.Translate_ranks(comm.Get_group(), list(range(comm.size)), whole)
        self.world = [rank for rank in found if rank != MPI.UNDEFINED]
        self.number = zlib.crc32(repr(self.world).encode())
        self.files: dict[int, str] = {}
        self._calls = 0
        self._numbers = np.zeros(2, np.int64)
        process.wait_with(self, 0)
        try:
            # the copy of MPI's world serves all grids on all ranks
            all_ranks = self.world == list(range(MPI.COMM_WORLD.size))
            self.comm: MPI.Intracomm = (MPI.COMM_WORLD if all_ranks else comm).Dup()
            own = MPI.Get_processor_name(), MPI.COMM_WORLD.rank, process.file
            for node, rank, file in self.comm.allgather(own):
                if node == own[0] and file:
                    self.files[rank] = file
        finally:
            process.go_on()

    def check_same_call(self, arguments: PlainValues) -> None:
        """Wait for all ranks; raise on all ranks unless all make the same call. Collective.

        Args:
            arguments: Arguments of the call `process.call`.

        Raises:
            DifferentCallsError: Ranks make different calls.
            ParameterError: Arguments differ; the message has the values of the first two ranks
                with different values.
        """
        self._calls += 1
        numbers = self._numbers
        numbers[0] = number = zlib.crc32(process.call.encode()) << 31 ^ digest(arguments)
        numbers[1] = -number
        process.wait_with(self, self._calls)
        try:
            self.comm.Allreduce(MPI.IN_PLACE, numbers, op=MPI.MIN)
        finally:
            process.go_on()
        if numbers[0] != -numbers[1]:
            self._compare(arguments)

    def _compare(self, arguments: PlainValues) -> None:
        """Raise, unless ranks give one number in two types, such as 1 and 1.0. Collective."""
        line = script_line(sys._getframe())
        others = self.comm.allgather((process.call, line, arguments))
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
                    f"{name} differs between ranks: {as_text(a)} on rank 0, {as_text(b)} on rank "
                    f"{rank}; every rank must build the same problem and take the same steps"
                    f"{bcast if equal_up_to_rounding(a, b) else ''}"
                )


process = ProcessState()


def script_line(frame: FrameType | None) -> str:
    """Line of the user's script that led to a frame, as text."""
    while frame is not None and frame.f_code.co_filename.startswith(_libraries()):
        frame = frame.f_back
    if frame is None:
        return "an unknown line"
    return f"line {frame.f_lineno} of {Path(frame.f_code.co_filename).name}"


@functools.cache
def _libraries() -> tuple[str, ...]:
    """Folders of libraries, dolfinmpm included, as beginnings of file names."""
    import sysconfig

    names = ("stdlib", "platstdlib", "purelib", "platlib")
    found = {sysconfig.get_path(name) for name in names} | {str(Path(np.__file__).parents[1])}
    return (_PACKAGE, *(folder for folder in found if folder), "<frozen")


# -- groups of ranks ------------------------------------------------------------

_known: list[RankGroup] = []
_key: list[int] = []


def _group_of(comm: MPI.Intracomm) -> RankGroup | None:
    """Ranks of a communicator; None for one rank. The first call is collective."""
    if comm.size == 1:
        return None
    if not _key:
        _key.append(MPI.Comm.Create_keyval())
    kept: Any = comm.Get_attr(_key[0])
    if kept is None:
        kept = _find_or_make(comm)
        comm.Set_attr(_key[0], kept)
    return kept


def _find_or_make(comm: MPI.Intracomm) -> RankGroup:
    for ranks in _known:
        if MPI.Comm.Compare(comm, ranks.comm) in (MPI.IDENT, MPI.CONGRUENT):
            return ranks
    if not _known:
        end_all_ranks(MPI.COMM_WORLD)
    made = RankGroup(comm)
    _known.append(made)
    return made


def _comm_of(value: Any) -> MPI.Intracomm | None:
    """Communicator of an argument, or None."""
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


# -- the decorator --------------------------------------------------------------


@overload
def collective(function: Function) -> Function: ...
@overload
def collective(
    *,
    local: Sequence[str] = (),
    compared: Callable[..., PlainValues] | None = None,
    comm_of: Callable[..., MPI.Intracomm] | None = None,
) -> Callable[[Function], Function]: ...
def collective(
    function: Function | None = None,
    *,
    local: Sequence[str] = (),
    compared: Callable[..., PlainValues] | None = None,
    comm_of: Callable[..., MPI.Intracomm] | None = None,
) -> Any:
    """Decorator of public collective functions: `@collective`, or `@collective(local=("x",))`.

    Args:
        function: The function. Its first argument with a communicator gives the ranks.
        local: Names of arguments that differ between ranks.
        compared: Function of the arguments that returns the values to compare, by name. By default
            all arguments are compared. Only for methods of objects with a communicator.
        comm_of: Function of the arguments that returns the communicator.
    """
    if function is None:
        return functools.partial(collective, local=local, compared=compared, comm_of=comm_of)
    marked: Any = function
    if MPI.COMM_WORLD.size > 1:
        marked = _with_barrier(function, frozenset(local), compared, comm_of)
    marked.is_collective = True
    return marked


def _with_barrier(
    function: Callable, local: frozenset[str], compared: Any, comm_of: Any
) -> Callable:
    signature = inspect.signature(function)
    plain = function.__qualname__ == function.__name__

    def barrier(arguments: tuple, options: dict[str, Any]) -> None:
        try:
            # binding takes too long for a step; `compared` looks at the arguments of a step
            bound = signature.bind(*arguments, **options) if compared is None else None
            pairs = compared(*arguments, **options) if compared is not None else []
        except TypeError:
            # the call itself raises the error
            return
        if bound is None:
            comm = arguments[0].comm
        else:
            bound.apply_defaults()
            found = map(_comm_of, bound.arguments.values())
            comm = comm_of(*arguments, **options) if comm_of else _first(found)
        process.call = _name(function, None if plain else arguments[0])
        ranks = None if comm is None else _group_of(comm)
        if ranks is not None:
            ranks.check_same_call(pairs if bound is None else _pairs(bound, plain, local))

    @functools.wraps(function)
    def checked(*arguments: Any, **options: Any) -> Any:
        if process.inside:
            return function(*arguments, **options)
        barrier(arguments, options)
        process.inside, process.failed = True, False
        process.publish()
        try:
            return function(*arguments, **options)
        except BaseException:
            process.failed = True
            raise
        finally:
            process.inside = False
            process.publish()

    return checked


def _first(comms: Iterable[MPI.Intracomm | None]) -> MPI.Intracomm | None:
    return next((comm for comm in comms if comm is not None), None)


def _name(function: Callable, owner: Any) -> str:
    """Name in messages: `fill`, `Space`, `QuasiStatic.step`."""
    if owner is None:
        return function.__name__
    kind = owner.__name__ if isinstance(owner, type) else type(owner).__name__
    return kind if function.__name__ == "__init__" else f"{kind}.{function.__name__}"


def _pairs(bound: inspect.BoundArguments, plain: bool, local: frozenset[str]) -> PlainValues:
    """Arguments by name; each argument of `**options` has its own name."""
    named: dict[str, Any] = dict(list(bound.arguments.items())[0 if plain else 1 :])
    for name, parameter in bound.signature.parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            named |= named.pop(name, {})
    return [(name, plain_value(value)) for name, value in named.items() if name not in local]


def check_same_call(comm: MPI.Intracomm, call: str, **arguments: Any) -> None:
    """Barrier of a call that is collective in some of its uses only. Collective.

    Args:
        comm: Communicator of the ranks.
        call: Name of the call.
        arguments: Arguments of the call, by name.
    """
    if MPI.COMM_WORLD.size == 1 or process.inside:
        return
    process.call = call
    ranks = _group_of(comm)
    if ranks is not None:
        ranks.check_same_call([(name, plain_value(value)) for name, value in arguments.items()])
