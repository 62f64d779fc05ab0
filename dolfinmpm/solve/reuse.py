"""When a preconditioner is kept for the next tangent, by what it has cost and saved so far."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable

from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.solve.costs import of_setup, of_solution

__all__ = ["Reuse"]


class Reuse:
    """HasState a preconditioner while that is cheaper than a new one.

    An old one costs more iterations, a new one its set-up. Both are counted, see
    `dolfinmpm.solve.costs`: as soon as the last solution cost more than solutions with this
    preconditioner did on average, its set-up included, a new one is made. Costs are what a solution
    takes beyond one with a fresh preconditioner, which goes by digits gained, since solutions are
    not all asked to be as good. Where already the first solution with an old one did so, none is
    kept for a while, longer each time.

    Args:
        comm: Communicator of the problem.

    Attributes:
        iterations: Those that each solution took.
        old: Whether the preconditioner is that of a former tangent.
        counts: Solutions, and set-ups for them.
    """

    def __init__(self, comm: MPI.Intracomm):
        self._comm = comm
        self._setup = math.nan
        # cost of a digit of a fresh one; what the last solution cost, and all with the present one
        self._fresh = self._last = math.nan
        self._spent = 0.0
        self.old, self.counts = False, (0, 0)
        # solutions with the present one; set-ups until one is kept again, and then the next time
        self._age, self._wait, self._next = 0, 0, 1
        self.iterations: list[int] = []
        # cost, solutions and iterations since `taken` was asked; flops when a solution begins
        self._taken, self._flops = (0.0, 0, 0), 0.0

    def taken(self) -> tuple[float, int, int]:
        """Cost with set-ups (ns), solutions and iterations since this was last asked."""
        taken, self._taken = self._taken, (0.0, 0, 0)
        return taken

    def renew(self) -> None:
        """Let the next one be new, whatever it costs."""
        self._last = math.inf

    def prepare(self, ksp: PETSc.KSP, before: Callable[[], None] | None = None) -> None:
        """Keep or renew the preconditioner of a solver whose matrix is new. Collective.

        Args:
            ksp: The solver.
            before: Called before a new one is made, or None.
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
            self._setup = self._add(of_setup(ksp.getPC(), self._flops - started))
            self._fresh = math.nan
            self.counts = self.counts[0], self.counts[1] + 1

    def watch(self, ksp: PETSc.KSP) -> None:
        """Take note of all that a solver does from now on."""
        # a solver that kept what keeps the solver would never be freed
        weak = weakref.ref(self)

        def ends(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
            reuse = weak()
            if reuse is not None:
                reuse.note(ksp)

        ksp.setConvergenceHistory(1000, reset=True)
        ksp.setPostSolve(ends)

    def note(self, ksp: PETSc.KSP) -> None:
        """Take what a solution took. Collective."""
        norms, iterations = ksp.getConvergenceHistory(), ksp.getIterationNumber()
        known = len(norms) > 1 and norms[0] > 0 and 0 < norms[-1] < math.inf
        digits = max(math.log10(norms[0] / norms[-1]), 0.1) if known else 0.1
        flops = PETSc.Log.getFlops()
        cost = self._add(of_solution(ksp.getPC(), flops - self._flops), iterations, 1)
        self._flops = flops
        if not self.old:
            self._fresh = cost / digits
        self._last = max(cost - digits * self._fresh, 0.0)
        self._spent += self._last
        self.counts = self.counts[0] + 1, self.counts[1]
        self._age += 1
        self.iterations.append(iterations)

    def _add(self, cost: float, iterations: int = 0, solutions: int = 0) -> float:
        """Add up a cost; returns the largest of all ranks, which others wait for. Collective."""
        cost = self._comm.allreduce(cost, op=MPI.MAX)
        taken = self._taken
        self._taken = taken[0] + cost, taken[1] + solutions, taken[2] + iterations
        return cost
