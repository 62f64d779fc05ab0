"""Supernodal Cholesky factors by CHOLMOD, whose last block can be read."""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import weakref
from ctypes import POINTER, byref, c_double, c_float, c_int, c_int64, c_size_t, c_void_p
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Factor", "unavailable"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]

# of `cholmod.h`, the same in all releases of this main version
_MAIN_VERSION = 5
_GIVEN, _SUPERNODAL, _REAL, _LOWER = 1, 2, 1, -1
_OK, _OUT_OF_MEMORY, _TOO_LARGE, _NOT_POSDEF = 0, -2, -3, 1


def _structure(name: str, *members: tuple[type, str]) -> type[ctypes.Structure]:
    """A C structure by types and names of its members."""
    fields = [(member, kind) for kind, names in members for member in names.split()]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


_Method = _structure(
    "cholmod_method_struct",
    (c_double, "lnz fl prune_dense prune_dense2 nd_oksep"),
    (c_double * 4, "other_1"),
    (c_size_t, "nd_small"),
    (c_double * 4, "other_2"),
    (c_int, "aggressive order_for_lu nd_compress nd_camd nd_components ordering"),
    (c_size_t * 4, "other_3"),
)

# What follows is neither read nor written here; room for it is left, more than it takes.
_Common = _structure(
    "cholmod_common",
    (c_double, "dbound grow0 grow1"),
    (c_size_t, "grow2 maxrank"),
    (c_double, "supernodal_switch"),
    (c_int, "supernodal final_asis final_super final_ll final_pack final_monotonic final_resymbol"),
    (c_double * 3, "zrelax"),
    (c_size_t * 3, "nrelax"),
    (c_int, "prefer_zomplex prefer_upper quick_return_if_not_posdef prefer_binary"),
    (c_int, "print precise try_catch"),
    (c_void_p, "error_handler"),
    (c_int, "nmethods current selected"),
    (_Method * 10, "method"),
    (c_int, "postorder default_nesdis"),
    (c_double, "metis_memory metis_dswitch"),
    (c_size_t, "metis_nswitch nrow"),
    (c_int64, "mark"),
    (c_size_t, "iworksize xworkbytes"),
    (c_void_p, "Flag Head Xwork Iwork"),
    (c_int, "itype other_5 no_workspace_reallocate status"),
    (c_double, "fl lnz anz modfl"),
    (c_float * 4096, "rest"),
)

_Sparse = _structure(
    "cholmod_sparse",
    (c_size_t, "nrow ncol nzmax"),
    (c_void_p, "p i nz x z"),
    (c_int, "stype itype xtype dtype sorted packed"),
)

_Dense = _structure(
    "cholmod_dense",
    (c_size_t, "nrow ncol nzmax d"),
    (c_void_p, "x z"),
    (c_int, "xtype dtype"),
)

_Symbolic = _structure(
    "cholmod_factor",
    (c_size_t, "n minor"),
    (c_void_p, "Perm ColCount IPerm"),
    (c_size_t, "nzmax"),
    (c_void_p, "p i x z nz next prev"),
    (c_size_t, "nsuper ssize xsize maxcsize maxesize"),
    (c_void_p, "super pi px s"),
    (c_int, "ordering is_ll is_super is_monotonic itype xtype dtype useGPU"),
)


class _Library:
    """The shared library with one workspace.

    Raises:
        OSError: There is none, or one of another version or without partitioning.
    """

    def __init__(self) -> None:
        name = ctypes.util.find_library("cholmod") or f"libcholmod.so.{_MAIN_VERSION}"
        self.c: Any = ctypes.CDLL(name)
        version = (c_int * 3)()
        try:
            self.c.cholmod_version(version)
            for used in ("camd", "analyze_p", "factorize", "super_lsolve", "super_ltsolve"):
                getattr(self.c, f"cholmod_{used}")
        except AttributeError as missing:
            raise OSError(f"{name} has no function of the name: {missing}") from None
        if version[0] != _MAIN_VERSION:
            raise OSError(f"{name} is version {version[0]}, and not {_MAIN_VERSION}")
        self.common: Any = _Common()
        self.c.cholmod_analyze_p.restype = POINTER(_Symbolic)
        self.c.cholmod_start(byref(self.common))
        common = self.common
        # that a matrix is not positive definite is no news for the terminal
        common.print, common.quick_return_if_not_posdef = 0, 1
        common.supernodal = _SUPERNODAL
        common.nmethods, common.postorder = 1, 1
        common.method[0].ordering = _GIVEN

    def check(self, name: str) -> None:
        """Raise what a function ended with, if it is not that a matrix is indefinite."""
        status = self.common.status
        if status in (_OUT_OF_MEMORY, _TOO_LARGE):
            raise MemoryError(f"cholmod_{name}: no memory or no numbers for factors so large")
        if status < _OK:
            raise RuntimeError(f"cholmod_{name} ended with status {status}")


@functools.cache
def _library() -> _Library:
    return _Library()


@functools.cache
def unavailable() -> str:
    """Why there is no such library here, or an empty text."""
    try:
        _library()
    except OSError as why:
        return str(why)
    return ""


def _address(array: np.ndarray) -> int:
    return int(array.ctypes.data)


