"""A distributed matrix whose rows all ranks add to: PETSc's assembly by coordinates."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["OwnedRows"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]

# PETSc's own functions: petsc4py 3.22 has no names for assembly by coordinates
_PETSC = ctypes.CDLL(PETSc.__file__)


class OwnedRows:
    """Rows of a distributed matrix, with the entries that any rank has for them.

    PETSc finds once per pattern where each entry goes (`MatSetPreallocationCOO`).

    Args:
        comm: Communicator.
        start, columns: First entries of the rows that this rank has, in increasing order of its own
            numbers, and their columns, likewise.
        number: Global number of every row and column known here.
        owned: How many rows this rank owns; rows are numbered rank by rank.
        size: Rows of the matrix.

    Attributes:
        petsc: The matrix.
    """

    def __init__(
        self, comm: MPI.Intracomm, start: Integers, columns: Integers, number: Integers,
        owned: int, size: int,
    ):  # fmt: skip
        number = number.astype(PETSc.IntType)
        self.petsc: Any = PETSc.Mat().create(comm)
        self.petsc.setSizes(((owned, size), (owned, size)))
        self.petsc.setType("aij")
        rows, others = np.repeat(number, np.diff(start)), number[columns]
        self._call(
            "MatSetPreallocationCOO", ctypes.c_ssize_t(rows.size), _address(rows), _address(others)
        )

    def put(self, data: Array) -> None:
        """Give the matrix its values. Collective.

        Args:
            data: This rank's entries, shape (entries,).
        """
        self._call("MatSetValuesCOO", _address(data), int(PETSc.InsertMode.INSERT_VALUES))

    def _call(self, name: str, *arguments: Any) -> None:
        ended = getattr(_PETSC, name)(ctypes.c_void_p(self.petsc.handle), *arguments)
        if ended:
            raise PETSc.Error(ended)


def _address(array: npt.NDArray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
