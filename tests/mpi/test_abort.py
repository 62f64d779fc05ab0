"""An error that nobody catches ends the whole run, and is told once if all ranks have it."""

from __future__ import annotations

import shutil

import pytest
from conftest import start

needs_mpirun = pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")

# the first collective call of dolfinmpm sets the hook
START = """
import dolfinmpm as mpm
from dolfinx import mesh
from mpi4py import MPI
comm = MPI.COMM_WORLD
mpm.Space(mesh.create_unit_square(comm, 4, 4, mesh.CellType.quadrilateral))
"""

ONE_RANK = """
if comm.rank == 1:
    raise KeyError("on one rank")
comm.Barrier()
print("past the barrier")
"""

OF_DOLFINMPM_ON_ONE_RANK = """
if comm.rank == 1:
    mpm.Stabilisation("glue")
comm.Barrier()
"""

ALL_RANKS = """
import dolfinmpm as mpm
from dolfinx import mesh
from mpi4py import MPI
def body():
    grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
    return mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1.0)
body()
"""

# as checks of points do, each rank has something else to say
EACH_ITS_OWN = """
from dolfinmpm._platform.errors import raise_together
errors = None, mpm.errors.StateError("of rank 1"), mpm.errors.FormError("of rank 2")
raise_together(comm, errors[comm.rank])
"""

OF_THE_SCRIPT = """
{}["youngs"]
"""

OF_TWO_KINDS = """
raise KeyError(min(comm.rank, 1))
"""


def failed(tmp_path, text, ranks, aborts=False):
    """What a script printed as errors that ends with code 1 on all ranks.

    Where one rank aborts the others, the launcher may have a code of its own.
    """
    script = tmp_path / "script.py"
    script.write_text(text)
    done = start(script, ranks=ranks)
    assert done.returncode == 1 or (aborts and done.returncode != 0)
    return done


@needs_mpirun
def test_an_error_on_one_rank_ends_all(tmp_path):
    done = failed(tmp_path, START + ONE_RANK, 2, aborts=True)
    assert "rank 1 of 2:\nTraceback " in done.stderr
    assert done.stderr.count("KeyError: 'on one rank'") == 1
    assert "past the barrier" not in done.stdout


@needs_mpirun
def test_an_error_of_dolfinmpm_on_one_rank_has_its_traceback(tmp_path):
    done = failed(tmp_path, START + OF_DOLFINMPM_ON_ONE_RANK, 2, aborts=True)
    assert "rank 1 of 2:\nTraceback " in done.stderr
    assert done.stderr.count("ParameterError: ") == 1
    assert "MPI_ABORT" in done.stderr


@needs_mpirun
def test_an_error_on_all_ranks_is_one_sentence(tmp_path):
    done = failed(tmp_path, ALL_RANKS, 3)
    assert done.stderr.count("dolfinmpm.errors.ShapeOutsideGridError: ") == 1
    assert done.stderr.count("ShapeOutsideGridError") == 1
    assert f'in "{tmp_path}/script.py", line 7: return mpm.fill(grid, ' in done.stderr
    assert "Traceback" not in done.stderr
    assert "rank" not in done.stderr.split("ShapeOutsideGridError")[0]
    assert "MPI_ABORT" not in done.stderr


@needs_mpirun
def test_what_is_raised_together_is_told_as_one(tmp_path):
    done = failed(tmp_path, START + EACH_ITS_OWN, 3)
    assert done.stderr.startswith("dolfinmpm.errors.StateError: of rank 1\n")
    assert "rank 2" not in done.stderr
    assert "Traceback" not in done.stderr


@needs_mpirun
def test_a_wrong_script_has_one_traceback(tmp_path):
    done = failed(tmp_path, START + OF_THE_SCRIPT, 3)
    assert done.stderr.count("Traceback") == done.stderr.count("KeyError: 'youngs'") == 1
    assert "MPI_ABORT" not in done.stderr


@needs_mpirun
def test_different_errors_on_all_ranks_are_told_once_each(tmp_path):
    done = failed(tmp_path, START + OF_TWO_KINDS, 3)
    assert done.stderr.count("Traceback") == 2
    assert "rank 0:\nTraceback" in done.stderr
    assert "rank 1, 2:\nTraceback" in done.stderr
    assert "MPI_ABORT" not in done.stderr


KEPT = "import sys\n{}\nassert sys.excepthook is sys.__excepthook__\n"


def test_one_rank_keeps_its_hook(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(KEPT.format(START))
    assert start(script).returncode == 0


@needs_mpirun
def test_an_import_sets_no_hook(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(KEPT.format("import dolfinmpm"))
    assert start(script, ranks=2).returncode == 0
