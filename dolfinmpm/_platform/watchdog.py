"""The watchdog: a rank that waits in vain prints a message, and later ends the run.

Collective calls begin with a barrier, see `dolfinmpm._platform.collective`. A rank that waits there
for some seconds prints its call and the lines of the other ranks, once. After `DOLFINMPM_WAIT`
seconds (600 by default, 0 for never) the rank ends all ranks. Time does not count while the other
ranks compute in a call. It counts if the other rank is outside of calls, if its script has ended,
or if it hangs in a call that the waiting rank has left by an error.

On several ranks, a thread reads the shared memory twice per second. Its only call of MPI is the
call that ends the run.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections.abc import Sequence

from mpi4py import MPI

from dolfinmpm._platform.collective import RankGroup, process, script_line
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.sharedmemory import Memory, Slot, answer, ask, find, read, remove_all

__all__ = ["Patience", "message", "watch"]

# Seconds between two checks, before the message, and for the answers of other ranks
_PERIOD = 0.5
_FIRST = 10.0
_ANSWER = 0.8
# Seconds after which an ended script makes no further call, such as a call at exit
_ENDED = 1.0
_LIMIT = 600.0


class Patience:
    """How long a rank has waited in vain, and what follows.

    Args:
        limit: Seconds after which all ranks are ended; 0 for never.

    Attributes:
        limit: The argument.
        first: Seconds after which the rank prints a message.
        waited: Seconds for which the same ranks have been missing and idle.
        missing: States of the missing ranks.
    """

    def __init__(self, limit: float):
        self.limit = limit
        self.first = min(_FIRST, limit / 2) if limit else _FIRST
        self.waited = 0.0
        self.missing: list[Slot] = []
        self._key: object = None
        self._told = False

    def look(self, slots: Sequence[Slot], me: Slot, passed: float) -> str:
        """What to do now: "" for nothing, "tell" to print a message, or "end" to end the run.

        Args:
            slots: States of all ranks.
            me: State of this rank.
            passed: Seconds since the last call, without the seconds of a suspended run.
        """
        self.missing = [s for s in slots if not _waits_with(s, me)]
        ended = any(s.ended for s in self.missing)
        busy = any(s.inside and not s.ended and not _left(s, me) for s in self.missing)
        if not me.waiting or not self.missing or (busy and not ended):
            self.begin()
            return ""
        key = (me.calls, *((s.rank, s.since) for s in self.missing))
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
        """Start the count again; without a key no rank waits."""
        if self._told:
            # waiting was right: the other ranks need longer
            self.first = max(self.first, 2.0 * self.waited)
        self._key, self._told, self.waited = key, False, 0.0


def _waits_with(other: Slot, me: Slot) -> bool:
    """Whether a rank waits at the same barrier."""
    return other.waiting and (other.group, other.calls) == (me.group, me.calls)


def _left(other: Slot, me: Slot) -> bool:
    """Whether a rank is in a call that this rank has left by an error."""
    return me.failed and other.group == me.group and other.calls < me.calls


def watch(comm: MPI.Intracomm) -> None:
    """Start the watchdog's thread on several ranks.

    Args:
        comm: Communicator whose ranks the watchdog ends.

    Raises:
        ParameterError: `DOLFINMPM_WAIT` is no number of seconds.
    """
    if comm.size > 1:
        watchdog = _Watchdog(comm, Patience(_limit()))
        threading.Thread(target=watchdog.run, name="dolfinmpm watchdog", daemon=True).start()


def _limit() -> float:
    text = os.environ.get("DOLFINMPM_WAIT", "")
    try:
        limit = float(text) if text else _LIMIT
    except ValueError:
        limit = -1.0
    if not 0.0 <= limit < math.inf:
        raise ParameterError(
            f"DOLFINMPM_WAIT = {text!r} must be a number of seconds of at least 0. A rank that "
            "waits so long in vain ends all ranks; 0 is never"
        )
    return limit


class _Watchdog:
    """The thread that reads the states of the ranks."""

    def __init__(self, comm: MPI.Intracomm, patience: Patience):
        self._comm, self._patience = comm, patience
        self._rank = comm.rank
        # slots of processes of this node, by rank
        self._memory: dict[int, Memory] = {}
        # whether a thread may call MPI while another one waits in it
        self._aborts = MPI.Query_thread() == MPI.THREAD_MULTIPLE

    def run(self) -> None:
        """Check twice per second, until the process ends."""
        last = time.monotonic()
        while True:
            time.sleep(_PERIOD)
            memory = process.memory
            if memory is not None and memory["asked"]:
                answer(memory, _own_line())
            now = time.monotonic()
            self._look(min(now - last, 2 * _PERIOD))
            last = now

    def _look(self, passed: float) -> None:
        ranks, patience = process.waits_with, self._patience
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
        if process.waits_with is not ranks or _times(before) != _times(patience.missing):
            return
        ends = verdict == "end"
        text = message(waiting, patience, f"{process.call}, {_own_line()}", ends)
        print(text, file=sys.stderr, flush=True)
        if ends:
            self._end()

    def _end(self) -> None:
        sys.stdout.flush()
        remove_all(running=True)
        if self._aborts:
            self._comm.Abort(1)
        os._exit(1)

    def _slots(self, ranks: RankGroup) -> tuple[list[Slot], Slot]:
        """States of the ranks of this node, and the state of this rank."""
        for rank in ranks.world:
            if self._memory.get(rank) is None:
                file = ranks.files.get(rank, "")
                found = process.memory if rank == self._rank else find(rank, file)
                if found is not None:
                    self._memory[rank] = found
        slots = [read(self._memory[r], r) for r in ranks.world if r in self._memory]
        return slots, next(s for s in slots if s.rank == self._rank)


def _times(slots: Sequence[Slot]) -> list[tuple[int, int]]:
    return [(s.rank, s.since) for s in slots]


def _own_line() -> str:
    """Line of the script that the main thread executes."""
    return script_line(sys._current_frames().get(threading.main_thread().ident or 0))


def message(waiting: Sequence[int], patience: Patience, where: str, ends: bool) -> str:
    """The watchdog's message.

    Args:
        waiting: Waiting ranks.
        patience: Missing ranks, and the time of waiting.
        where: Call of the waiting ranks, and its line in the script.
        ends: Whether all ranks are ended now.
    """
    many = len(waiting) > 1
    names = ", ".join(map(str, waiting))
    text = (
        f"dolfinmpm: rank{'s' * many} {names} {'have' if many else 'has'} waited for "
        f"{patience.waited:.0f} s in {where}. "
    )
    for slot in patience.missing:
        text += _sentence_about(slot, f"rank{'s' * many} {names}")
    text += "Every rank must make this call: do not put it under a condition on the rank. "
    limit = f"DOLFINMPM_WAIT = {patience.limit:g}"
    if ends:
        return text + f"All ranks are ended ({limit})."
    return text + (
        f"All ranks are ended after {patience.limit:g} s ({limit}; 0 is never)."
        if patience.limit
        else f"They wait for ever ({limit})."
    )


def _sentence_about(slot: Slot, waiting: str) -> str:
    if slot.ended:
        return f"Rank {slot.rank} has come to the end of its script. "
    at = f" at {slot.text}" if slot.text else ""
    if slot.inside:
        return f"Rank {slot.rank} is{at} in a call that {waiting} left by an error. "
    where = "a call with other ranks" if slot.waiting else "no call of dolfinmpm"
    return f"Rank {slot.rank} is{at} in {where}. "
