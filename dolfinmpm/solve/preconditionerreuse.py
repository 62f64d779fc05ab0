"""When a preconditioner is kept for the next tangent, by counted costs."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable

from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["PreconditionerReuse", "setup_cost", "solution_cost"]

# Per preconditioner: nanoseconds per flop of a solution, per flop of a set-up, and per entry of the
# preconditioner. Fitted once, on one core of an AMD EPYC with PETSc 3.22, to problems of
# `demos/studies` with 2,500 to 30,000 unknowns: elastic blocks and slopes in 3D (`solid_3d.py`),
# sand (`benchmark.py --plastic 80`) and columns in 2D, linear functions to quadratic splines. Only
# ratios matter. Flops are cheap in dense blocks of factors; other work grows with the entries.
_NANOSECONDS = {
    "ilu": (0.27, 0.25, 3.0),
    "bjacobi": (0.27, 0.25, 3.0),
    "lu": (0.55, 0.02, 10.0),
    "cholesky": (0.38, 0.04, 11.0),
    # substructures: PETSc counts the entries of the matrix, not those of the factors
    "python": (0.38, 0.04, 60.0),
}
# multigrid of all kinds, and the user's choice
_OTHERWISE = (0.6, 1.0, 40.0)

# Cost beyond that with a fresh preconditioner at which a solution ends, in set-ups
_ENDS_AT = 2.0

# Half the number of set-ups before a preconditioner is kept again, after one has failed
_FRESH_ONES = 16


def solution_cost(pc: PETSc.PC, flops: float) -> float:
    """Cost of a solution on one rank (ns).

    Args:
        pc: The preconditioner.
        flops: Flops counted by PETSc on this rank.
    """
    return _NANOSECONDS.get(pc.getType(), _OTHERWISE)[0] * flops


def setup_cost(pc: PETSc.PC, flops: float) -> float:
    """Cost of a set-up on one rank (ns).

    Args:
        pc: The preconditioner.
        flops: Flops counted by PETSc on this rank.
    """
    kind, A = pc.getType(), pc.getOperators()[1]
    _, a_flop, an_entry = _NANOSECONDS.get(kind, _OTHERWISE)
    if kind in ("lu", "cholesky") and pc.getFactorSolverType() in ("mumps", "cholmod", "petsc"):
        A = pc.getFactorMatrix()
        if pc.getFactorSolverType() == "mumps":
            # PETSc does not count MUMPS's flops: this is MUMPS's own estimate for all ranks
            flops += A.getMumpsRinfog(1) / A.comm.size
    entries = A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] / A.comm.size
    return a_flop * flops + an_entry * entries


class PreconditionerReuse:
    """Keeps a preconditioner as long as it is cheaper than a new one.

    An old preconditioner costs iterations, a new one costs a set-up. Both costs follow from counted
    flops, never from a clock, so that runs repeat. A new preconditioner is made as soon as the last
    solution cost more than the mean with this preconditioner, set-up included. The cost of a
    solution counts only beyond the cost with a fresh preconditioner, per digit of the residual,
    because solutions need different numbers of digits. If the first solution with an old
    preconditioner is too expensive already, none is kept for some time, longer each time.

    Args:
        comm: Communicator of the problem.

    Attributes:
        iterations: Iterations of each solution.
        old: Whether the preconditioner belongs to a former tangent.
        counts: Number of solutions, and of set-ups.
        rests: Whether solutions do not count at present.
    """

    def __init__(self, comm: MPI.Intracomm):
        self._comm = comm
        self._setup = math.nan
        # cost per digit when fresh; extra cost of the last solution, and of all with the present
        # preconditioner
        self._fresh = self._last = math.nan
        # cost of an iteration when fresh
        self._each = math.nan
        self._spent = 0.0
        self.old, self.counts, self.rests = False, (0, 0), False
        # solutions with the present preconditioner; set-ups before one is kept again, now and the
        # next time
        self._age, self._wait, self._next = 0, 0, 1
        self.iterations: list[int] = []
        # cost, solutions and iterations since the last call of `taken`; flops before a solution
        self._taken, self._flops = (0.0, 0, 0), 0.0

    def taken(self) -> tuple[float, int, int]:
        """Cost with set-ups (ns), solutions and iterations since the last call."""
        taken, self._taken = self._taken, (0.0, 0, 0)
        return taken

    def renew(self) -> None:
        """Make a new preconditioner next, at any cost."""
        self._last = math.inf

    def distrust(self) -> None:
        """Make new preconditioners for some time, because iterations with an old one failed.

        Newton's method goes on from there, and would soon fail in the same way if it kept the first
        new preconditioner.
        """
        self.renew()
        self._next = min(2 * max(self._next, _FRESH_ONES), 8 * _FRESH_ONES)
        self._wait = self._next

    def prepare(self, ksp: PETSc.KSP, before: Callable[[], None] | None = None) -> None:
        """Keep or renew the preconditioner of a solver with a new matrix. Collective.

        Args:
            ksp: The solver.
            before: Function that is called before a new preconditioner is made, or None.
        """
        pays = self._last * self._age < self._setup + self._spent
        if not pays and self._age == 2 and math.isfinite(self._last):
            self._wait, self._next = self._next, min(2 * self._next, 32)
        elif not pays and self._age > 2:
            self._next = 1
        self.old = keep = self._comm.bcast(bool(pays and self._wait == 0))
        ksp.getPC().setReusePreconditioner(keep)
        started = PETSc.Log.getFlops()
        if not keep and before is not None:
            before()
        ksp.setUp()
        self._flops = PETSc.Log.getFlops()
        if not keep:
            self._age, self._wait, self._spent = 0, max(self._wait - 1, 0), 0.0
            self._setup = self._add(setup_cost(ksp.getPC(), self._flops - started))
            self._fresh = math.nan
            self.counts = self.counts[0], self.counts[1] + 1

    def most(self, share: float, otherwise: int) -> int:
        """Number of iterations at which a solution with the present preconditioner ends.

        Args:
            share: Relative residual at which the solution may end.
            otherwise: Number with a fresh preconditioner, and the largest one.
        """
        if not (self.old and self._each > 0.0):
            return otherwise
        cost = self._fresh * -math.log10(share) + _ENDS_AT * self._setup
        return min(math.ceil(cost / self._each), otherwise)

    def watch(self, ksp: PETSc.KSP) -> None:
        """Count the cost of all later solutions of a solver."""
        # a strong reference from the solver to its owner would keep both in memory for ever
        weak = weakref.ref(self)

        def ends(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
            reuse = weak()
            if reuse is not None and not reuse.rests:
                reuse.note(ksp)

        ksp.setConvergenceHistory(1000, reset=True)
        ksp.setPostSolve(ends)

    def note(self, ksp: PETSc.KSP) -> None:
        """Add the cost of a solution. Collective."""
        norms, iterations = ksp.getConvergenceHistory(), ksp.getIterationNumber()
        known = len(norms) > 1 and norms[0] > 0 and 0 < norms[-1] < math.inf
        digits = max(math.log10(norms[0] / norms[-1]), 0.1) if known else 0.1
        flops = PETSc.Log.getFlops()
        cost = self._add(solution_cost(ksp.getPC(), flops - self._flops), iterations, 1)
        self._flops = flops
        if not self.old:
            self._fresh, self._each = cost / digits, cost / max(iterations, 1)
        self._last = max(cost - digits * self._fresh, 0.0)
        self._spent += self._last
        self.counts = self.counts[0] + 1, self.counts[1]
        self._age += 1
        self.iterations.append(iterations)
        if self.old and iterations >= ksp.getTolerances()[3]:
            # with factors, PETSc calls this solution converged
            self.renew()
            if ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
                # see `most`
                ksp.setConvergedReason(PETSc.KSP.ConvergedReason.CONVERGED_ITS)

    def _add(self, cost: float, iterations: int = 0, solutions: int = 0) -> float:
        """Add a cost; returns the largest of all ranks, for which the others wait. Collective."""
        cost = self._comm.allreduce(cost, op=MPI.MAX)
        taken = self._taken
        self._taken = taken[0] + cost, taken[1] + solutions, taken[2] + iterations
        return cost
