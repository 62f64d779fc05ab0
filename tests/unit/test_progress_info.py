"""Loads with a progress bar, and the report on the installation."""

from __future__ import annotations

import io
import platform
import runpy
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm
from dolfinmpm._platform.compat import library_of
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.installation import _blas, _threads, info
from dolfinmpm.dynamics import times
from dolfinmpm.io.progress import steps

ROOT = MPI.COMM_WORLD.rank == 0


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("number", [1, 3, 7, 49, np.int64(40)])
def test_loads_end_exactly_at_one(number):
    loads = list(steps(number))
    assert len(loads) == number
    assert loads[-1] == 1.0
    np.testing.assert_allclose(np.diff([0.0, *loads]), 1 / number)


@pytest.mark.parametrize(
    ("stream", "setting", "drawn"),
    [
        (io.StringIO, "", False),
        (io.StringIO, "1", True),
        (Terminal, "", True),
        (Terminal, "0", False),
    ],
)
def test_bar_is_drawn_only_where_it_is_seen(monkeypatch, stream, setting, drawn):
    monkeypatch.setattr(sys, "stderr", stream())
    monkeypatch.setenv("DOLFINMPM_PROGRESS", setting)
    assert list(steps(2, label="gravity")) == [0.5, 1.0]
    text = sys.stderr.getvalue()
    assert ("gravity" in text and "2/2" in text) if drawn and ROOT else text == ""


def test_bar_is_closed_when_the_loop_is_left(monkeypatch):
    monkeypatch.setenv("DOLFINMPM_PROGRESS", "1")
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    for load in (loads := steps(4)):
        if load == 0.5:
            break
    loads.close()
    assert sys.stderr.getvalue().endswith("\n") or not ROOT


def test_a_bar_is_not_needed(monkeypatch):
    monkeypatch.setenv("DOLFINMPM_PROGRESS", "1")
    monkeypatch.setitem(sys.modules, "tqdm", None)
    assert list(steps(2)) == [0.5, 1.0]


def test_many_steps_make_no_list():
    loads = steps(10**12)
    assert [next(loads), next(loads)] == [1e-12, 2e-12]
    loads = times(1.0, dt=1e-8)
    assert [float(next(loads)) for _ in range(2)] == pytest.approx([1e-8, 2e-8])
    with pytest.raises(ParameterError, match=r"dt = 1e-12 s makes 1e\+12 steps up to 1 s"):
        times(1.0, dt=1e-12)
    assert list(times(0.5, dt=0.2)) == pytest.approx([1 / 6, 2 / 6, 0.5])
    assert list(times(0.5, dt=0.2))[-1] == 0.5


@pytest.mark.parametrize("number", [0, -3, 2.0, "4", None, True])
def test_wrong_number_is_told_before_the_first_step(number):
    with pytest.raises(ParameterError, match="number of steps = "):
        steps(number)


def test_info_tells_versions():
    report = info()
    lines = dict(line.split(maxsplit=1) for line in report.splitlines())
    assert lines["dolfinmpm"] == dolfinmpm.__version__
    assert lines["Python"] == platform.python_version()
    assert np.__version__ in lines["NumPy"]
    assert "MUMPS" in lines["PETSc"]
    assert lines["ranks"] == str(MPI.COMM_WORLD.size)
    assert {
        "DOLFINx",
        "UFL",
        "FFCx",
        "Basix",
        "SLEPc",
        "MPI",
        "Numba",
        "BLAS",
        "threads",
    } <= lines.keys()
    assert repr(report) == str(report)


@pytest.mark.parametrize(
    ("library", "found"),
    [
        ("/usr/lib/x86_64-linux-gnu/blas/libblas.so.3.12.1", "reference BLAS"),
        ("/usr/lib/x86_64-linux-gnu/openblas-pthread/libblas.so.3", "OpenBLAS"),
        ("/opt/conda/lib/libopenblasp-r0.3.29.so", "OpenBLAS"),
        ("/opt/intel/lib/libmkl_intel_lp64.so.2", "MKL"),
        ("/home/atlas/lib/libpetsc.so", "/home/atlas/lib/libpetsc.so"),
    ],
)
def test_blas_is_known_by_its_library(library, found):
    assert _blas(Path(library)).startswith(found)


def test_blas_of_other_systems():
    assert _blas(None) == "not known on this system"
    assert library_of("no_such_function") is None


def test_petsc_calls_a_blas_that_is_loaded():
    library = library_of("dgemm_")
    assert library.is_file()
    if sys.platform == "linux":
        assert str(library) in Path("/proc/self/maps").read_text()


def test_threads_are_told_where_threadpoolctl_is(monkeypatch):
    module = types.ModuleType("threadpoolctl")
    module.threadpool_info = lambda: [
        {"internal_api": "openblas", "version": "0.3.29", "num_threads": 4},
        {"internal_api": "openmp", "version": None, "num_threads": 2},
    ]
    monkeypatch.setitem(sys.modules, "threadpoolctl", module)
    assert _threads() == "4 of openblas 0.3.29, 2 of openmp"
    monkeypatch.setitem(sys.modules, "threadpoolctl", None)
    assert _threads() == "not known without threadpoolctl"


def test_module_prints_the_report(capsys):
    runpy.run_module("dolfinmpm", run_name="__main__")
    printed = capsys.readouterr().out
    assert printed.strip() == (info() if ROOT else "")
