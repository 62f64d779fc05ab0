"""`python3 case.py | head` ends without words."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

LINES = """
import dolfinmpm as mpm
for k in range(100_000):
    print("line", k)
"""
FEW = """
import sys
import dolfinmpm as mpm
sys.stdin.readline()
print("a line that waits for the end")
"""
OTHER = """
import os
import dolfinmpm as mpm
ours, theirs = os.pipe()
os.close(ours)
os.write(theirs, b"x")
"""


def run(code, *options):
    return subprocess.Popen(
        [sys.executable, *options, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": ""},
    )  # fmt: skip


@pytest.mark.parametrize("options", [(), ("-u",)])
def test_a_reader_that_leaves_ends_the_run_without_words(options):
    with run(LINES, *options) as done:
        assert done.stdout.readline() == "line 0\n"
        done.stdout.close()
        assert done.stderr.read() == ""
    assert done.returncode == 1


def test_what_is_left_at_the_end_is_dropped_without_words():
    with run(FEW) as done:
        done.stdout.close()
        done.stdin.write("go on\n")
        done.stdin.close()
        assert done.stderr.read() == ""
    assert done.returncode == 0


def test_other_pipes_that_break_are_told():
    with run(OTHER) as done:
        text = done.stderr.read()
    assert text.rstrip().endswith("BrokenPipeError: [Errno 32] Broken pipe")
    assert "PETSC" not in text
    assert done.returncode == 1
