"""Output that nobody reads any more, as in `python3 case.py | head`, ends a run without words.

PETSc takes the signal of a broken pipe for a crash, prints a page and aborts. Here Python has the
signal again: what is printed then raises `BrokenPipeError`, which ends the script, and what is
said of it goes where the output went. (Before Python 3.13 its traceback comes first.)
"""

from __future__ import annotations

import atexit
import contextlib
import os
import select
import signal
import sys
import threading
from typing import Any

__all__ = ["end_quietly"]


def _is_broken(stream: Any) -> bool:
    """Whether what is written to a stream reaches nobody."""
    try:
        poll = select.poll()
        # that nobody reads is told whether asked or not
        poll.register(stream.fileno(), 0)
        return bool(poll.poll(0))
    except (AttributeError, OSError, ValueError):
        # not of a file, or closed
        return False


def _drop_what_nobody_reads(*signal_and_frame: Any) -> None:
    """Drop what is written from now on if the output, or messages, reach nobody any more.

    On a signal the stream that broke stays as it is: the write that broke may have been one in
    part, which raises nothing, and the next one must. What is said of it is dropped.
    """
    streams = sys.stdout, sys.stderr
    if not any(_is_broken(stream) for stream in streams):
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in streams:
        if bool(signal_and_frame) != _is_broken(stream):
            with contextlib.suppress(AttributeError, OSError, ValueError):
                os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def end_quietly() -> None:
    """Let a run whose output nobody reads end with exit code 1 and without words.

    To be called after PETSc's start, which takes the signal. Other pipes break as Python has it.
    """
    # the interpreter writes what is left at its end, and would complain
    atexit.register(_drop_what_nobody_reads)
    number = getattr(signal, "SIGPIPE", None)
    if number is None or threading.current_thread() is not threading.main_thread():
        return
    # what Python believes is the handler: its own way to ignore the signal, unless a script has
    # set another one
    handler = signal.getsignal(number)
    if handler is not None:
        signal.signal(number, _drop_what_nobody_reads if handler is signal.SIG_IGN else handler)
