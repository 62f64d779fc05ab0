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

# S may take so many times the operations of a rank's L: measured on blocks of soil in 2D and 3D
# on two and three ranks. MUMPS is faster from about three times on.
_MOST_BETWEEN = 2.0

# of how a factorisation ended; the worst end of all ranks counts
_REASONS = {
    DONE: PETSc.PC.FailedReason.NOERROR,
    INDEFINITE: PETSc.PC.FailedReason.FACTOR_NUMERIC_ZEROPIVOT,
    NO_MEMORY: PETSc.PC.FailedReason.FACTOR_OUTMEMORY,
}


def why_not(comm: MPI.Intracomm) -> str:
    """Why substructures cannot be on all ranks, or an empty text. Collective."""
    if comm.size == 1:
        return ""
    # the first rank compiles for all that share a cache
    first = comm.bcast(unavailable() if comm.rank == 0 else None)
    return first or max(comm.allgather(unavailable()))


def set_cholesky(pc: PETSc.PC, A: PETSc.Mat) -> None:
    """Let a preconditioner be a positive definite matrix's factors, as is fastest. Collective."""
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

    Unknowns G part those of the ranks, so that the interiors I_p are not coupled (George 1973,
    doi 10.1137/0710032; Smith, Bjørstad & Gropp 1996, "Domain decomposition", ch. 4). Each rank
    factorises its own part of A, with the unknowns G_p of G last that I_p couples to:

        B_p = (A_II, A_IG; A_GI, A_GG) = L Lᵀ.

    The last block of L holds the rank's Schur complement, L_GG L_GGᵀ = A_GG − A_GI A_II⁻¹ A_IG, and

        S = A_GG + Σ_p (L_GG L_GGᵀ − A_GG of G_p)

    is summed up and factorised as a dense matrix on every rank. A solution takes a sweep with L, a
    sum over the ranks, a solution with S, and a sweep with Lᵀ. The solution is exact: A is positive
    definite if and only if all B_p and S are.

    The symbolic factorisation is kept as long as the matrix has the same pattern. On a column of
    64 x 256 cells and two ranks MUMPS takes 1.2 to 1.4 times as long per step, and additive
    Schwarz with conjugate gradients twice as long.
    """

    def __init__(self) -> None:
        self._comm, self._ended = MPI.COMM_SELF, INDEFINITE
        self._pattern: tuple[npt.NDArray, ...] | None = None
        self._parts: Any = None
        self._factor: Any = None
        self._S: Any = None

    def pays(self, A: PETSc.Mat) -> bool:
        """Whether substructures are likely to be fastest for a matrix; analyses it. Collective."""
        # a matrix that has its pattern, but no entries yet, does not show the pattern
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
        # as PETSc counts those of its own factors
        PETSc.Log.logFlops(self._factor.flops + self._between.size**3 / 3)
        self._ended = self._factorise(A)
        pc.setFailedReason(_REASONS[self._ended])

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve A x = b; infinite, as of PETSc's own factors, without factors. Collective."""
        if self._ended == DONE:
            PETSc.Log.logFlops(4.0 * self._factor.entries + 2.0 * self._between.size**2)
            self._solve(b.getArray(readonly=True), x.getArray())
        else:
            x.set(np.inf)

    applyTranspose = apply

    def reset(self, pc: PETSc.PC) -> None:
        """Let go of the factors."""
        self._pattern = self._factor = self._S = self._parts = None

    def view(self, pc: PETSc.PC, viewer: PETSc.Viewer) -> None:
        """Say what it is."""
        if self._pattern is not None:
            viewer.printfASCII(f"    Cholesky by substructures, {self._between.size} between\n")

    # -- the method -------------------------------------------------------------------------

    def _analyse(self, A: PETSc.Mat, start: npt.NDArray, columns: npt.NDArray) -> None:
        """Part the unknowns, and order those of this rank. Collective."""
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
        # the places of own rows among L's, and G's of those that L has last
        self._places = np.empty(np.count_nonzero(self._inner), np.intp)
        first = np.isin(placed, near, invert=True)
        self._places[np.searchsorted(own[self._inner], placed[first])] = np.flatnonzero(first)
        self._late = np.searchsorted(G, placed[factor.late])

    def _factorise(self, A: PETSc.Mat) -> int:
        """Make L, and the factors of S. Collective."""
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
    """Global rows without which those of different ranks are not coupled, increasing. Collective.

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
    # of each pair of ranks the first one decides: the fewer of the two sides
    for other in range(comm.rank + 1, comm.size):
        sides = (np.unique(one[owner == other]) for one in (rows, columns))
        found.append(min(sides, key=len))
    between = np.unique(np.concatenate(comm.allgather(np.concatenate(found))))
    coupled = (owner != comm.rank) & ~np.isin(rows, between) & ~np.isin(columns, between)
    if comm.allreduce(bool(coupled.any()), op=MPI.LOR):
        raise RuntimeError("substructures need a matrix whose pattern is symmetric")
    return between
