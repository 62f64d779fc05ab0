"""The tangent at a solution of a run, by which other runs follow it.

Newton's method ends with the tangent and the preconditioner of its last iteration. They are lent to
the runs that follow, as long as the run itself takes no further step. They differ from those at the
solution by the last increment of the iteration, and a second solution corrects for it. Where many
runs follow, the tangent at the solution is assembled for them, in a matrix of its own. The first
run that follows assembles it where Newton's method has gone on to another solution in the step.

Iterations begin in the span of known solutions: the increments of the run, and the changes by which
other runs follow it, in this step and in the last one. Only what these leave is solved for, so that
a change by one parameter that is a combination of others, such as stiffness and weight, takes their
digits along.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm._platform.errors import ConvergenceError
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.solve.linearsolver import LinearSolver
from dolfinmpm.solve.operator import Operator

__all__ = ["ACCURATE", "CONTRACTS", "MOST", "NOISE", "ROUNDING", "SpareSolver", "TapedTangent"]

Array = npt.NDArray[np.float64]

# Runs from which the tangent at the solution is assembled for them: with incomplete factors, by
# dimension, because complete ones are cheaper then, and with all other preconditioners
_MANY_INCOMPLETE, _MANY = {1: 1, 2: 2, 3: 3}, 8
# Out-of-balance force that may remain, as a share of what the perturbation makes: in general, and
# in columns of additional equations. And its rounding, as a share of the loads
DIGITS, ACCURATE, ROUNDING = 1e-7, 1e-10, 1e-15
# What multigrid may leave of it: it leaves short waves, which are large in forces and small in
# increments. These are then exact to some 1e-8.
_MULTIGRID, _LEVELS = ("mg", "gamg"), 1e-6
# Share that the first solution leaves, and the largest one with which a lent tangent is good enough
_FIRST, _SLOW = 1e-5, 1e-2
# What may remain after solutions with the tangent at the solution, as a multiple of what they leave
# and of rounding; the largest share at which another solution with it helps, and how many may
_ABOVE, NOISE, CONTRACTS, MOST = 3.5, 30.0, 0.7, 30


@dataclass
class SpareSolver:
    """Solvers with matrices of their own, kept from one step to the next.

    Attributes:
        shared: The solver for all runs that follow, or None before its first use.
        present: The solver of a run that takes another way, likewise.
        changes: Changes of the unknowns in the last step, shape (owned,) per run that follows.
        unknowns: Numbering of these unknowns.
    """

    shared: LinearSolver | None = None
    present: LinearSolver | None = None
    changes: list[Array] = field(default_factory=list)
    unknowns: Unknowns | None = None

    def take_changes(self, unknowns: Unknowns) -> list[Array]:
        """The changes in the last step, zero at other nodes; a new list begins. Collective.

        Args:
            unknowns: Numbering of the unknowns of this step.
        """
        last, former = self.changes, self.unknowns
        self.changes, self.unknowns = [], unknowns
        if former is None or former is unknowns:
            return last
        pairs = list(zip(former.fields, unknowns.fields))
        if any(one.numbering is not other.numbering for one, other in pairs):
            return []
        nodal, still = unknowns.nodal(), unknowns.nodal().arrays
        found = []
        for change in last:
            former.expand(change, still, nodal)
            found.append(unknowns.restrict(nodal.arrays))
        return found


class TapedTangent:
    """The tangent at a solution. Collective.

    Args:
        operator: The equations, at the solution.
        linear: The linear solver of Newton's method, just after the solution.
        x: The unknowns, shape (owned,).
        readers: Number of runs that follow.
        spare: Solvers with matrices of their own.
        lend: Whether the tangent of Newton's last iteration may do.

    Attributes:
        exact: Whether it is the tangent at the solution.
        last: Unknowns at which the forces of a run that follows were found last, or None.
        corrections: Pair of runs → number of corrections of its first run, and whether they were
            enough.

    Raises:
        ConvergenceError: No method can solve with the tangent.
    """

    def __init__(
        self, operator: Operator, linear: LinearSolver, x: Array, readers: int, spare: SpareSolver,
        lend: bool = True,
    ):  # fmt: skip
        self._lender, self._version, self._spare = linear, linear.version, spare
        factors_pay = _MANY_INCOMPLETE[operator.form.points.gdim]
        self._complete, self._comm = readers >= factors_pay, linear.comm
        self._solutions = [x, *spare.take_changes(operator.here.unknowns)]
        self._products: list[Array] = []
        self._known = len(self._solutions)
        self.last: Array | None = None
        self.corrections: dict[object, tuple[int, bool]] = {}
        method = linear.method
        few = method is not None and readers < (factors_pay if method.incomplete else _MANY)
        self.exact = not (lend and few and linear.has_tangent)
        by_levels = method is not None and method.pc in _MULTIGRID
        self._left = _LEVELS if by_levels else 0.3 * DIGITS
        self._linear = linear
        if self.exact:
            self._assemble(operator)

    def _assemble(self, operator: Operator) -> None:
        """Assemble the tangent at the present increments for all runs. Collective."""
        if self._spare.shared is None:
            self._spare.shared = self._lender.twin(self._complete)
        self._linear = self._spare.shared
        factor(self._linear, operator)

    def _solve_here(self, operator: Operator, right: Array, digits: float) -> Array:
        """Solve with the tangent at present, by another method if need be; others do not use it.

        Raises:
            ConvergenceError: No method converges.
        """
        if self._spare.present is None:
            self._spare.present = self._lender.twin(False)
        here = self._spare.present
        while True:
            factor(here, operator)
            found = here.again(right, digits=digits)
            if not here.stuck:
                return found
            if not here.relax():
                raise ConvergenceError(
                    "the linear solver does not converge with the tangent of a converged step, so "
                    "that derivatives would be wrong: choose another one by petsc_options"
                )

    def solve(self, operator: Operator, right: Array, digits: float = DIGITS) -> Array:
        """Solve with the tangent. Collective.

        Args:
            operator: The equations, close to the solution.
            right: Right-hand side, shape (owned,).
            digits: Residual that may remain, relative to the right-hand side.

        Raises:
            ConvergenceError: Neither this solver nor a more robust one converges.
        """
        found = self._solve(operator, right, digits)
        self._learn(found, right)
        return found

    def _solve(self, operator: Operator, right: Array, digits: float) -> Array:
        """See `solve`; later solutions do not begin from this one."""
        linear = self._linear
        if linear.direct:
            found = linear.again(right, digits=digits)
            return self._solve_here(operator, right, digits) if linear.stuck else found
        if self._solutions and not self._products:
            self._products = [linear.product(x) for x in self._solutions]
        guess, rest = self._guess(right)
        norm, enough = self.norm(rest), digits * self.norm(right)
        if norm <= enough:
            return guess
        found = guess + linear.again(rest, digits=enough / norm)
        return self._solve_here(operator, right, digits) if linear.stuck else found

    def _learn(self, found: Array, right: Array) -> None:
        """Let later solutions begin in the span of this one, too.

        Args:
            found: The solution, shape (owned,).
            right: Its right-hand side, likewise: the product of the solution but for what remains.
        """
        if not self._linear.direct:
            self._solutions.append(found)
            self._products.append(right)

    def _guess(self, right: Array) -> tuple[Array, Array]:
        """Combination of known solutions that leaves a small residual, and it. Collective.

        See Fischer (1998, doi 10.1016/S0045-7825(98)00012-7) on successive right-hand sides. The
        solutions of this step come first, and then those with products of the tangent. In one
        combination, the error of a lent tangent would count many times where two are nearly equal.
        """
        guess, rest = np.zeros_like(right), right
        for part in (slice(self._known, None), slice(self._known)):
            if not self._solutions[part]:
                continue
            P = np.column_stack(self._products[part])
            sums = self._comm.allreduce(np.column_stack([P.T @ P, P.T @ rest]), op=MPI.SUM)
            size = np.sqrt(np.diag(sums))
            size[size == 0.0] = 1.0
            square = sums[:, :-1] / np.outer(size, size)
            weights = np.linalg.lstsq(square, sums[:, -1] / size, rcond=1e-12)[0] / size
            weights = self._comm.bcast(weights)
            guess += np.column_stack(self._solutions[part]) @ weights
            rest = rest - P @ weights
        return guess, rest

    def follow(
        self, operator: Operator, x: Array, kept: Array, pair: object = None, even: float = 0.0
    ) -> tuple[Array, bool]:
        """Unknowns at which the out-of-balance force is that of the solution. Collective.

        Args:
            operator: The equations of a run that follows.
            x: The unknowns of the solution, shape (owned,).
            kept: The out-of-balance force there (N), shape (owned,).
            pair: What this run and its mirror image have in common. The second one takes as many
                corrections as the first one, so that their errors of second order cancel.
            even: Share of the forces that such errors may leave.

        Returns:
            The unknowns, and whether little enough remains.
        """
        self.last, residual = x, operator.residual(x)
        rest, least = residual.values - kept, ROUNDING * residual.reference
        if self.norm(rest) <= least:
            return x, True
        found, converged = self._follow(operator, x, kept, rest, least, pair, even)
        if not self._linear.direct:
            change = x - found
            self._learn(change, rest)
            self._spare.changes.append(change)
        return found, converged

    def _follow(
        self, operator: Operator, x: Array, kept: Array, rest: Array, least: float, pair: object,
        even: float,
    ) -> tuple[Array, bool]:  # fmt: skip
        """See `follow`. Collective.

        Args:
            operator, x, kept, pair, even: See `follow`.
            rest: What the out-of-balance force at x has more than that of the solution (N).
            least: Norm of it that counts as rounding (N).
        """
        first = self.norm(rest)
        if self.exact:
            x = x - self._solve(operator, rest, self._left)
            if pair in self.corrections:
                # corrected as often as the first run of the pair
                count, converged = self.corrections[pair]
                for _ in range(count):
                    rest = self._unbalanced(operator, x, kept)
                    x = x - self._solve(operator, rest, 0.1 * DIGITS)
                return x, converged
            bound = max(max(_ABOVE * self._left, even) * first, NOISE * least)
            return self._iterate(operator, x, kept, (first, bound, least), pair)
        if self._linear is self._lender and self._lender.version != self._version:
            self._assemble(operator)
        x, former = x - self._solve(operator, rest, _FIRST), first
        bound = max(DIGITS * first, least)
        for _ in range(3):
            rest = self._unbalanced(operator, x, kept)
            norm = self.norm(rest)
            if norm <= bound:
                return x, True
            share = norm / former
            if not share <= _SLOW:
                break
            digits = min(max(self._left * first / norm, DIGITS), 0.1)
            x, former = x - self._solve(operator, rest, digits), norm
            # the next residual follows from what the tangent has left of this one
            if share * norm <= DIGITS * first:
                return x, True
        else:
            rest = self._unbalanced(operator, x, kept)
            norm = self.norm(rest)
            if norm <= bound:
                return x, True
        x = x - self._solve_here(operator, rest, min(DIGITS * first / norm, _FIRST))
        bound = max(_ABOVE * DIGITS * first, NOISE * least)
        return self._iterate(operator, x, kept, (norm, bound, least), None, here=True)

    def _iterate(
        self, operator: Operator, x: Array, kept: Array, sizes: tuple[float, float, float],
        pair: object, here: bool = False,
    ) -> tuple[Array, bool]:  # fmt: skip
        """Correct unknowns while the tangent lets forces remain. Collective.

        The tangent of a law need not be the exact derivative of its stress. Then one solution
        leaves a share of the forces, and each further one leaves the same share of the rest.

        Args:
            operator, x, kept, pair: See `follow`.
            sizes: Norm of the forces before the last solution, the norm that may remain, and that
                of their rounding (N).
            here: Whether the tangent is assembled at the unknowns of this run.

        Returns:
            The unknowns, and whether little enough remains.
        """
        former, bound, least = sizes
        count, converged = 0, True
        while True:
            rest = self._unbalanced(operator, x, kept)
            norm = self.norm(rest)
            if norm <= bound:
                break
            share = norm / former
            if not share <= CONTRACTS or count == MOST:
                if here or not np.isfinite(norm):
                    converged = norm <= NOISE**2 * least
                    break
                # a run on the other side of a kink has another tangent
                here, share = True, 0.5
            digits = min(max(0.1 * bound / norm, DIGITS), 0.1)
            solve = self._solve_here if here else self._solve
            x, former, count = x - solve(operator, rest, digits), norm, count + 1
            # what remains follows from the share that the tangent leaves
            if share * norm <= 0.3 * bound:
                break
        if pair is not None:
            self.corrections[pair] = count, converged
        return x, converged

    def _unbalanced(self, operator: Operator, x: Array, kept: Array) -> Array:
        """Out-of-balance force at some unknowns without that of the solution (N). Collective."""
        self.last = x
        return operator.residual(x).values - kept

    def norm(self, values: Array) -> float:
        """Norm of the owned values of all ranks, shape (owned,). Collective."""
        return float(np.sqrt(self._comm.allreduce(float(values @ values), op=MPI.SUM)))


def factor(linear: LinearSolver, operator: Operator) -> None:
    """Assemble and factor the tangent, by other methods after failures. Collective.

    Beyond a limit point the tangent is indefinite, so that Cholesky's factors do not exist.

    Raises:
        ConvergenceError: No method can solve with the tangent.
    """
    while True:
        try:
            linear.attach(operator)
            linear.take_tangent(operator)
            linear.solve(np.zeros(operator.here.unknowns.owned))
            if not linear.stuck:
                return
            another = linear.enlarge() or linear.relax()
        except PETSc.Error as error:
            linear.why(error)
            another = linear.relax()
        if not another:
            raise ConvergenceError(
                "the tangent of a converged step is singular: it has no derivatives"
            )
