"""Cholesky factors of a distributed matrix by substructures, one per rank."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm._platform.errors import call_together
from dolfinmpm.solve.cholmod import DONE, INDEFINITE, NO_MEMORY, Factor, unavailable
from dolfinmpm.solve.mumps import WORKSPACE

__all__ = ["Substructures", "set_cholesky", "why_not"]

Array = npt.NDArray[np.float64]

# Largest operations for S, as a multiple of those for a rank's L; measured on blocks of soil in 2D
# and 3D on two and three ranks. From a multiple of about three, MUMPS is faster.
_MOST_BETWEEN = 2.0

# PETSc's reasons by the result of a factorisation; the worst result of all ranks counts
_REASONS = {
    DONE: PETSc.PC.FailedReason.NOERROR,
    INDEFINITE: PETSc.PC.FailedReason.FACTOR_NUMERIC_ZEROPIVOT,
    NO_MEMORY: PETSc.PC.FailedReason.FACTOR_OUTMEMORY,
}


def why_not(comm: MPI.Intracomm) -> str:
    """Reason against substructures on all ranks, or an empty text. Collective."""
    if comm.size == 1:
        return ""
    # the first rank compiles for all ranks that share a cache
    first = comm.bcast(unavailable() if comm.rank == 0 else None)
    return first or max(comm.allgather(unavailable()))


def set_cholesky(pc: PETSc.PC, A: PETSc.Mat) -> None:
    """Set the fastest factors of a positive definite matrix as preconditioner. Collective."""
    A.setOption(PETSc.Mat.Option.SPD, True)
    comm = A.comm.tompi4py()
    if comm.size > 1 and not why_not(comm):
        made = Substructures()
        if made.pays(A):
            pc.setType("python")
            pc.setPythonContext(made)
            return
    pc.setType("cholesky")
    pc.setFactorSolverType("cholmod" if comm.size == 1 else "mumps")
    if comm.size > 1 and A.getSize()[0]:
        # MUMPS's forecast of its workspace is too small for some matrices on several ranks
        pc.setOperators(A)
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(WORKSPACE, 100)


class Substructures:
    """The inverse of a symmetric positive definite matrix, as PETSc's preconditioner "python".

    Unknowns G separate the ranks: their interiors I_p are not coupled (George 1973, doi
    10.1137/0710032; Smith, Bjørstad & Gropp 1996, "Domain decomposition", ch. 4). Each rank
    factorises its own part of A. The unknowns G_p of G that are coupled to I_p come last:

        B_p = (A_II, A_IG; A_GI, A_GG) = L Lᵀ.

    The last block of L holds the rank's Schur complement, L_GG L_GGᵀ = A_GG − A_GI A_II⁻¹ A_IG, and

        S = A_GG + Σ_p (L_GG L_GGᵀ − A_GG of G_p)

    is summed up and factorised as a dense matrix on every rank. A solution consists of a sweep with
    L, a sum over the ranks, a solution with S, and a sweep with Lᵀ. The solution is exact. A is
    positive definite if and only if all B_p and S are.

    The symbolic factorisation is kept as long as the pattern stays. On a column of 64 x 256 cells
    and two ranks, MUMPS takes 1.2 to 1.4 times as long per step. Additive Schwarz with conjugate
    gradients takes twice as long.
    """

    def __init__(self) -> None:
        self._comm, self._ended = MPI.COMM_SELF, INDEFINITE
        self._pattern: tuple[npt.NDArray, ...] | None = None
        self._parts: Any = None
        self._factor: Any = None
        self._S: Any = None

    def pays(self, A: PETSc.Mat) -> bool:
        """Whether substructures are probably fastest for a matrix; analyses it. Collective."""
        # PETSc shows a pattern only after assembly
        A.assemble()
        try:
            self._analyse(A, *A.getValuesCSR()[:2])
        except MemoryError:
            return False
        most = self._comm.allreduce(self._factor.flops, op=MPI.MAX)
        return self._between.size**3 <= _MOST_BETWEEN * most

    # -- what PETSc calls -------------------------------------------------------------------

    def setUp(self, pc: PETSc.PC) -> None:
        """Factorise. Collective."""
        A = pc.getOperators()[1]
        pattern = A.getValuesCSR()[:2]
        kept = self._pattern is not None and all(map(np.array_equal, self._pattern, pattern))
        if not A.comm.tompi4py().allreduce(kept, op=MPI.LAND):
            self._analyse(A, *pattern)
        # PETSc counts the flops of its own factors in the same way
        PETSc.Log.logFlops(self._factor.flops + self._between.size**3 / 3)
        self._ended = self._factorise(A)
        pc.setFailedReason(_REASONS[self._ended])

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve A x = b. Without factors x is infinite, as with PETSc's factors. Collective."""
        if self._ended == DONE:
            PETSc.Log.logFlops(4.0 * self._factor.entries + 2.0 * self._between.size**2)
            self._solve(b.getArray(readonly=True), x.getArray())
        else:
            x.set(np.inf)

    applyTranspose = apply

    def reset(self, pc: PETSc.PC) -> None:
        """Release the factors."""
        self._pattern = self._factor = self._S = self._parts = None

    def view(self, pc: PETSc.PC, viewer: PETSc.Viewer) -> None:
        """Print a description."""
        if self._pattern is not None:
            viewer.printfASCII(f"    Cholesky by substructures, {self._between.size} between\n")

    # -- the method -------------------------------------------------------------------------

    def _analyse(self, A: PETSc.Mat, start: npt.NDArray, columns: npt.NDArray) -> None:
        """Separate the unknowns of the ranks, and order this rank's unknowns. Collective."""
        comm = self._comm = A.comm.tompi4py()
        low, high = A.getOwnershipRange()
        G = self._between = _separator(A, start, columns)
        own = np.arange(low, high, dtype=G.dtype)
        self._inner, self._own = np.isin(own, G, invert=True), np.isin(G, own)
        of_inner = columns[np.repeat(self._inner, np.diff(start))]
        near = np.intersect1d(of_inner, G)
        rows = np.union1d(own[self._inner], near)
        self._where = [PETSc.IS().createGeneral(part, PETSc.COMM_SELF) for part in (rows, G)]
        self._parts = A.createSubMatrices(self._where, self._where)
        B, late = self._parts[0].getValuesCSR(), np.isin(rows, near)
        factor = self._factor = call_together(comm, lambda: Factor(B[0], B[1], late))
        self._pattern = start, columns
        placed = rows[factor.order]
        # places of this rank's rows in L, and places in G of the last rows of L
        self._places = np.empty(np.count_nonzero(self._inner), np.intp)
        first = np.isin(placed, near, invert=True)
        self._places[np.searchsorted(own[self._inner], placed[first])] = np.flatnonzero(first)
        self._late = np.searchsorted(G, placed[factor.late])

    def _factorise(self, A: PETSc.Mat) -> int:
        """Factorise B and S. Collective."""
        from scipy.linalg import lapack

        A.createSubMatrices(self._where, self._where, submats=self._parts)
        B, A_GG = self._parts
        size = self._between.size
        every = np.arange(size, dtype=PETSc.IntType)
        whole = A_GG.getValues(every, every)
        ended = self._factor.factorise(B.getValuesCSR()[2])
        S = np.zeros((size, size))
        if ended == DONE:
            self._last = self._factor.trailing()
            square = np.ix_(self._late, self._late)
            S[square] = self._last @ self._last.T - whole[square]
        ended = self._comm.allreduce(ended, op=MPI.MAX)
        if ended != DONE or size == 0:
            return ended
        self._comm.Allreduce(MPI.IN_PLACE, S)
        self._S, info = lapack.dpotrf(S + whole, lower=1)
        # sums may differ by rounding from rank to rank
        return self._comm.allreduce(INDEFINITE if info else DONE, op=MPI.MAX)

    def _solve(self, b: Array, out: Array) -> None:
        """Entries of A⁻¹ b on this rank. Collective."""
        from scipy.linalg import lapack

        x, g = np.zeros(self._factor.order.size), np.zeros(self._between.size)
        late = self._factor.late
        x[self._places] = b[self._inner]
        self._factor.sweep(x)
        g[self._own] = b[~self._inner]
        if g.size:
            g[self._late] += self._last @ x[late]
            self._comm.Allreduce(MPI.IN_PLACE, g)
            g = lapack.dpotrs(self._S, g, lower=1, overwrite_b=1)[0]
        x[late] = g[self._late] @ self._last
        self._factor.sweep(x, back=True)
        out[self._inner], out[~self._inner] = x[self._places], g[self._own]


