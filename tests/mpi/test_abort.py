"""An error that no check foresees ends the whole run, on whichever ranks it is raised."""

from __future__ import annotations

import shutil

import pytest
from conftest import start

ONE_RANK = """
import dolfinmpm
from mpi4py import MPI
comm = MPI.COMM_WORLD
if comm.rank == 1:
    raise KeyError("on one rank")
comm.Barrier()
print("past the barrier")
"""

ALL_RANKS = """
import dolfinmpm as mpm
from dolfinx import mesh
from mpi4py import MPI
grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1.0)
"""


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
def test_an_error_on_one_rank_ends_all(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(ONE_RANK)
    done = start(script, ranks=2)
    assert done.returncode != 0
    assert "KeyError: 'on one rank'" in done.stderr
    assert "past the barrier" not in done.stdout


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
def test_an_error_on_all_ranks_is_no_abort(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(ALL_RANKS)
    done = start(script, ranks=2)
    assert done.returncode != 0
    assert done.stderr.count("ShapeOutsideGridError: ") == 2
    assert "MPI_ABORT" not in done.stderr


def test_one_rank_keeps_its_hook(tmp_path):
    script = tmp_path / "script.py"
    script.write_text("import sys\nimport dolfinmpm\nassert sys.excepthook is sys.__excepthook__\n")
    assert start(script).returncode == 0