def _view(address: int, count: int, kind: type) -> np.ndarray:
    """An array of CHOLMOD's, not copied."""
    return np.ctypeslib.as_array(ctypes.cast(address, POINTER(kind)), (count,))


def _vector(x: Array, columns: int = 1) -> Any:
    rows = x.size // columns
    return _Dense(
        nrow=rows, ncol=columns, nzmax=x.size, d=rows, x=_address(x), xtype=_REAL, dtype=0
    )


class Factor:
    """L of B = L Lᵀ, B symmetric positive definite, with some unknowns eliminated last.

    The fill-reducing order is that of constrained approximate minimum degree (Amestoy, Davis &
    Duff 2004, doi 10.1145/1024074.1024081), the factorisation the supernodal one of CHOLMOD
    (Chen, Davis, Hager & Rajamanickam 2008, doi 10.1145/1391989.1391995). Unknowns stand in that
    order, which `place` tells, in all that is asked for.

    Args:
        start, rows: Columns of the lower triangle of B, in any order within a column, shapes
            (n + 1,) and (entries,).
        last: How many unknowns, the last of B, are eliminated after all others.

    Attributes:
        place: Where unknowns of B stand in L, shape (n,).
        flops: Floating-point operations of a factorisation.
        entries: Entries of L.

    Raises:
        MemoryError: There is no memory for it, or more entries than 32-bit integers count.
    """

    def __init__(self, start: Integers, rows: Integers, last: int):
        library = _library()
        n = start.size - 1
        self._start, self._rows, self._last = start, rows, last
        self._matrix = _Sparse(
            nrow=n, ncol=n, nzmax=rows.size, p=_address(start), i=_address(rows),
            stype=_LOWER, xtype=0, sorted=0, packed=1,
        )  # fmt: skip
        self.place, self.flops, self.entries = np.empty(n, np.int32), 0.0, 0.0
        if n == 0:
            return
        late = np.zeros(n, np.int32)
        late[n - last :] = 1
        order = np.empty(n, np.int32)
        common = byref(library.common)
        library.c.cholmod_camd(
            byref(self._matrix), None, c_size_t(0),
            c_void_p(_address(late)), c_void_p(_address(order)), common,
        )  # fmt: skip
        library.check("camd")
        self._L = library.c.cholmod_analyze_p(
            byref(self._matrix), c_void_p(_address(order)), None, c_size_t(0), common
        )
        library.check("analyze_p")
        weakref.finalize(self, _free, self._L)
        self.flops, self.entries = float(library.common.fl), float(library.common.lnz)
        self.place[_view(self._L.contents.Perm, n, c_int)] = np.arange(n, dtype=np.int32)
        self._work = np.empty(max(self._L.contents.maxesize, 1))

    def factorise(self, values: Array) -> bool:
        """Make L of a matrix; returns whether it is positive definite.

        Args:
            values: Entries of the lower triangle, shape (entries,).

        Raises:
            MemoryError: There is no memory for it.
        """
        if self.place.size == 0:
            return True
        library, matrix = _library(), self._matrix
        values = np.ascontiguousarray(values)
        matrix.x, matrix.xtype = _address(values), _REAL
        library.c.cholmod_factorize(byref(matrix), self._L, byref(library.common))
        matrix.x, matrix.xtype = None, 0
        library.check("factorize")
        return library.common.status != _NOT_POSDEF and self._L.contents.minor == matrix.nrow

    def trailing(self) -> Array:
        """L between the last unknowns of B, in the order of their places, shape (last, last).

        An order of elimination that is equivalent by the elimination tree may put others between
        them, which changes no entry of L.
        """
        if self._last == 0:
            return np.zeros((0, 0))
        L, count = self._L.contents, self._last
        at = np.full(L.n, -1, np.int32)
        at[np.sort(self.place[L.n - count :])] = np.arange(count)
        first, rows_of, x_of = (
            _view(address, L.nsuper + 1, c_int) for address in (L.super, L.pi, L.px)
        )
        s, x = _view(L.s, L.ssize, c_int), _view(L.x, L.xsize, c_double)
        found = np.zeros((count, count))
        # the last column of a supernode is one of them if any is: their ancestors all are
        for k in np.flatnonzero(at[first[1:] - 1] >= 0):
            rows = at[s[rows_of[k] : rows_of[k + 1]]]
            columns = at[first[k] : first[k + 1]]
            block = x[x_of[k] : x_of[k] + rows.size * columns.size].reshape(columns.size, -1).T
            own = np.count_nonzero(columns < 0)
            found[np.ix_(rows[own:], columns[own:])] = block[own:, own:]
        return np.tril(found)

    def forward(self, x: Array) -> None:
        """Solve L y = x in place, shape (n,)."""
        self._sweep("cholmod_super_lsolve", x)

    def backward(self, x: Array) -> None:
        """Solve Lᵀ y = x in place, shape (n,)."""
        self._sweep("cholmod_super_ltsolve", x)

    def _sweep(self, name: str, x: Array) -> None:
        if self.place.size == 0:
            return
        library = _library()
        function = getattr(library.c, name)
        function(self._L, byref(_vector(x)), byref(_vector(self._work)), byref(library.common))
        library.check(name.removeprefix("cholmod_"))


def _free(L: Any) -> None:
    library = _library()
    library.c.cholmod_free_factor(byref(L), byref(library.common))
