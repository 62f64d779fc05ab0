"""What PETSc holds on several ranks: objects that wait to be freed, and options."""

from __future__ import annotations

import re
import shutil

import pytest
from conftest import start


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
def test_matrices_of_former_steps_are_freed():
    done = start("tests/mpi/run_garbage.py", "12", ranks=2)
    assert done.returncode == 0, done.stderr[-4000:]
    waiting = [int(count) for count in re.findall(r"Total entries: (\d+)", done.stdout)]
    assert len(waiting) == 2
    # every step lets go of a matrix at least
    assert max(waiting) < 4


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
def test_petsc_tells_of_no_option_that_it_did_not_need():
    done = start("tests/mpi/run_tied_splines.py", ranks=2)
    assert done.returncode == 0, done.stderr[-4000:]
    assert "not used" not in done.stdout + done.stderr
