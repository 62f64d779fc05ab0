"""UMATs as shared libraries: compiled once with gfortran, and kept in FFCx's cache."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dolfinx import jit
from mpi4py import MPI

from dolfinmpm._platform.errors import (
    MissingPackageError,
    ParameterError,
    UserLawError,
    call_on_root,
    call_together,
)
from dolfinmpm._platform.filepaths import file_path
from dolfinmpm.materials.umatshim import INCLUDE, SHIM

__all__ = ["UmatLibrary", "open_umat"]

SOURCES = (".f", ".for", ".f90", ".f95", ".f03", ".f08")
LIBRARIES = (".so",)
# Old programs: any type for an argument, tabulators, and lines of common length
_FLAGS = ("-shared", "-fPIC", "-std=legacy", "-w", "-Wl,-Bsymbolic", "-Wl,-z,defs")
# The shim's STOP goes before that of gfortran's library, which other packages have loaded
_MODE = os.RTLD_NOW | os.RTLD_LOCAL | getattr(os, "RTLD_DEEPBIND", 0)
_LONGEST = 4000  # characters of a compiler's message
_INCLUDED = re.compile(r"""^\s*#?\s*include\s*['"]([^'"]+)['"]""", re.IGNORECASE | re.MULTILINE)


@dataclass(frozen=True)
class UmatLibrary:
    """A UMAT in memory.

    Attributes:
        path: The shared library, with the shim of `dolfinmpm.materials.umatshim`.
        address: Address of `dolfinmpm_umat`.
        keep: The object that keeps the library in memory.
    """

    path: Path
    address: int
    keep: Any


def open_umat(path: Any, flags: Sequence[str]) -> UmatLibrary:
    """Compile a UMAT if necessary, and load it. Collective over all ranks.

    Args:
        path: Fortran source, or a shared library with the symbol `umat_`.
        flags: Options of gfortran.

    Raises:
        ParameterError: There is no such file, or its ending is not known.
        MissingPackageError: There is no compiler.
        UserLawError: The compiler refuses the source, or the symbol `umat_` is missing.
    """
    found = call_on_root(MPI.COMM_WORLD, lambda: _built(_checked(path), tuple(flags)))

    def load() -> UmatLibrary:
        try:
            library = ctypes.CDLL(str(found), mode=_MODE)
        except OSError as caught:
            raise UserLawError(f"the UMAT {path} cannot be loaded: {caught}") from caught
        address = ctypes.cast(library.dolfinmpm_umat, ctypes.c_void_p).value
        assert address is not None
        return UmatLibrary(found, address, library)

    return call_together(MPI.COMM_WORLD, load)


def _checked(path: Any) -> Path:
    at = file_path("path", path)
    ending = at.suffix.lower()
    if ending not in SOURCES + LIBRARIES:
        raise ParameterError(
            f"the UMAT {str(path)!r} must end in {', '.join(SOURCES)} (source) or .so (library)"
        )
    if not at.is_file():
        raise ParameterError(f"the UMAT {str(path)!r} is not there; seen from {Path.cwd()}")
    return at.resolve()


