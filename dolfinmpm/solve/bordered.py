"""Newton's method for the equations of a step with m more equations for m more unknowns.

Each iteration solves for m + 1 right-hand sides with one factorisation, K b = −r and K A = −∂r/∂y.
The step is δx = b + A δy, with the δy that satisfies the linearised equations g(x, y) = 0. This is
Newton's method for all equations together (Batoz & Dhatt 1979, doi 10.1002/nme.1620140811).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.solve.convergencetest import ConvergenceTest
from dolfinmpm.solve.newton import Newton, Outcome, name_of
from dolfinmpm.solve.operator import Operator, Residual
from dolfinmpm.solve.secants import Secants

__all__ = ["Border", "Bordered"]

Array = npt.NDArray[np.float64]
Reason = PETSc.SNES.ConvergedReason

# Growth of the out-of-balance force in an iteration from which its step is halved, and the shortest
# step. A full step of Newton's method may turn points inside out where corners begin to touch.
_GROWTH, _SHORTEST = 4.0, 1 / 16


class Border(Protocol):
    """The m equations g(x, y) = 0 and their unknowns y.

    Attributes:
        tolerance: Bound of the equations' errors, each divided by the size of its equation.
        unmet: Message if forces balance and these equations are not satisfied.
        sizes: By what the last `gap` has divided the equations, shape (m,).
        acting: Norm of forces that act on the unknowns, besides external forces and reactions (N).
    """

    tolerance: float
    unmet: str
    sizes: Array
    acting: float

    @property
    def conjugate(self) -> bool:
        """Whether the equations are forces on the unknowns y, so that g · δy is work."""

    @property
    def settled(self) -> bool:
        """Whether `predict` sets nothing that the equations keep."""

    @property
    def value(self) -> Array:
        """The unknowns y, shape (m,)."""

    def begin(self, operator: Operator) -> None:
        """Begin a step with its equations. Collective."""

    def reset(self) -> None:
        """Reset y to its value at the start of the step, for another attempt."""

    def predict(self, newton: Newton, operator: Operator) -> tuple[Array, float] | str:
        """First guess of the unknowns; also sets y. Collective.

        Returns:
            The owned unknowns, shape (owned,), and the norm of the forces made by the guess, which
            is the reference for a body without loads. Or the reason of a failure.
        """

    def move(self, change: Array) -> None:
        """Add a change, shape (m,), to y. Collective."""

    def slopes(self, x: Array) -> Array:
        """∂r/∂y at the owned unknowns, shape (owned, m). Collective."""

    def gap(self, x: Array) -> tuple[Array, Array, Array]:
        """g, its derivative by the owned unknowns, and its derivative by y. Collective.

        Returns:
            Shapes (m,), (owned, m) and (m, m).
        """


class Bordered:
    """Newton's method with the additional equations of a border.

    Args:
        newton: Tolerances and the linear solver.
        border: The equations.
    """

    def __init__(self, newton: Newton, border: Border):
        self.newton, self.border = newton, border

    def solve(self, operator: Operator) -> Outcome:
        """Find the increments and the border's unknowns; see `Solver`. Collective."""
        linear = self.newton.linear
        if operator.here.unknowns.total == 0:
            return Outcome("no unknown is free")
        self.border.begin(operator)
        searched, spent = False, 0
        while True:
            outcome = Outcome(iterations=spent)
            self._attempt(operator, outcome, searched)
            if outcome.reason and self.border.conjugate and not (searched or linear.failed):
                searched, spent = True, outcome.iterations
                self.border.reset()
                continue
            # after an error in PETSc there is no solver any more
            stuck = linear.failed or linear.stuck
            if outcome.reason is None or not stuck or not linear.relax():
                return outcome
            self.border.reset()

    def _attempt(self, operator: Operator, outcome: Outcome, searched: bool) -> None:
        """One run of Newton's method from the border's guess. Collective."""
        try:
            self.newton.linear.attach(operator)
            guess = self.border.predict(self.newton, operator)
            if isinstance(guess, str):
                outcome.reason = guess
                return
            outcome.iterations += 1
            outcome.x, motion = guess
            outcome.reason = self._correct(operator, outcome, motion, searched)
        except PETSc.Error as error:
            outcome.reason = self.newton.linear.why(error)

    def _correct(
        self, operator: Operator, outcome: Outcome, motion: float, searched: bool
    ) -> str | None:
        """Iterate from the border's guess; returns the reason of a failure, or None. Collective."""
        newton, border, x = self.newton, self.border, outcome.x
        balance = ConvergenceTest(newton.tolerance, newton.max_iterations)
        balance.motion, outcome.residuals = motion, balance.residuals
        comm = operator.here.unknowns.comm
        operator.update_external()
        found = operator.residual(x)
        while True:
            gap, by_x, by_y = border.gap(x)
            # the number of the iteration is at least 1: the residual of a guess is no reference
            reference = max(found.reference, border.acting)
            reason = balance.test(found.norm, reference, len(balance.residuals) + 1)
            if reason == Reason.CONVERGED_FNORM_RELATIVE:
                if np.all(np.abs(gap) <= border.tolerance):
                    return None
                if len(balance.residuals) > newton.max_iterations:
                    return border.unmet
            elif reason != Reason.ITERATING:
                return name_of(reason)
            newton.linear.take_tangent(operator)
            b = newton.linear.solve(-found.values)
            slopes = border.slopes(x)
            A = np.column_stack([newton.linear.solve(-column) for column in slopes.T])
            outcome.iterations += 1
            m = gap.size
            # a failed solution is infinite
            with np.errstate(invalid="ignore"):
                sums = comm.allreduce(by_x.T @ np.column_stack([A, b]), op=MPI.SUM)
            system = sums[:, :m] + by_y
            if not np.isfinite(sums).all() or np.linalg.matrix_rank(system) < m:
                return "the bordered system is singular"
            change = np.linalg.solve(system, -(gap + sums[:, m]))
            step = b + A @ change
            if searched:
                found = self._search(operator, x, step, change, found, gap)
                continue
            # forces that the border's equations add are to be balanced by the step, too
            added = slopes @ change
            size = float(np.sqrt(comm.allreduce(float(added @ added), op=MPI.SUM)))
            found = self._move(operator, x, step, change, max(found.norm, size))

    def _move(
        self, operator: Operator, x: Array, step: Array, change: Array, former: float
    ) -> Residual:
        """Take a step, a shorter one where it makes forces out of balance grow much. Collective.

        Args:
            operator: The equations.
            x: The owned unknowns, shape (owned,); they are changed.
            step: Their step, likewise.
            change: The step of the border's unknowns, shape (m,).
            former: Norm of the out-of-balance force before the step (N).

        Returns:
            The out-of-balance force after the step.
        """
        share = 1.0
        x += step
        self.border.move(change)
        while True:
            operator.update_external()
            found = operator.residual(x)
            if found.norm <= _GROWTH * former or share <= _SHORTEST:
                return found
            share *= 0.5
            x -= share * step
            self.border.move(-share * change)

    def _search(
        self, operator: Operator, x: Array, step: Array, change: Array, now: Residual, gap: Array
    ) -> Residual:
        """Take the share of a step that `Secants` finds for all equations; see `_move`. Collective.

        Args:
            operator, x, step, change: See `_move`.
            now: The out-of-balance force before the step.
            gap: The border's equations there, shape (m,).

        Returns:
            The out-of-balance force after the step.
        """
        border, comm = self.border, operator.here.unknowns.comm
        # all ranks have the border's unknowns, and one of them adds their work
        counts, moved = float(comm.rank == 0), np.zeros_like(change)

        def joined(found: Residual, gap: Array) -> Residual:
            return replace(found, values=np.r_[found.values, counts * border.sizes * gap])

        def residual(at: Array) -> Residual:
            x[:] = at[: x.size]
            border.move(at[x.size :] - moved)
            moved[:] = at[x.size :]
            operator.update_external()
            found = operator.residual(x)
            return joined(found, border.gap(x)[0])

        start, way = np.r_[x, moved], np.r_[step, change]
        _, found = Secants(comm, residual).find(start, way, joined(now, gap))
        return replace(found, values=found.values[: x.size])
