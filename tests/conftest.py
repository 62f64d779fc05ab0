"""Grids and problems that many tests share."""

from __future__ import annotations

import contextlib
import ctypes
import io
import json
import os
import runpy
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.assembly.stencilsums import Matrix

COMM = MPI.COMM_WORLD
ROOT = Path(__file__).resolve().parents[1]


# a machine with much other work on it may need minutes for what takes seconds
LIMIT = 3600.0


def pytest_addoption(parser):
    parser.addoption("--long", action="store_true", help="run what takes long, too")


def pytest_collection_modifyitems(config, items):
    if not config.getoption("--long"):
        skip = pytest.mark.skip(reason="needs --long")
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(skip)


def _die_with_parent():
    """Ends a child when this process is killed, when no `finally` runs."""
    pr_set_pdeathsig = 1
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGTERM)


def _session(leader):
    """Processes of a session: a launcher gives its ranks, and compilers, groups of their own."""
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            # after the name, which may hold spaces
            state, _, _, session = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
            if int(session) == leader and state != "Z":
                yield int(folder.name)


def end_session(child):
    """Kill what is left of the session that a child leads, compilers too."""
    while left := list(_session(child.pid)):
        for process in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        time.sleep(0.01)
    child.wait()


def start(script, *options, ranks=1, timeout=LIMIT):
    """A script run to its end by interpreters of its own; returns its code and what it printed.

    Whatever it started ends with it, and with the test.
    """
    # what this process's own MPI put into the environment must not reach the launcher's
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PMIX_", "OMPI_COMM_"))}
    clean["OMP_NUM_THREADS"] = "1"
    # many children import the same sources
    clean.pop("PYTHONDONTWRITEBYTECODE", None)
    # ranks that wait leave the cores to tests that run beside them
    clean["OMPI_MCA_mpi_yield_when_idle"] = "1"
    # of scripts that share with the tests what is beside them
    path = [str(ROOT), str(ROOT / "tests"), clean.get("PYTHONPATH")]
    clean["PYTHONPATH"] = os.pathsep.join(filter(None, path))
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    command = [*launcher, sys.executable, str(ROOT / script), *options]
    child = subprocess.Popen(
        command,
        env=clean,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=_die_with_parent,
    )
    try:
        out, err = child.communicate(timeout=timeout)
    finally:
        end_session(child)
    return subprocess.CompletedProcess(command, child.returncode, out, err)


def figures_of(script, *options, ranks=1, timeout=LIMIT):
    """The JSON that a script prints last.

    On several ranks it is run by interpreters of its own; alone by this one, as its main program,
    whose imports are paid for already.
    """
    if ranks == 1:
        return json.loads(run_here(ROOT / script, options).strip().splitlines()[-1])
    done = start(script, *options, ranks=ranks, timeout=timeout)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return json.loads(done.stdout.strip().splitlines()[-1])


def run_here(script, options):
    """What a script prints that runs as the main program of this process."""
    printed, argv, path, known = io.StringIO(), sys.argv, list(sys.path), set(sys.modules)
    sys.argv = [str(script), *options]
    sys.path.insert(0, str(script.parent))
    try:
        with contextlib.redirect_stdout(printed), warnings.catch_warnings():
            # how a library rounds is no error of the script, as in an interpreter of its own
            warnings.simplefilter("default", RuntimeWarning)
            runpy.run_path(str(script), run_name="__main__")
    except SystemExit as end:
        if end.code:
            pytest.fail(f"{script.name} ended with {end.code}: {printed.getvalue()}")
    finally:
        sys.argv, sys.path[:] = argv, path
        # another folder may have a module of the same name
        for name in set(sys.modules) - known:
            found = getattr(sys.modules[name], "__file__", None)
            if found and Path(found).parent == script.parent:
                del sys.modules[name]
        mpm.measure_stages(False)
    return printed.getvalue()


def distort(grid, amount=0.12):
    """Move the inner nodes of a unit grid, so that cells are no longer alike."""
    x = grid.geometry.x
    d = grid.geometry.dim
    inner = np.prod([x[:, i] * (1 - x[:, i]) * 4 for i in range(d)], axis=0)
    for i in range(d):
        x[:, i] += amount * inner * np.sin(3.0 + 5 * x[:, (i + 1) % d])
    return grid


def unit_grid(kind: str, n: int = 3):
    """A grid of [0, 1]^d: "interval", "triangle", ..., or "distorted quadrilateral", ..."""
    name = kind.split()[-1]
    cell = mesh.CellType[name]
    if name == "interval":
        grid = mesh.create_unit_interval(COMM, n)
    elif name in ("triangle", "quadrilateral"):
        grid = mesh.create_unit_square(COMM, n, n + 1, cell)
    else:
        grid = mesh.create_unit_cube(COMM, n, n + 1, n, cell)
    return distort(grid) if kind.startswith("distorted") else grid


class Linearised:
    """Residual and tangent of a problem's next step, for comparison with differences.

    Args:
        problem: The problem.

    Attributes:
        operator: Its weak form on what is active.
        size: Number of this rank's unknowns.
        matrix: The tangent that was assembled last, as a PETSc matrix.
    """

    def __init__(self, problem):
        self.operator = problem.operator()
        here = self.operator.here
        self.size = here.unknowns.owned
        self._matrix = Matrix(here.pattern, here.unknowns)
        self.matrix = self._matrix.petsc

    def residual(self, x):
        """Forces out of balance at the unknowns x, shape (size,)."""
        return self.operator.residual(np.asarray(x, float)).values.copy()

    def tangent(self, x):
        """The tangent at the unknowns x, which `matrix` is then."""
        self.operator.residual(np.asarray(x, float))
        self.operator.tangent(self._matrix)
        return self.matrix

    def product(self, vector):
        """The tangent times a vector, shape (size,)."""
        x, y = self.matrix.createVecs()
        x.array[:] = vector
        self.matrix.mult(x, y)
        return y.array.copy()

    def both(self, size, t):
        """The tangent along a random way, and the central difference of residuals along it.

        Args:
            size: Largest of the random unknowns at which both are taken.
            t: Step of the difference, as a share of the way.
        """
        rng = np.random.default_rng(1)
        x, way = rng.uniform(-size, size, self.size), rng.uniform(-1, 1, self.size)
        self.tangent(x)
        difference = self.residual(x + t * way) - self.residual(x - t * way)
        return self.product(way), difference / (2 * t)


def dense(matrix):
    """Entries of a PETSc matrix, shape (rows, columns); the matrix is left as it is."""
    copy = matrix.copy()
    copy.convert("dense")
    return copy.getDenseArray().copy()


GRIDS = (
    "interval",
    "triangle",
    "quadrilateral",
    "tetrahedron",
    "hexahedron",
    "distorted triangle",
    "distorted quadrilateral",
    "distorted tetrahedron",
    "distorted hexahedron",
)


@pytest.fixture(params=GRIDS)
def any_grid(request):
    """Every kind of grid in turn."""
    return unit_grid(request.param)
