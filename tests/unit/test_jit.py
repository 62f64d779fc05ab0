"""Marks that interrupted compilations leave behind do not stop later runs."""

from __future__ import annotations

import fcntl
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


def old_mark(folder):
    mark = folder / "libffcx_forms_0.c"
    mark.touch()
    os.utime(mark, (time.time() - 2 * jit.ABANDONED,) * 2)
    return mark


@pytest.mark.parametrize(("earlier", "kept"), [(1.0, True), (-1.0, False)])
def test_mark_of_a_compiler_at_work_stays(tmp_path, earlier, kept):
    """Who holds a lock since before the mark may have made it, who came later did not."""
    mark = old_mark(tmp_path)
    path = tmp_path / "dolfinmpm-host-1.lock"
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        os.utime(path, (mark.stat().st_mtime - earlier,) * 2)
        jit._remove_if_abandoned(mark)
        assert mark.exists() == kept
        assert path.exists()


def test_lock_of_a_killed_process_counts_no_more(tmp_path):
    mark = old_mark(tmp_path)
    path = tmp_path / "dolfinmpm-host-1.lock"
    path.touch()
    os.utime(path, (mark.stat().st_mtime - 1.0,) * 2)
    jit._remove_if_abandoned(mark)
    assert not mark.exists()
    assert not path.exists()


def test_a_lock_is_held_while_compiling(tmp_path, monkeypatch):
    monkeypatch.setattr(jit.jit, "get_options", lambda: {"cache_dir": tmp_path / "new"})

    def build():
        (lock,) = (tmp_path / "new").glob(jit._LOCKS)
        return jit._compiles_since(lock.parent, time.time() + 1.0)

    assert jit.patiently(COMM, build)
    assert not list((tmp_path / "new").iterdir())


def test_what_two_have_compiled_is_compiled_again(tmp_path):
    """FFCx fails for the second of two, and would from then on."""
    ready = tmp_path / "libffcx_forms_0.c.cached"
    ready.touch()

    def build():
        with ready.open("x"):
            return 7

    assert jit.patiently(COMM, build) == 7


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


def test_what_is_compiled_is_kept_under_its_signature():
    calls = []

    def build():
        calls.append(len(calls))
        return len(calls)

    first = jit.compiled_once(COMM, "of this test", build)
    assert jit.compiled_once(COMM, "of this test", build) == first
    assert jit.compiled_once(COMM, "another of this test", build) != first
    assert len(calls) == 2
