"""A broken pipe, as after `python3 case.py | head`, ends a run without messages.

PETSc takes the signal of a broken pipe for a crash, prints a page and aborts. Here Python gets the
signal back. The next output then raises `BrokenPipeError`, which ends the script, and messages
about the error are dropped. Before Python 3.13, a traceback is printed first.
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
    """Whether nobody reads from a stream."""
    try:
        poll = select.poll()
        # an error of the pipe is reported without asking for it
        poll.register(stream.fileno(), 0)
        return bool(poll.poll(0))
    except (AttributeError, OSError, ValueError):
        # the stream has no file, or is closed
        return False


def _drop_unread_output(*signal_and_frame: Any) -> None:
    """Drop further output if nobody reads the output or the messages.

    After a signal, the broken stream itself is kept: a partial write raises nothing, and the next
    write must raise. Messages about the error are dropped.
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
    """Let a broken pipe end the run with exit code 1 and without messages.

    Call it after PETSc's start, because PETSc takes the signal. Other pipes break as in Python.
    """
    # at its end the interpreter writes the remaining output, and would print an error
    atexit.register(_drop_unread_output)
    number = getattr(signal, "SIGPIPE", None)
    if number is None or threading.current_thread() is not threading.main_thread():
        return
    # Python's handler: Python ignores the signal, unless a script has set a handler
    handler = signal.getsignal(number)
    if handler is not None:
        signal.signal(number, _drop_unread_output if handler is signal.SIG_IGN else handler)
