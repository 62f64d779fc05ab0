"""What a bug report has to tell about the installation."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
from pathlib import Path

from mpi4py import MPI

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
        One line an entry; a session that evaluates `dolfinmpm.info()` shows it as
        printed. Not collective: what is said holds for the rank that asks.
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
        "BLAS": _blas(),
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


def _blas(maps: str = "/proc/self/maps") -> str:
    """The BLAS in this process that PETSc calls, as far as Linux tells."""
    import petsc4py.PETSc  # noqa: F401  (loads it)

    try:
        lines = Path(maps).read_text().splitlines()
    except OSError:
        return "not known on this system"
    return _which_blas([line.split(maxsplit=5)[5] for line in lines if line.count("/")])


def _which_blas(libraries: list[str]) -> str:
    """The BLAS among the paths of the libraries that a process has loaded."""
    # wheels of NumPy and SciPy bring an OpenBLAS that no one else calls
    paths = [Path(p) for p in libraries if "numpy.libs" not in p and "scipy.libs" not in p]
    shared = [p for p in paths if ".so" in p.name or p.suffix == ".dylib"]
    plain = [p for p in shared if p.name.startswith("libblas.")]
    for candidates in (plain, shared):
        for path in candidates:
            # Debian keeps every BLAS as libblas.so.3 in a folder of its own name
            text = f"{path.parent.name}/{path.name}".lower()
            for mark, name in _BLAS:
                if mark in text:
                    return f"{name} ({path})"
        if candidates is plain and plain:
            return f"{_SLOW} ({plain[0]})"
    return "not found"


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