def _compiler(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        raise MissingPackageError(
            f"a UMAT needs the compiler {name}, which is not installed: apt-get install {name}, "
            f"or conda install -c conda-forge {'gfortran' if name == 'gfortran' else 'c-compiler'}"
            + ("; or give a library (.so) that was compiled elsewhere" * (name == "gfortran"))
        )
    return found


def _built(source: Path, flags: tuple[str, ...]) -> Path:
    """The shared library of a source or of a user's library, compiled now or before."""
    compiled = source.suffix.lower() in LIBRARIES
    compiler = _compiler("gcc" if compiled else "gfortran")
    folder = Path(jit.get_options()["cache_dir"]) / "umat"
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout
    key = hashlib.sha256(f"{version}{flags}{SHIM}{INCLUDE}{source}".encode())
    for content in _contents(source):
        key.update(content)
    target = folder / f"{source.stem}-{key.hexdigest()[:24]}.so"
    if not target.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as work:
            made = _compile(compiler, source, flags, Path(work))
            _has_symbol(made, source)
            made.replace(target)
    return target


def _contents(source: Path, seen: set[Path] | None = None) -> list[bytes]:
    """The bytes of a source and of the files beside it that it includes."""
    seen = set() if seen is None else seen
    if source in seen or not source.is_file():
        return []
    seen.add(source)
    content = source.read_bytes()
    if source.suffix.lower() in LIBRARIES:
        return [content]
    found = [content]
    for name in _INCLUDED.findall(content.decode(errors="replace")):
        found += _contents((source.parent / name).resolve(), seen)
    return found


def _compile(compiler: str, source: Path, flags: tuple[str, ...], work: Path) -> Path:
    shim, made = work / "shim.c", work / "umat.so"
    shim.write_text(SHIM)
    for name in ("ABA_PARAM.INC", "aba_param.inc"):
        with contextlib.suppress(OSError):
            (work / name).write_text(INCLUDE)
    gcc = _compiler("gcc")
    _run([gcc, "-O2", "-fPIC", "-c", shim.name, "-o", "shim.o"], work, source)
    if source.suffix.lower() in LIBRARIES:
        # the user's library may call the routines of the shim: nothing is to be defined yet
        options = ["-shared", "-fPIC", "-Wl,--no-as-needed", "-Wl,-rpath," + str(source.parent)]
        _run([gcc, *options, "shim.o", str(source), "-lm", "-o", made.name], work, source)
        return made
    common = [compiler, *_FLAGS, *flags, f"-I{source.parent}", f"-I{work}"]
    rest = ["shim.o", str(source), "-lm", "-o", made.name]
    first = _try([*common, *rest], work)
    if first is None:
        return made
    # some vendors' compilers read long lines in fixed form
    fixed = source.suffix.lower() in (".f", ".for")
    if fixed and _try([*common, "-ffixed-line-length-none", *rest], work) is None:
        return made
    raise _refused(source, first)


def _try(command: list[str], work: Path) -> str | None:
    """Run a compiler; its message if it fails, else None."""
    environment = {**os.environ, "LC_ALL": "C"}
    done = subprocess.run(command, cwd=work, capture_output=True, text=True, env=environment)
    return None if done.returncode == 0 else done.stderr or done.stdout


def _run(command: list[str], work: Path, source: Path) -> None:
    message = _try(command, work)
    if message is not None:
        raise _refused(source, message)


def _refused(source: Path, message: str) -> UserLawError:
    missing = re.findall(r"undefined reference to [`']([^`']+)'", message)
    if "umat_" in missing:
        return UserLawError(
            f"{source} has no SUBROUTINE UMAT: its symbol umat_ is missing. In Fortran write "
            "SUBROUTINE UMAT(STRESS, STATEV, DDSDDE, ...) outside of modules; in C name it umat_"
        )
    if missing:
        names = ", ".join(dict.fromkeys(missing))
        return UserLawError(
            f"{source} calls {names}, which it does not contain. dolfinmpm has XIT, STDB_ABQERR, "
            "GETOUTDIR, ROTSIG, SINV, SPRINC and SPRIND; put other routines into the file"
        )
    text = message if len(message) <= _LONGEST else message[:_LONGEST] + "\n..."
    return UserLawError(f"the compiler refuses {source}:\n{text}")


def _has_symbol(library: Path, source: Path) -> None:
    """Raise UserLawError if a library does not define all that it calls.

    It is loaded in a process of its own: here a library of the user would be bound to this copy of
    the shim for ever.
    """
    load = f"import ctypes, sys; ctypes.CDLL(sys.argv[1], mode={_MODE})"
    command = [sys.executable, "-I", "-c", load, str(library)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise UserLawError(
            f"the UMAT {source} cannot be loaded: {said[-1].removeprefix('OSError: ')}. A UMAT has "
            "the symbol umat_"
        )
