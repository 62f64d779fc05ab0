"""When a preconditioner is kept for the next tangent, by what it has cost and saved so far."""

from __future__ import annotations

import math
import time
import weakref
from collections.abc import Callable

from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["Reuse"]


class Reuse:
    """Keeps a preconditioner while that is cheaper than a new one.

    An old one costs more iterations, a new one its set-up. Both are measured: as soon as the
    last solution cost more than solutions with this preconditioner did on average, its set-up
    included, a new one is made. Costs are what a solution takes beyond one with a fresh
    preconditioner, which goes by digits gained, since solutions are not all asked to be as good.
    Where already the first solution with an old one did so, none is kept for a while, longer
    each time.

    Args:
        comm: Communicator of the problem.

    Attributes:
        iterations: Those that each solution took.
    """

    def __init__(self, comm: MPI.Intracomm):
        self._comm = comm
        self._setup = math.nan
        # seconds a digit of a fresh one; what the last solution cost, and all with the present one
        self._fresh = self._last = math.nan
        self._spent = 0.0
        self._old = False
        self._count = [0, 0]
        # solutions with the present one; set-ups until one is kept again, and then the next time
        self._age, self._wait, self._next = 0, 0, 1
        self.iterations: list[int] = []
        # seconds, solutions and iterations since `taken` was asked
        self._taken = [0.0, 0, 0]

    def taken(self) -> tuple[float, int, int]:
        """Seconds with set-ups, solutions and iterations since this was last asked."""
        seconds, solutions, iterations = self._taken
        self._taken = [0.0, 0, 0]
        return seconds, int(solutions), int(iterations)

    @property
    def old(self) -> bool:
        """Whether the preconditioner is that of a former tangent."""
        return self._old

    @property
    def counts(self) -> tuple[int, int]:
        """Solutions, and set-ups for them."""
        return self._count[0], self._count[1]

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
        keep = self._comm.bcast(bool(pays and self._wait == 0))
        if not keep:
            self._age, self._wait, self._spent = 0, max(self._wait - 1, 0), 0.0
        ksp.getPC().setReusePreconditioner(keep)
        self._old = keep
        started = time.perf_counter()
        if not keep and before is not None:
            before()
        ksp.setUp()
        if not keep:
            self._setup = self._slowest(time.perf_counter() - started)
            self._taken[0] += self._setup
            self._fresh = math.nan
            self._count[1] += 1

    def watch(self, ksp: PETSc.KSP) -> None:
        """Take note of all that a solver does from now on."""
        # a solver that kept what keeps the solver would never be freed
        weak, started, before = weakref.ref(self), 0.0, 0.0

        def begins(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
            nonlocal started, before
            started, before = time.perf_counter(), b.norm()

        def ends(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
            reuse = weak()
            if reuse is not None:
                reuse.note(ksp, time.perf_counter() - started, before)

        ksp.setPreSolve(begins)
        ksp.setPostSolve(ends)

    def note(self, ksp: PETSc.KSP, seconds: float, before: float) -> None:
        """Take what a solution took. Collective.

        Args:
            ksp: The solver.
            seconds: Its time on this rank.
            before: Norm of the right-hand side.
        """
        after = ksp.getResidualNorm()
        known = before > 0 and 0 < after < math.inf
        digits = max(math.log10(before / after), 0.1) if known else 0.1
        seconds = self._slowest(seconds)
        self._taken = [a + b for a, b in zip(self._taken, (seconds, 1, ksp.getIterationNumber()))]
        if not self._old:
            self._fresh = seconds / digits
        self._last = max(seconds - digits * self._fresh, 0.0)
        self._spent += self._last
        self._count[0] += 1
        self._age += 1
        self.iterations.append(ksp.getIterationNumber())

    def _slowest(self, seconds: float) -> float:
        return self._comm.allreduce(seconds, op=MPI.MAX)