def _separator(A: PETSc.Mat, start: npt.NDArray, columns: npt.NDArray) -> npt.NDArray:
    """Global rows that separate the rows of different ranks, increasing. Collective.

    Args:
        A: A matrix with a symmetric pattern.
        start, columns: First entries of its rows on this rank, and their global columns.

    Raises:
        RuntimeError: The pattern is not symmetric.
    """
    comm, ends, low = A.comm.tompi4py(), A.getOwnershipRanges(), A.getOwnershipRange()[0]
    rows = np.repeat(np.arange(low, low + start.size - 1, dtype=columns.dtype), np.diff(start))
    owner = np.searchsorted(ends, columns, side="right") - 1
    found = [columns[:0]]
    # per pair of ranks, the rank with the smaller number decides: it takes the smaller side
    for other in range(comm.rank + 1, comm.size):
        sides = (np.unique(one[owner == other]) for one in (rows, columns))
        found.append(min(sides, key=len))
    between = np.unique(np.concatenate(comm.allgather(np.concatenate(found))))
    coupled = (owner != comm.rank) & ~np.isin(rows, between) & ~np.isin(columns, between)
    if comm.allreduce(bool(coupled.any()), op=MPI.LOR):
        raise RuntimeError("substructures need a matrix whose pattern is symmetric")
    return between
