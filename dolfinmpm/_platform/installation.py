"""What a bug report has to tell about the installation."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
from pathlib import Path

from mpi4py import MPI

from dolfinmpm._platform.compat import library_of

__all__ = ["info"]

# Parts of library names that tell a BLAS, most specific first.
_BLAS = (
    ("openblas", "OpenBLAS"),
    ("mkl_", "MKL"),
    ("blis", "BLIS"),
    ("atlas", "ATLAS"),
    ("armpl", "Arm Performance Libraries"),
    ("accelerate", "Accelerate"),
)
_SLOW = "reference BLAS: MUMPS is 4 to 5 times slower; install OpenBLAS (libopenblas0-pthread)"


class _Report(str):
    """A text that an interactive session shows as it is printed."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def info() -> str:
    """Versions of everything that dolfinmpm runs on, for a bug report.

    Returns:
        Text with one line per entry. A notebook shows it as it is printed. Not collective: the
        text holds for the rank that calls.

    The first line has the version of dolfinmpm:

    >>> import dolfinmpm as mpm
    >>> print(mpm.info().splitlines()[0].split()[0])
    dolfinmpm
    """
    import dolfinx

    from dolfinmpm import __version__

    entries = {
        "dolfinmpm": __version__,
        "Python": platform.python_version(),
        "DOLFINx": f"{dolfinx.__version__} ({dolfinx.git_commit_hash})",
        "UFL": _version("fenics-ufl"),
        "FFCx": _version("fenics-ffcx"),
        "Basix": _version("fenics-basix"),
        "PETSc": _petsc(),
        "petsc4py": _version("petsc4py"),
        "SLEPc": _slepc(),
        "BLAS": _blas(library_of("dgemm_")),
        "threads": _threads(),
        "MPI": f"{_mpi()}, mpi4py {_version('mpi4py')}",
        "Numba": _version("numba"),
        "NumPy": f"{_version('numpy')}, SciPy {_version('scipy')}",
        "output": ", ".join(f"{name} {_version(name)}" for name in ("vtk", "matplotlib", "h5py")),
        "system": _system(),
        "processors": f"{_processors()} of {os.cpu_count()} usable, OMP_NUM_THREADS = "
        f"{os.environ.get('OMP_NUM_THREADS', 'not set')}",
        "ranks": str(MPI.COMM_WORLD.size),
    }
    width = max(map(len, entries))
    return _Report("\n".join(f"{name:<{width}}  {value}" for name, value in entries.items()))


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        pass
    try:
        # some distributions install the module without its metadata
        return importlib.import_module(package.removeprefix("fenics-")).__version__
    except (ImportError, AttributeError):
        return "not installed"


def _petsc() -> str:
    from petsc4py import PETSc

    version = ".".join(map(str, PETSc.Sys.getVersion()))
    mumps = "with" if PETSc.Sys.hasExternalPackage("mumps") else "without"
    bits = 8 * PETSc.IntType().itemsize
    return f"{version} {mumps} MUMPS, {PETSc.ScalarType.__name__} scalars, {bits} bit indices"


def _slepc() -> str:
    try:
        from slepc4py import SLEPc
    except ImportError:
        return "not installed"
    return f"{'.'.join(map(str, SLEPc.Sys.getVersion()))}, slepc4py {_version('slepc4py')}"


def _mpi() -> str:
    # the first line up to the first comma: "Open MPI v5.0.7", "MPICH Version: 4.2.0"
    first = MPI.Get_library_version().strip("\0\n ").splitlines()[0]
    return " ".join(first.split(",")[0].split())


def _blas(library: Path | None) -> str:
    """The BLAS that a library is, by its name.

    threadpoolctl knows versions, but lists only libraries whose threads it can set: not
    the reference BLAS, nor which of several PETSc calls.
    """
    if library is None:
        return "not known on this system"
    # Debian keeps every BLAS as libblas.so.3 in a folder of its own name
    text = f"{library.parent.name}/{library.name}".lower()
    for mark, name in _BLAS:
        if mark in text:
            return f"{name} ({library})"
    return f"{_SLOW} ({library})" if library.name.startswith("libblas.") else str(library)


def _threads() -> str:
    """What every BLAS and OpenMP library in this process may use."""
    try:
        from threadpoolctl import threadpool_info
    except ImportError:
        return "not known without threadpoolctl"
    pools = (
        f"{pool['num_threads']} of {pool['internal_api']} {pool['version'] or ''}".rstrip()
        for pool in threadpool_info()
    )
    return ", ".join(pools) or "none"


def _system() -> str:
    try:
        name = platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        name = platform.system()
    return f"{name}, {platform.system()} {platform.release()}, {platform.machine()}"


def _processors() -> int | None:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count()
