"""A rank that waits for ever says so, and ends the run.

Collective calls begin at a door where ranks wait for each other, see
`dolfinmpm._platform.collective`. Who waits there longer than some seconds tells once which call it
is in and where the others are; after `DOLFINMPM_WAIT` seconds (600 by default, 0 for never) it
ends all ranks. Ranks that compute are waited for as long as they need: only those count that are
outside of any call, have come to the end of their script, or hang in a call that the waiting rank
has left by an error.

A thread looks at plain memory twice per second, on more than one rank alone. It makes no calls of
MPI but the one that ends the run.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections.abc import Sequence

from mpi4py import MPI

from dolfinmpm._platform.collective import Ranks, here, line_of
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.sharedmemory import Memory, Slot, answer, ask, find, read, remove_all

__all__ = ["Patience", "in_words", "watch"]

# Seconds between two looks, before a rank is told to wait, and for others to say where they are
_PERIOD = 0.5
_FIRST = 10.0
_ANSWER = 0.8
# Seconds after which one that has ended is no longer about to begin a call, as at the exit
_ENDED = 1.0
_LIMIT = 600.0


class Patience:
    """How long a rank has waited in vain, and what it does about it.

    Args:
        limit: Seconds after which all ranks are ended; 0 for never.

    Attributes:
        limit: The argument.
        first: Seconds after which it is told.
        waited: Seconds for which the same ranks have been missing, and idle.
        missing: Those that are missing.
    """

    def __init__(self, limit: float):
        self.limit = limit
        self.first = min(_FIRST, limit / 2) if limit else _FIRST
        self.waited = 0.0
        self.missing: list[Slot] = []
        self._key: object = None
        self._told = False

    def look(self, slots: Sequence[Slot], me: Slot, passed: float) -> str:
        """What is to be done: "" for nothing, "tell" or "end".

        Args:
            slots: What all ranks do.
            me: What this one does.
            passed: Seconds since the last look; those of a run that was stopped do not count.
        """
        self.missing = [s for s in slots if not _waits_with(s, me)]
        ended = any(s.ended for s in self.missing)
        busy = any(s.inside and not s.ended and not _left(s, me) for s in self.missing)
        if not me.at_door or not self.missing or (busy and not ended):
            self.begin()
            return ""
        key = (me.doors, *((s.rank, s.since) for s in self.missing))
        if key != self._key:
            self.begin(key)
        self.waited += passed
        if self.limit and self.waited >= (_ENDED if ended else self.limit):
            return "end"
        if self._told or self.waited < (_ENDED if ended else self.first):
            return ""
        self._told = True
        return "tell"

    def begin(self, key: object = None) -> None:
        """Count from now on; without a key nobody waits."""
        if self._told:
            # it was right to wait: those others need longer
            self.first = max(self.first, 2.0 * self.waited)
        self._key, self._told, self.waited = key, False, 0.0


def _waits_with(other: Slot, me: Slot) -> bool:
    """Whether a rank waits at the same door."""
    return other.at_door and (other.group, other.doors) == (me.group, me.doors)


def _left(other: Slot, me: Slot) -> bool:
    """Whether a rank is in a call that this one has left by an error."""
    return me.failed and other.group == me.group and other.doors < me.doors


def watch(comm: MPI.Intracomm) -> None:
    """Begin to watch; nothing to do on one rank.

    Args:
        comm: Communicator whose ranks are ended.

    Raises:
        ParameterError: `DOLFINMPM_WAIT` is no number of seconds.
    """
    if comm.size > 1:
        one = _Watch(comm, Patience(_limit()))
        threading.Thread(target=one.run, name="dolfinmpm watchdog", daemon=True).start()


def _limit() -> float:
    text = os.environ.get("DOLFINMPM_WAIT", "")
    try:
        limit = float(text) if text else _LIMIT
    except ValueError:
        limit = -1.0
    if not 0.0 <= limit < math.inf:
        raise ParameterError(
            f"DOLFINMPM_WAIT = {text!r} must be a number of seconds, after which a rank that waits "
            "in vain ends all ranks; 0 is never"
        )
    return limit


class _Watch:
    """The thread that looks."""

    def __init__(self, comm: MPI.Intracomm, patience: Patience):
        self._comm, self._patience = comm, patience
        self._rank = comm.rank
        # slots of processes of this node, by rank
        self._memory: dict[int, Memory] = {}
        # whether a thread may call MPI while another one waits in it
        self._aborts = MPI.Query_thread() == MPI.THREAD_MULTIPLE

    def run(self) -> None:
        """Look twice per second, until the process ends."""
        last = time.monotonic()
        while True:
            time.sleep(_PERIOD)
            memory = here.memory
            if memory is not None and memory["asked"]:
                answer(memory, _place())
            now = time.monotonic()
            self._look(min(now - last, 2 * _PERIOD))
            last = now

    def _look(self, passed: float) -> None:
        ranks, patience = here.door, self._patience
        if ranks is None:
            patience.begin()
            return
        slots, me = self._slots(ranks)
        verdict = patience.look(slots, me, passed)
        waiting = [s.rank for s in slots if _waits_with(s, me)]
        if not verdict or me.rank != min(waiting):
            return
        for slot in patience.missing:
            ask(self._memory[slot.rank])
        time.sleep(_ANSWER)
        before, (slots, me) = patience.missing, self._slots(ranks)
        patience.look(slots, me, 0.0)
        if here.door is not ranks or _times(before) != _times(patience.missing):
            return
        ends = verdict == "end"
        text = in_words(waiting, patience, f"{here.call}, {_place()}", ends)
        print(text, file=sys.stderr, flush=True)
        if ends:
            self._end()

    def _end(self) -> None:
        sys.stdout.flush()
        remove_all(even=True)
        if self._aborts:
            self._comm.Abort(1)
        os._exit(1)

    def _slots(self, ranks: Ranks) -> tuple[list[Slot], Slot]:
        """What those of the ranks do that are known here, and this one."""
        for rank in ranks.world:
            if self._memory.get(rank) is None:
                found = here.memory if rank == self._rank else find(rank, ranks.files.get(rank, ""))
                if found is not None:
                    self._memory[rank] = found
        slots = [read(self._memory[r], r) for r in ranks.world if r in self._memory]
        return slots, next(s for s in slots if s.rank == self._rank)


def _times(slots: Sequence[Slot]) -> list[tuple[int, int]]:
    return [(s.rank, s.since) for s in slots]


def _place() -> str:
    """The line of the script that the main thread is at."""
    return line_of(sys._current_frames().get(threading.main_thread().ident or 0))


def in_words(waiting: Sequence[int], patience: Patience, where: str, ends: bool) -> str:
    """What is told.

    Args:
        waiting: Ranks that wait.
        patience: Whom they wait for, and for how long.
        where: The call that they wait in, and its line.
        ends: Whether all ranks are ended now.
    """
    many = len(waiting) > 1
    names = ", ".join(map(str, waiting))
    text = (
        f"dolfinmpm: rank{'s' * many} {names} {'have' if many else 'has'} waited for "
        f"{patience.waited:.0f} s in {where}. "
    )
    for slot in patience.missing:
        text += _in_words(slot, f"rank{'s' * many} {names}")
    text += "Every rank must make this call: do not put it under a condition on the rank. "
    limit = f"DOLFINMPM_WAIT = {patience.limit:g}"
    if ends:
        return text + f"All ranks are ended ({limit})."
    return text + (
        f"All ranks are ended after {patience.limit:g} s ({limit}; 0 is never)."
        if patience.limit
        else f"They wait for ever ({limit})."
    )


def _in_words(slot: Slot, waiting: str) -> str:
    if slot.ended:
        return f"Rank {slot.rank} has come to the end of its script. "
    at = f" at {slot.text}" if slot.text else ""
    if slot.inside:
        return f"Rank {slot.rank} is{at} in a call that {waiting} left by an error. "
    where = "a call with other ranks" if slot.at_door else "no call of dolfinmpm"
    return f"Rank {slot.rank} is{at} in {where}. "
