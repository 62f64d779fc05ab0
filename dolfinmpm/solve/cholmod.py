"""Supernodal Cholesky factors by CHOLMOD, with access to their last block."""

from __future__ import annotations

import functools
import importlib.machinery
import importlib.util
import os
import sys
import sysconfig
import tempfile
import weakref
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import petsc4py
from dolfinx import jit

__all__ = ["DONE", "INDEFINITE", "NO_MEMORY", "Factor", "unavailable"]

Array = npt.NDArray[np.float64]

# Results of a factorisation, from good to bad
DONE, INDEFINITE, NO_MEMORY = range(3)

_DECLARED = """
void *analyse(int n, int *start, int *rows, int *late, int *order, double *counts);
int factorise(void *L, int n, int *start, int *rows, double *values);
void trailing(void *L, int *at, int size, double *out);
void sweep(void *L, double *x, int back);
void release(void *L);
"""

# PETSc's interface to CHOLMOD neither orders some unknowns last nor shows L. The C compiler reads
# CHOLMOD's structures in its header.
_SOURCE = """
#include <cholmod.h>

static cholmod_common *common(void)
{
    static cholmod_common c;
    static int started = 0;
    if (!started) {
        started = cholmod_start(&c);
        c.print = 0;   /* an indefinite matrix is no news for the terminal */
        c.quick_return_if_not_posdef = 1;
        c.supernodal = CHOLMOD_SUPERNODAL;
        c.nmethods = c.postorder = 1;
        c.method[0].ordering = CHOLMOD_GIVEN;
    }
    return &c;
}

/* The lower triangle: CHOLMOD passes over entries of the upper one. */
static cholmod_sparse lower(int n, int *start, int *rows, double *values)
{
    cholmod_sparse B = {0};
    B.nrow = B.ncol = n;
    B.nzmax = start[n];
    B.p = start; B.i = rows; B.x = values;
    B.stype = -1; B.itype = CHOLMOD_INT; B.dtype = CHOLMOD_DOUBLE;
    B.xtype = values ? CHOLMOD_REAL : CHOLMOD_PATTERN;
    B.packed = 1;
    return B;
}

/* L without values, or NULL for want of memory; writes the order, and operations and entries */
static void *analyse(int n, int *start, int *rows, int *late, int *order, double *counts)
{
    cholmod_sparse B = lower(n, start, rows, NULL);
    cholmod_factor *L = NULL;
    if (cholmod_camd(&B, NULL, 0, late, order, common()))
        L = cholmod_analyze_p(&B, order, NULL, 0, common());
    if (L) {
        for (int k = 0; k < n; k++) order[k] = ((int *)L->Perm)[k];
        counts[0] = common()->fl;
        counts[1] = common()->lnz;
    }
    return L;
}

/* 0; 1 if the matrix is not positive definite, 2 for want of memory */
static int factorise(void *L, int n, int *start, int *rows, double *values)
{
    cholmod_sparse B = lower(n, start, rows, values);
    cholmod_factorize(&B, L, common());
    if (common()->status < CHOLMOD_OK) return 2;
    return ((cholmod_factor *)L)->minor < (size_t)n;
}

/* L between the unknowns with at >= 0, column by column */
static void trailing(void *factor, int *at, int size, double *out)
{
    cholmod_factor *L = factor;
    int *first = L->super, *rows_of = L->pi, *values_of = L->px, *rows = L->s;
    for (size_t s = 0; s < L->nsuper; s++) {
        int count = rows_of[s + 1] - rows_of[s];
        for (int c = 0; c < first[s + 1] - first[s]; c++) {
            int column = at[first[s] + c];
            double *values = (double *)L->x + values_of[s] + (size_t)c * count;
            for (int k = c; column >= 0 && k < count; k++) {
                /* merged supernodes have zeros at rows that L does not couple to the column */
                int row = at[rows[rows_of[s] + k]];
                if (row >= 0) out[(size_t)column * size + row] = values[k];
            }
        }
    }
}

/* Solve L y = x, or L' y = x, in place */
static void sweep(void *factor, double *x, int back)
{
    cholmod_factor *L = factor;
    cholmod_dense *work = cholmod_allocate_dense(L->n, 1, L->n, CHOLMOD_REAL, common());
    cholmod_dense X = {0};
    X.nrow = X.nzmax = X.d = L->n;
    X.ncol = 1;
    X.x = x; X.xtype = CHOLMOD_REAL; X.dtype = CHOLMOD_DOUBLE;
    if (back) cholmod_super_ltsolve(L, &X, work, common());
    else cholmod_super_lsolve(L, &X, work, common());
    cholmod_free_dense(&work, common());
}

static void release(void *factor)
{
    cholmod_factor *L = factor;
    cholmod_free_factor(&L, common());
}
"""


def _header() -> Path:
    """The folder with CHOLMOD's header, in the environment, in PETSc or in the system.

    Raises:
        OSError: There is no such folder.
    """
    petsc = Path(petsc4py.get_config()["PETSC_DIR"])
    for root in (Path(sys.prefix), petsc, petsc / os.environ.get("PETSC_ARCH", ""), Path("/usr")):
        for folder in (root / "include/suitesparse", root / "include"):
            if (folder / "cholmod.h").exists():
                return folder
    raise OSError("cholmod.h of SuiteSparse is not installed")


