"""Loops that call what has changed in another file are compiled again."""

from __future__ import annotations

import subprocess
import sys

from dolfinmpm._platform.kernelcache import forget_outdated

CALLEE = "import numba\n@numba.njit(cache=True)\ndef value():\n    return {}\n"
CALLER = (
    "import numba\nfrom callee import value\n"
    "@numba.njit(cache=True)\ndef twice():\n    return 2 * value()\n"
)


def twice(folder):
    code = "from caller import twice; print(twice())"
    command = [sys.executable, "-c", code]
    return int(subprocess.run(command, cwd=folder, capture_output=True, check=True).stdout)


def test_a_changed_callee_is_seen(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(1))
    assert forget_outdated(tmp_path)
    assert twice(tmp_path) == 2
    assert not forget_outdated(tmp_path)
    indices = list(tmp_path.rglob("*.nbi"))
    assert indices
    (tmp_path / "callee.py").write_text(CALLEE.format(21))
    assert forget_outdated(tmp_path)
    assert not any(index.exists() for index in indices)
    assert twice(tmp_path) == 42
    assert not forget_outdated(tmp_path)


def test_other_files_do_not_count(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    assert forget_outdated(tmp_path)
    (tmp_path / "plain.py").write_text("x = 1\n")
    assert not forget_outdated(tmp_path)
