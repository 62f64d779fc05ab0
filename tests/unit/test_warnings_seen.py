"""Warnings reach the person who runs a script, though FFCx sends them to a silent logger."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """\
import logging, sys
import dolfinmpm as mpm
if "log" in sys.argv:
    logging.basicConfig(format="logged: %(message)s")
    logging.captureWarnings(True)
mpm.materials.MohrCoulomb(1e6, 0.3, cohesion=0.0, friction_angle=0.6)
print(logging.getLogger("py.warnings").handlers)
"""


@pytest.mark.parametrize("how", ["plain", "log"])
def test_a_script_shows_a_warning_once_at_its_line(tmp_path, how):
    script = tmp_path / "case.py"
    script.write_text(PROGRAM)
    command = [sys.executable, str(script), how]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert run.stderr.count("DegreesWarning: ") == 1
    assert f"{script}:6: " in run.stderr
    assert run.stderr.startswith("logged: ") == (how == "log")


def test_warnings_stay_with_who_records_them(recwarn):
    import dolfinmpm as mpm

    mpm.materials.MohrCoulomb(1e6, 0.3, cohesion=0.0, friction_angle=0.6)
    assert [one.category.__name__ for one in recwarn] == ["DegreesWarning"]
