"""Cholesky factors of a distributed matrix by substructures, one per rank."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm._platform.errors import call_together
from dolfinmpm.solve.cholmod import Factor, unavailable
from dolfinmpm.solve.separators import Interior, Separator

__all__ = ["Substructures", "set_cholesky", "why_not"]

Array = npt.NDArray[np.float64]

# S may take so many times the operations of a rank's L: measured on blocks of soil in 2D and 3D
# on two and three ranks, where MUMPS is faster from about three on.
_MOST_BETWEEN = 2.0

# How a factorisation ended on a rank; the worst counts
_DONE, _INDEFINITE, _NO_MEMORY = range(3)
_REASONS = {
    _DONE: PETSc.PC.FailedReason.NOERROR,
    _INDEFINITE: PETSc.PC.FailedReason.FACTOR_NUMERIC_ZEROPIVOT,
    _NO_MEMORY: PETSc.PC.FailedReason.FACTOR_OUTMEMORY,
}


def why_not(comm: MPI.Intracomm) -> str:
    """Why it cannot be on all ranks, or an empty text. Collective."""
    return max(comm.allgather(unavailable())) if comm.size > 1 else ""


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


class Substructures:
    """The inverse of a symmetric positive definite matrix, as PETSc's preconditioner "python".

    Unknowns G part those of the ranks, so that the interiors I_p are not coupled (George 1973,
    doi 10.1137/0710032; Smith, Bjørstad & Gropp 1996, "Domain decomposition", ch. 4). Each rank
    factorises its own

        B_p = (A_II, A_IG; A_GI, D) = L Lᵀ

    with G last. The diagonal D_i = √a_ii Σ_j |a_ij|/√a_jj over G makes B_p positive definite if A
    is, by Gershgorin's theorem, whatever the units of unknowns. The last block of L then has the
    rank's share in the Schur complement, L_GG L_GGᵀ = D − A_GI A_II⁻¹ A_IG, and

        S = A_GG − Σ_p A_GI A_II⁻¹ A_IG = A_GG + Σ_p (L_GG L_GGᵀ − D)

    is summed up and factorised as a dense matrix on every rank. A solution takes a sweep with L, a
    sum over the ranks, a solution with S, and a sweep with Lᵀ. It is exact: A is positive definite
    if and only if all A_II and S are.

    The symbolic factorisation is kept as long as the matrix has the same pattern.
    """

    def __init__(self) -> None:
        self._pattern: tuple[npt.NDArray, npt.NDArray] | None = None
        self._comm, self._ended = MPI.COMM_SELF, _INDEFINITE
        self.separator: Separator | None = None
        self._factor: Any = None
        self._last: Any = None
        self._S: Any = None

    def pays(self, A: PETSc.Mat) -> bool:
        """Whether this is likely to be the fastest way for a matrix; analyses it. Collective."""
        # one that has its pattern, but no entries yet, does not show it
        A.assemble()
        try:
            self._analyse(A, *A.getValuesCSR()[:2])
        except MemoryError:
            return False
        most = self._comm.allreduce(self._factor.flops, op=MPI.MAX)
        return self._separator.size**3 <= _MOST_BETWEEN * most

    # -- what PETSc calls -------------------------------------------------------------------

    def setUp(self, pc: PETSc.PC) -> None:
        """Factorise. Collective."""
        A = pc.getOperators()[1]
        start, columns, values = A.getValuesCSR()
        kept = self._pattern is not None and all(
            map(np.array_equal, self._pattern, (start, columns))
        )
        if not A.comm.tompi4py().allreduce(kept, op=MPI.LAND):
            self._analyse(A, start, columns)
        # as PETSc counts those of its own factors
        PETSc.Log.logFlops(self._factor.flops + self._separator.size**3 / 3)
        self._ended = self._factorise(values)
        pc.setFailedReason(_REASONS[self._ended])

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve A x = b; infinite, as of PETSc's own factors, without factors. Collective."""
        if self._ended == _DONE:
            PETSc.Log.logFlops(4.0 * self._factor.entries + 2.0 * self._separator.size**2)
            self._solve(b.getArray(readonly=True), x.getArray())
        else:
            x.set(np.inf)

    applyTranspose = apply

    def reset(self, pc: PETSc.PC) -> None:
        """Let go of the factors."""
        self._pattern = self.separator = None
        self._factor = self._last = self._S = None

    def view(self, pc: PETSc.PC, viewer: PETSc.Viewer) -> None:
        """Say what it is."""
        if self.separator is not None:
            viewer.printfASCII(f"    Cholesky by substructures, {self.separator.size} between\n")

    # -- the method -------------------------------------------------------------------------

    def _analyse(self, A: PETSc.Mat, start: npt.NDArray, columns: npt.NDArray) -> None:
        """Part the unknowns, and order those of this rank. Collective."""
        self._comm = A.comm.tompi4py()
        separator = self.separator = Separator.of(A, start, columns)

        def inside() -> tuple[Interior, Factor]:
            interior = Interior.of(separator, start, columns)
            return interior, Factor(interior.indptr, interior.indices, interior.late.size)

        interior, factor = call_together(self._comm, inside)
        self._interior, self._factor = interior, factor
        # gathering by indices of the machine's own size takes half the time
        place = factor.place.astype(np.intp)
        places, late = np.split(place, [interior.rows.size])
        # L's own order of those that come last
        order = np.argsort(late)
        self._late_places, self._late = late[order], interior.late[order]
        self._square = np.ix_(self._late, self._late)
        # L's unknowns, and then those between the ranks that are owned here; for each of L's the
        # owned row, or the place of a zero that follows these; for each owned row its place
        n = separator.high - separator.low
        self._x = np.zeros(place.size + separator.own_rows.size)
        self._from = np.full(place.size, n)
        self._from[places] = interior.rows
        self._to = np.empty(n, np.intp)
        self._to[interior.rows] = places
        self._to[separator.own_rows] = np.arange(place.size, self._x.size)
        self._b = np.zeros(n + 1)
        self._pattern = start, columns

    def _factorise(self, values: Array) -> int:
        """Make L, and the factors of S. Collective."""
        from scipy.linalg import lapack

        interior, count = self._interior, self._separator.size
        between, (row, column) = values[interior.between], interior.at
        d: Array = np.zeros(count)
        d[row[row == column]] = between[row == column]
        self._comm.Allreduce(MPI.IN_PLACE, d)
        if np.any(d <= 0.0):
            return _INDEFINITE
        d = np.sqrt(d)
        D = d * np.bincount(row, np.abs(between) / d[column], count)
        self._comm.Allreduce(MPI.IN_PLACE, D)
        ended = _DONE
        try:
            inner = values[interior.take], D[interior.late]
            if not self._factor.factorise(np.concatenate(inner)):
                ended = _INDEFINITE
        except MemoryError:
            ended = _NO_MEMORY
        S = np.zeros((count, count))
        S[row, column] = between
        if ended == _DONE:
            self._last = self._factor.trailing()
            S[self._square] += _product(self._last) - np.diag(D[self._late])
        ended = self._comm.allreduce(ended, op=MPI.MAX)
        if ended != _DONE or count == 0:
            return ended
        self._comm.Allreduce(MPI.IN_PLACE, S)
        # that of LAPACK's order of entries is the transpose, of a symmetric matrix
        self._S, info = lapack.dpotrf(S.T, lower=1, overwrite_a=1)
        # sums may differ by rounding from rank to rank
        return self._comm.allreduce(_INDEFINITE if info else _DONE, op=MPI.MAX)

    def _solve(self, b: Array, out: Array) -> None:
        """Entries of A⁻¹ b on this rank. Collective."""
        from scipy.linalg import lapack

        separator, count = self._separator, self._from.size
        x, between = np.split(self._x, [count])
        self._b[:-1] = b
        np.take(self._b, self._from, out=x, mode="clip")
        self._factor.forward(x)
        g = np.zeros(separator.size)
        g[self._late] = self._last @ x[self._late_places]
        g[separator.own] += b[separator.own_rows]
        if separator.size:
            self._comm.Allreduce(MPI.IN_PLACE, g)
            g = lapack.dpotrs(self._S, g, lower=1, overwrite_b=1)[0]
        x[self._late_places] = g[self._late] @ self._last
        self._factor.backward(x)
        between[:] = g[separator.own]
        np.take(self._x, self._to, out=out, mode="clip")

    @property
    def _separator(self) -> Separator:
        assert self.separator is not None
        return self.separator


def _product(L: Array) -> Array:
    """L Lᵀ of a lower triangle. LAPACK has that of an upper one, a third of the work."""
    from scipy.linalg import lapack

    if not L.size:
        return L
    # a copy, also of a matrix of one entry, which has every order already
    turned = np.array(L[::-1, ::-1], order="F")
    upper = np.triu(lapack.dlauum(turned, overwrite_c=1)[0])
    upper += np.triu(upper, 1).T
    return upper[::-1, ::-1]
