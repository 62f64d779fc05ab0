"""Work of a piece of Python, measured independently of the load of the machine.

Times on a shared machine do not show a per mille. The number of processor instructions hardly
varies: `count` starts a script again under valgrind, and `Counter` counts the instructions between
two places of it. Without valgrind or a C compiler, Python-level calls and processor time are
measured.
"""

from __future__ import annotations

import cProfile
import ctypes
import gc
import json
import os
import pstats
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

REQUESTS = """
#include <valgrind/callgrind.h>
void begin(void) { CALLGRIND_ZERO_STATS; CALLGRIND_START_INSTRUMENTATION; }
void end(const char *where) { CALLGRIND_STOP_INSTRUMENTATION; CALLGRIND_DUMP_STATS_AT(where); }
"""
# where a counted script finds the library of requests and the folder of valgrind's files
FOLDER = "INSTRUCTIONS_FOLDER"


def can_count() -> bool:
    """Whether valgrind and a C compiler are there."""
    return bool(shutil.which("valgrind") and shutil.which("cc"))


def count(script: str | Path, *arguments: str, alone: bool = False) -> dict[str, Any]:
    """Run a script whose last line is JSON, and count what it asks for; returns the JSON.

    The script runs twice where instructions are counted: first alone, to compile all that it
    needs, since compiling takes valgrind minutes.

    Args:
        script, arguments: What to run.
        alone: Whether it is to run without valgrind in any case.
    """
    with tempfile.TemporaryDirectory() as folder:
        # valgrind's processor is none that exists; what is compiled for both must be the same
        # processor's, or it is compiled again
        own = {
            **os.environ, "OMP_NUM_THREADS": "1", "NUMBA_CPU_NAME": "haswell",
            "NUMBA_CPU_FEATURES": "", "PYTHONHASHSEED": "0",
        }  # fmt: skip
        command = [sys.executable, str(script), *arguments]
        first = _run(command, own)
        if alone or not can_count():
            return first
        source = Path(folder, "requests.c")
        source.write_text(REQUESTS)
        made = subprocess.run(
            ["cc", "-shared", "-fPIC", "-O1", "-o", Path(folder, "requests.so"), source],
            capture_output=True,
        )
        if made.returncode:
            return first
        valgrind = [
            "valgrind", "--tool=callgrind", "--instr-atstart=no", "--quiet",
            f"--callgrind-out-file={folder}/out", *command,
        ]  # fmt: skip
        return _run(valgrind, {**own, FOLDER: folder})


def _run(command: list[str], environment: dict[str, str]) -> dict[str, Any]:
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


class Counter:
    """Counts what functions take; see `count`.

    Attributes:
        unit: What it counts: "instructions", or "calls" of Python functions.
    """

    def __init__(self) -> None:
        self._folder = os.environ.get(FOLDER)
        self._files = 0
        self.unit = "instructions" if self._folder else "calls"
        if self._folder:
            self._library = ctypes.CDLL(f"{self._folder}/requests.so")

    def __call__(self, act: Callable[[], Any]) -> tuple[int, float]:
        """What a function takes: instructions or calls, and processor time (s)."""
        gc.collect()
        gc.disable()
        started = time.process_time()
        try:
            if self._folder is None:
                profile = cProfile.Profile()
                profile.runcall(act)
                found = int(pstats.Stats(profile).total_calls)
            else:
                self._library.begin()
                act()
                self._library.end(b"counted")
                self._files += 1
                text = Path(self._folder, f"out.{self._files}").read_text()
                found = int(text.rpartition("totals:")[2].split()[0])
        finally:
            gc.enable()
        return found, time.process_time() - started
