"""Choice of the linear solver, by the tangent, by failures and by costs so far."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from mpi4py import MPI

from dolfinmpm.solve.method import Method, Tangent, choose, crossover
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.preconditionerreuse import PreconditionerReuse
from dolfinmpm.solve.substructures import why_not

__all__ = ["IncompleteFactorsChoice", "MethodChoice"]

# Options by which a user chooses a method
_OF_METHOD = ("ksp_type", "pc_type", "pc_factor_mat_solver_type")

# Up to this number of iterations per solution, the other method is not tried
_FEW = 50
# Number of attached matrices before the other method is tried again, at first and at most
_FIRST, _MOST = 8, 128
# Cost of the other method before incomplete factors that failed are tried again, in costs of the
# failure, at most; at first it is one. So failures cost at most as much as the other method.
_MOST_OF_FAILURE = 64.0


class IncompleteFactorsChoice:
    """Choice between incomplete factors as preconditioner and the problem's other method.

    Incomplete factors are cheap if inertia or near supports make iterations few. Otherwise
    iterations are too many. Incomplete factors are tried first. After many iterations, the other
    method is tried. From then on the method with the smaller cost per solution is taken, set-up
    included. The other method is tried again from time to time. Incomplete factors that fail are
    left out until the other method has cost as much as the failure, or a multiple of that, which
    doubles with each failure. One failure may be that of a first step, whose stencils are narrow.

    Attributes:
        incomplete: Whether incomplete factors precondition at present.
    """

    def __init__(self) -> None:
        self.incomplete = True
        # cost per solution (ns), of incomplete factors and of the other method
        self._cost = {True: math.nan, False: math.nan}
        # attached matrices before the other method is tried, now and the next time
        self._wait, self._next = 0, _FIRST
        # cost of the other method (ns) before incomplete factors that failed are tried again, and
        # the multiple of the next failure's cost
        self._left, self._multiple = 0.0, 1.0

    def weigh(self, cost: float, solutions: int, iterations: int) -> None:
        """Choose the method by the cost of the last solutions.

        Args:
            cost: Cost of the solutions with all set-ups (ns), the same on all ranks.
            solutions: Number of solutions.
            iterations: Number of their iterations.
        """
        present = self.incomplete
        self._cost[present] = cost / solutions
        if present and iterations <= _FEW * solutions:
            self._multiple = 1.0
            return
        if math.isinf(self._cost[True]):
            self._left -= cost
            if self._left <= 0.0:
                self.incomplete, self._cost[True] = True, math.nan
            return
        mine, other = self._cost[present], self._cost[not present]
        self._wait = max(self._wait - 1, 0)
        if mine > other:
            self.incomplete = not present
            self._wait, self._next = self._next, min(2 * self._next, _MOST)
        elif self._wait == 0:
            self.incomplete = not present
            # its old cost does not count any more
            self._cost[not present] = math.nan
            self._wait = self._next

    def failed(self, cost: float) -> None:
        """Leave incomplete factors out after a failure.

        Args:
            cost: Cost of the solutions with all set-ups since the last choice (ns).
        """
        self.incomplete, self._cost[True] = False, math.inf
        self._left = self._multiple * cost
        self._multiple = min(2.0 * self._multiple, _MOST_OF_FAILURE)


@dataclass
class Doubt:
    """Time for which a method is not tried, after it has failed. It is longer each time.

    Attributes:
        left: Attached matrices until the end of this time.
        next: Length of the next such time.
    """

    left: int = 0
    next: int = 4

    def grow(self) -> None:
        """Begin such a time, longer each time."""
        self.left, self.next = self.next, min(2 * self.next, 64)


class MethodChoice:
    """Choice of the method for a tangent, and of another method after a failure.

    Args:
        comm: Communicator of the problem.
        gdim: Dimension of space.
        tangent: Known properties of the tangent.
        options: PETSc options.

    Attributes:
        tangent: The argument.
        doubt: Time for which the tangent counts as indefinite.
        no_iterations: Time for which only factors solve, after iterations have failed.
        no_substructures: Reason against one substructure per rank, or an empty string.
        no_incomplete: Whether incomplete factors are left out.
        blocks_from: Number of unknowns from which the method needs those of a node in a block.
    """

    def __init__(self, comm: MPI.Intracomm, gdim: int, tangent: Tangent, options: Options):
        self._gdim, self._ranks, self._options = gdim, comm.size, options
        pc = options.get("pc_type")
        if pc not in (None, "mg"):
            # another multigrid by options has its own levels
            tangent = replace(tangent, degree=0)
        self.blocks_from: float = 0 if pc in ("gamg", "hypre", "mg", "ml") else math.inf
        if pc is None:
            self.blocks_from = crossover(tangent, gdim)
        self.tangent, self.doubt, self.no_incomplete = tangent, Doubt(), False
        self.no_iterations = Doubt()
        self.no_substructures = why_not(comm)
        if options.mentions("mat_mumps_"):
            self.no_substructures = "the options set MUMPS"
        self._incomplete = IncompleteFactorsChoice()

    @property
    def definite(self) -> bool:
        """Whether a symmetric tangent counts as positive definite at present."""
        return self.tangent.definite and self.doubt.left == 0

    def attached(self) -> None:
        """Count another matrix."""
        for doubt in self.doubt, self.no_iterations:
            doubt.left = max(doubt.left - 1, 0)

    def method(self, count: int) -> Method:
        """The method for a number of unknowns."""
        # the user's choice is not changed
        free = self._options.names.isdisjoint(_OF_METHOD)
        incomplete = free and self._incomplete.incomplete and not self.no_incomplete
        found = choose(
            replace(self.tangent, definite=self.definite), count, self._gdim, self._ranks,
            self.no_iterations.left > 0, incomplete, not self.no_substructures,
        )  # fmt: skip
        if self._ranks > 1 and self.no_substructures and self.definite and found.pc == "cholesky":
            why = f"{found.why}, not in substructures: {self.no_substructures}"
            return replace(found, why=why)
        return found

    def weigh(self, reuse: PreconditionerReuse) -> None:
        """Choose for or against incomplete factors, by the cost of the solutions so far."""
        if self.tangent.symmetric or self.tangent.softened:
            return
        cost, solutions, iterations = reuse.taken()
        if solutions:
            self._incomplete.weigh(cost, solutions, iterations)

    def failed(self, method: Method, reuse: PreconditionerReuse | None) -> bool:
        """Leave a method out after a failure; returns whether another method is left."""
        if self.tangent.symmetric and self.definite:
            self.doubt.grow()
        elif method.incomplete:
            # this cost must not count for the other method
            self._incomplete.failed(reuse.taken()[0] if reuse is not None else 0.0)
        elif not method.factors:
            self.no_iterations.grow()
        else:
            return False
        return True
