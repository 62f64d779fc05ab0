"""Which method solves next: by the tangent, by failures, and by costs so far."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from mpi4py import MPI

from dolfinmpm.solve.method import Method, Tangent, choose
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.reuse import Reuse
from dolfinmpm.solve.substructures import why_not

__all__ = ["MethodChoice", "SolverChoice"]

# Options by which a user chooses a method
_OF_METHOD = ("ksp_type", "pc_type", "pc_factor_mat_solver_type")

# Up to so many iterations per solution nothing else is tried
_FEW = 50
# Attachments of a matrix until the one that lost is tried again, at first and at most
_FIRST, _MOST = 8, 128


class SolverChoice:
    """Whether incomplete factors precondition, or a problem's other method solves.

    Incomplete factors cost next to nothing where inertia or a short way to the supports leaves a
    handful of iterations, and too many of those elsewhere. They come first. Where iterations are
    many the other method has a turn, and from then on the one that cost less a solution, its
    set-up included, is taken; the other one has another turn from time to time. What fails has
    lost, for longer each time.

    Attributes:
        incomplete: Whether incomplete factors are to precondition now.
    """

    def __init__(self) -> None:
        self.incomplete = True
        # ns per solution, see `dolfinmpm.solve.costs`, of incomplete factors and of the other
        # method
        self._cost = {True: math.nan, False: math.nan}
        # attachments until the other one has a turn, and the next time
        self._wait, self._next = 0, _FIRST

    def weigh(self, cost: float, iterations: float) -> None:
        """Take what solutions with the present one cost, and decide on the next ones.

        Args:
            cost: Their mean cost with all set-ups, the same on all ranks.
            iterations: Their mean number of iterations.
        """
        present = self.incomplete
        self._cost[present] = cost
        if present and iterations <= _FEW:
            return
        mine, other = self._cost[present], self._cost[not present]
        self._wait = max(self._wait - 1, 0)
        if mine > other:
            self.incomplete = not present
            self._wait, self._next = self._next, min(2 * self._next, _MOST)
        elif self._wait == 0:
            self.incomplete = not present
            # whatever it cost once, it is to cost less now
            self._cost[not present] = math.nan
            self._wait = self._next

    def failed(self) -> None:
        """Take that incomplete factors found no solution."""
        self.incomplete, self._cost[True] = False, math.inf
        self._wait, self._next = self._next, min(2 * self._next, _MOST)


@dataclass
class Doubt:
    """For how long a tangent that was not positive definite is not taken to be.

    Attributes:
        left: Attachments of a matrix until the end of the doubt.
        next: How many there will be the next time.
    """

    left: int = 0
    next: int = 4

    def grow(self) -> None:
        """Begin to doubt, for longer each time."""
        self.left, self.next = self.next, min(2 * self.next, 64)


class MethodChoice:
    """Chooses the method for a tangent, and another method where one has failed.

    Args:
        comm: Communicator of the problem.
        gdim: Dimension of space.
        tangent: What is known of the tangent.
        options: PETSc options.

    Attributes:
        tangent: What is known of the tangent.
        doubt: Whether the tangent is not taken to be positive definite.
        parts: Why several ranks do not factorise a substructure each; empty if they may.
    """

    def __init__(self, comm: MPI.Intracomm, gdim: int, tangent: Tangent, options: Options):
        self._gdim, self._ranks, self._options = gdim, comm.size, options
        self.tangent, self.doubt = tangent, Doubt()
        self.parts = why_not(comm)
        if options.mentions("mat_mumps_"):
            self.parts = "MUMPS has been given settings"
        # only factors are left, because iterations have failed
        self._direct = False
        self._incomplete = SolverChoice()

    @property
    def definite(self) -> bool:
        """Whether a symmetric tangent is taken to be positive definite now."""
        return self.tangent.definite and self.doubt.left == 0

    def method(self, count: int) -> Method:
        """The method for so many unknowns."""
        # what a user has chosen has no rival
        free = not any(self._options.has(name) for name in _OF_METHOD)
        found = choose(
            replace(self.tangent, definite=self.definite), count, self._gdim, self._ranks,
            self._direct, free and self._incomplete.incomplete, not self.parts,
        )  # fmt: skip
        if self._ranks > 1 and self.parts and self.definite and found.pc == "cholesky":
            return replace(found, why=f"{found.why}, not in substructures: {self.parts}")
        return found

    def weigh(self, reuse: Reuse) -> None:
        """Let the cost of the solutions so far decide on incomplete factors."""
        if self.tangent.symmetric or self.tangent.softened:
            return
        cost, solutions, iterations = reuse.taken()
        if solutions:
            self._incomplete.weigh(cost / solutions, iterations / solutions)

    def failed(self, method: Method, reuse: Reuse | None) -> bool:
        """Take that a method has failed; returns whether there is another one."""
        if self.tangent.symmetric and self.definite:
            self.doubt.grow()
        elif method.incomplete:
            self._incomplete.failed()
            if reuse is not None:
                # the cost of incomplete factors is not that of the other method
                reuse.taken()
        elif not method.factors:
            self._direct = True
        else:
            return False
        return True
