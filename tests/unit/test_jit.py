"""Marks that interrupted compilations leave behind do not stop later runs."""

from __future__ import annotations

import os
import time

import pytest
from conftest import COMM

from dolfinmpm._platform import jit


def timed_out(mark):
    # as FFCx words it
    return TimeoutError(
        "JIT compilation timed out, probably due to a failed previous compile. "
        f"Try cleaning cache (e.g. remove {mark}) or increase timeout option."
    )


def test_abandoned_mark_is_removed(tmp_path):
    mark = tmp_path / "libffcx_forms_0.c"
    mark.touch()
    os.utime(mark, (time.time() - 2 * jit.ABANDONED,) * 2)

    def build():
        if mark.exists():
            raise timed_out(mark)
        return 7

    assert jit.patiently(COMM, build) == 7


def test_mark_of_another_process_is_waited_for(tmp_path):
    mark = tmp_path / "libffcx_forms_0.c"
    mark.touch()
    calls = []

    def build():
        calls.append(mark.exists())
        if len(calls) < 3:
            raise timed_out(mark)
        return 7

    assert jit.patiently(COMM, build) == 7
    assert calls == [True, True, True]


def test_waiting_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(jit, "LONGEST", 0.0)

    def build():
        raise timed_out(tmp_path / "libffcx_forms_0.c")

    with pytest.raises(TimeoutError, match="timed out"):
        jit.patiently(COMM, build)


def test_other_errors_pass():
    def build():
        raise RuntimeError("no such element")

    with pytest.raises(RuntimeError, match="no such element"):
        jit.patiently(COMM, build)