@functools.cache
def _compiled() -> Any:
    """The functions above, compiled once and kept in DOLFINx's cache of compiled forms.

    Raises:
        OSError: There is no header, no compiler or no library.
    """
    import cffi

    header = _header()
    key = zlib.crc32(f"{_SOURCE}{_DECLARED}{header}".encode() + (header / "cholmod.h").read_bytes())
    name = f"dolfinmpm_cholmod_{key:08x}"
    kept = Path(jit.get_options()["cache_dir"]) / (name + sysconfig.get_config_var("EXT_SUFFIX"))
    if not kept.exists():
        kept.parent.mkdir(parents=True, exist_ok=True)
        folder = (
            next(parent for parent in header.parents if parent.name == "include").parent / "lib"
        )
        ffi = cffi.FFI()
        ffi.cdef(_DECLARED)
        ffi.set_source(
            name, _SOURCE, libraries=["cholmod"], include_dirs=[str(header)],
            library_dirs=[str(folder)], runtime_library_dirs=[str(folder)],
        )  # fmt: skip
        # another process may compile the same file at the same time
        with tempfile.TemporaryDirectory(dir=kept.parent) as made:
            try:
                os.replace(ffi.compile(made), kept)
            except cffi.VerificationError as why:
                raise OSError(f"CHOLMOD's interface does not compile: {why}") from None
    loader = importlib.machinery.ExtensionFileLoader(name, str(kept))
    spec = importlib.machinery.ModuleSpec(name, loader, origin=str(kept))
    try:
        module = importlib.util.module_from_spec(spec)
    except ImportError as why:
        raise OSError(f"CHOLMOD's interface does not load: {why}") from None
    loader.exec_module(module)
    return module


@functools.cache
def unavailable() -> str:
    """Reason why CHOLMOD cannot be used, or an empty text."""
    try:
        _compiled()
    except OSError as why:
        return str(why)
    return ""


class Factor:
    """L of B = L Lᵀ, B symmetric positive definite, with some unknowns eliminated last.

    The order of constrained approximate minimum degree reduces fill (Amestoy, Davis & Duff 2004,
    doi 10.1145/1024074.1024081). The factorisation is the supernodal one of CHOLMOD (Chen, Davis,
    Hager & Rajamanickam 2008, doi 10.1145/1391989.1391995).

    Args:
        start, columns: Compressed rows of B, shapes (n + 1,) and (entries,).
        late: Mask of the unknowns that are eliminated last, shape (n,).

    Attributes:
        order: Unknown of B at each place of L, shape (n,).
        late: Places in L of the unknowns that are eliminated last, shape (m,).
        flops: Floating-point operations of a factorisation.
        entries: Entries of L.

    Raises:
        MemoryError: There is no memory for L, or L has more entries than 32-bit integers count.
    """

    def __init__(self, start: npt.NDArray, columns: npt.NDArray, late: npt.NDArray[np.bool_]):
        n = late.size
        self._module = _compiled()
        self._start, self._columns = start.astype(np.int32), columns.astype(np.int32)
        self.order, counts = np.zeros(n, np.int32), np.zeros(2)
        self._L = None
        if n > 0:
            classes = late.astype(np.int32)
            arrays = self._start, self._columns, classes, self.order, counts
            self._L = self._module.lib.analyse(n, *self._pointers(*arrays))
            if not self._L:
                raise MemoryError("CHOLMOD has no memory or no numbers for factors so large")
            weakref.finalize(self, self._module.lib.release, self._L)
        self.flops, self.entries = counts
        # other unknowns may be between them, without coupling in L
        self.late = np.flatnonzero(late[self.order])

    def _pointers(self, *arrays: npt.NDArray) -> list[Any]:
        kinds = ("double[]" if array.dtype == np.float64 else "int[]" for array in arrays)
        return list(map(self._module.ffi.from_buffer, kinds, arrays))

    def factorise(self, values: Array) -> int:
        """Factorise B with given entries, shape (entries,).

        Returns:
            `DONE`, `INDEFINITE` or `NO_MEMORY`.
        """
        if self._L is None:
            return DONE
        arrays = self._start, self._columns, np.ascontiguousarray(values)
        return self._module.lib.factorise(self._L, self.order.size, *self._pointers(*arrays))

    def trailing(self) -> Array:
        """L between the unknowns that are eliminated last, shape (m, m)."""
        m = self.late.size
        at, found = np.full(self.order.size, -1, np.int32), np.zeros((m, m))
        at[self.late] = np.arange(m)
        if m > 0:
            to, out = self._pointers(at, found)
            self._module.lib.trailing(self._L, to, m, out)
        return found.T

    def sweep(self, x: Array, back: bool = False) -> None:
        """Solve L y = x, or Lᵀ y = x if back, in place, shape (n,) by places."""
        if self._L is not None:
            self._module.lib.sweep(self._L, *self._pointers(x), back)
