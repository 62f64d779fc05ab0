"""Newton's method for the equations of a step: PETSc's SNES on the active unknowns."""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.body.location import bounds
from dolfinmpm.solve.convergencetest import ConvergenceTest, others_balanced, references
from dolfinmpm.solve.initialguess import InitialGuess
from dolfinmpm.solve.linearsolver import LinearSolver
from dolfinmpm.solve.method import Tangent
from dolfinmpm.solve.operator import Operator, Residual
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.secants import Secants

__all__ = ["Newton", "Outcome", "Solver", "name_of"]

Array = npt.NDArray[np.float64]
Reason = PETSc.SNES.ConvergedReason
_REASONS = {v: k for k, v in vars(Reason).items() if isinstance(v, int)}
# Line searches in the order of their trial: full steps, then critical points of the residual's
# component along the step, which end cycles between two states
SEARCHES = ("basic", "cp")
_SEARCH_OPTION = "snes_linesearch_type"


@dataclass
class Outcome:
    """The result of a nonlinear solver.

    Attributes:
        reason: Reason of a failure, or None.
        x: The owned unknowns, shape (owned,).
        iterations: Newton iterations, with those of failed attempts. A linear predictor counts as
            one iteration.
        residuals: Relative out-of-balance force before and after each iteration.
    """

    reason: str | None = None
    x: Array = field(default_factory=lambda: np.empty(0))
    iterations: int = 0
    residuals: list[float] = field(default_factory=list)


class Solver(Protocol):
    """Protocol of the nonlinear solvers of a step."""

    def solve(self, operator: Operator) -> Outcome:
        """Find the increments; the operator then has them. Collective."""


# Linear solutions need not be better than this share of the tolerance
_SPARE = 0.3
# Increments below this share of the grid's size do not change positions
_RESOLVED = 4 * np.finfo(float).eps
# Changes up to so many times larger end iterations that stall: in soil that hardly changes its
# volume, rounded strains make forces that move nodes by more
_STALLED = 256.0
# Shortest share of a Newton step that secants try on walls: where many markers begin to touch, a
# tenth of a step overshoots
_NEAREST_ON_WALLS = 0.01


class Newton:
    """Newton's method with two line searches: the second is tried after the first has failed.

    Newton's method may cycle or overshoot where points start or stop to yield. It then starts
    again with the other line search, and uses this line search first from then on. In contact with
    rigid bodies and with walls that have friction, `Secants` finds the length of each Newton step.
    `InitialGuess` has the first guess; if it fails, zero increments are the first guess.

    Args:
        comm: Communicator of the problem.
        gdim: Dimension of space.
        tangent: Known properties of the tangent.
        options: PETSc options.
        tolerance: Bound of the relative out-of-balance force.
        max_iterations: Newton iterations allowed.

    Attributes:
        linear: The linear solver.
        tolerance, max_iterations: The arguments.
        search: The line search that is tried first.
        searches: All line searches that are tried; none if the user has chosen one.
        guess: First guess, from the increments of the last steps.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        gdim: int,
        tangent: Tangent,
        options: Options,
        tolerance: float,
        max_iterations: int,
    ):
        self._comm, self._gdim, self._tangent, self._options = comm, gdim, tangent, options
        self.tolerance, self.max_iterations = tolerance, max_iterations
        chosen = _SEARCH_OPTION in options.names
        self.searches: Sequence[str] = () if chosen else SEARCHES
        self.search = SEARCHES[0]
        self._set: tuple[PETSc.SNES | None, str] = None, ""
        self.linear = LinearSolver(comm, gdim, tangent, options)
        self.guess = InitialGuess()

    def anew(self, softened: bool = False) -> Newton:
        """A new solver with the same arguments, without the experience of this one.

        Args:
            softened: Whether the matrix gets soft stiffness that the forces lack.
        """
        tangent = replace(self._tangent, softened=softened or self._tangent.softened)
        limits = self.tolerance, self.max_iterations
        return Newton(self._comm, self._gdim, tangent, self._options, *limits)

    def solve(self, operator: Operator) -> Outcome:
        """Find the increments; see `Solver`. Collective."""
        outcome = Outcome()
        contact = self._in_contact(operator)
        guess = None
        if self.guess.tried(contact) and not (contact and operator.here.driven):
            guess = self.guess.on(operator)
        self._attempt(operator, outcome, guess)
        if guess is not None:
            self.guess.record_use(outcome.reason is None)
        # secants replace the line searches; only the first guess can change
        others = [s for s in self.searches if s != self.search and not self._shortens(operator)]
        for search in [self.search, *others] if guess is not None else others:
            # no line search helps after the linear solver has failed
            if outcome.reason is None or self.linear.failed:
                break
            self.search = search
            self._attempt(operator, outcome)
        if outcome.reason is None:
            self.guess.keep(operator)
            if guess is None:
                self.guess.plain = outcome.iterations
        return outcome

    def _in_contact(self, operator: Operator) -> bool:
        """Whether rigid bodies may touch, and displacements are the only unknowns."""
        displacements = len(operator.here.movers) == len(operator.here.fields)
        return bool(self.searches) and displacements and _meets(operator)

    def _shortens(self, operator: Operator) -> bool:
        """Whether secants apply: in contact, and on walls with friction."""
        # markers that slide have no stiffness, so that a whole step may slide back too far
        return self._in_contact(operator) or (bool(self.searches) and _rough(operator))

    def _attempt(
        self,
        operator: Operator,
        outcome: Outcome,
        guess: Array | None = None,
        reached: ConvergenceTest | None = None,
    ) -> None:
        """One run of SNES, from a guess of the unknowns or from zero. Collective.

        If the linear solver fails, another one goes on with the unknowns that were `reached`.
        """
        unknowns, linear = operator.here.unknowns, self.linear
        balance = reached or ConvergenceTest(self.tolerance, self.max_iterations)
        outcome.residuals, outcome.reason = balance.residuals, None
        if reached is None:
            outcome.x = np.zeros(unknowns.owned)
        if unknowns.total == 0:
            operator.move(outcome.x)
            return
        try:
            linear.attach(operator)
            if reached is not None:
                balance.resume()
            elif operator.here.driven and guess is None:
                outcome.x = self._predict(operator, balance)
                outcome.iterations += 1
            elif guess is not None:
                # the measure of the out-of-balance force must not depend on the first guess
                balance.motion = operator.residual(outcome.x).norm
                balance.guessed, outcome.x = True, guess.copy()
            snes, x = self._prepared(operator, balance), linear.vector()
            x.getArray()[:] = outcome.x
            snes.solve(None, x)
            outcome.x[:] = x.getArray(readonly=True)
        except PETSc.Error as error:
            outcome.iterations += max(len(balance.residuals) - 1, 0)
            outcome.reason = linear.why(error)
            if linear.relax():
                self._attempt(operator, outcome, guess)
            return
        reason = snes.getConvergedReason()
        outcome.iterations += snes.getIterationNumber()
        if reason == Reason.DIVERGED_LINEAR_SOLVE:
            if linear.enlarge() or linear.relax():
                self._attempt(operator, outcome, guess, balance)
                return
            # factors that failed fail again with any matrix: the next solution needs new ones
            linear.forget()
        if reason <= 0:
            outcome.reason = name_of(reason)
        elif not balance.fulfilled:
            # SNES has other criteria, too; only the out-of-balance force counts
            outcome.reason = f"{name_of(reason)} without balance"
        elif not (self.searches and snes.getType() == "newtonls"):
            # the user's line search or solver may end at another place than the last residual
            operator.move(outcome.x)

    def _prepared(self, operator: Operator, balance: ConvergenceTest) -> PETSc.SNES:
        """SNES with the functions of an operator. Collective.

        The line searches of `SEARCHES`, and `Secants`, end with a residual at the end of their
        step. So the operator has the increments of the solution after SNES has ended.
        """
        linear, contact = self.linear, self._in_contact(operator)
        assert linear.matrix is not None
        matrix: Matrix = linear.matrix
        now: Residual = Residual(np.empty(0), 0.0, 0.0)
        ahead: Residual | None = None  # at the end of the present step, if secants have found it
        secants = _secants(operator) if self._shortens(operator) else None
        spare, smallest, resolved = _SPARE * self.tolerance, 0.0, self._resolved(operator)
        # a strong reference from SNES to its owner would keep both in memory for ever
        weak = weakref.proxy(linear)

        def residual(snes: Any, x: PETSc.Vec, f: PETSc.Vec) -> None:
            nonlocal now, ahead
            now = operator.residual(x.getArray(readonly=True)) if ahead is None else ahead
            f.getArray()[:], ahead = now.values, None

        def shorten(x: PETSc.Vec, y: PETSc.Vec) -> None:
            nonlocal ahead
            assert secants is not None
            share, ahead = secants.find(x.getArray(readonly=True), -y.getArray(readonly=True), now)
            y.scale(share)

        def jacobian(snes: Any, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
            # with several fields, the field with the smallest reference needs the best solution
            enough = spare * (now.reference if now.by_field is None else smallest)
            if not weak.serves(now.norm, enough):
                operator.tangent(matrix)
                weak.assembled(now.norm, enough)

        def test(snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
            nonlocal smallest
            by_field = None
            if now.by_field is not None and (iteration > 0 or balance.predicted):
                by_field = references(operator, matrix.petsc, snes.getSolution(), now.by_field)
                smallest = float(by_field[:, 1].min())
            reason = balance.test(norms[2], now.reference, iteration, by_field, contact)
            if balance.guessed and iteration == 0 and not balance.resumed:
                if not norms[2] < InitialGuess.allowed_share(contact) * balance.motion:
                    return Reason.DIVERGED_LINE_SEARCH
                # the references of several fields need a tangent
                return reason if now.by_field is None else Reason.ITERATING
            may_end = reason == Reason.ITERATING and iteration > 0 and resolved > 0.0
            if may_end and _takes_whole_steps(operator, secants):
                others = by_field is None or others_balanced(operator, by_field, self.tolerance)
                limit = resolved * (_STALLED if balance.stalls else 1.0)
                if others and _moved(operator, snes.getSolutionUpdate()) <= limit:
                    balance.rounded = True
                    return Reason.CONVERGED_SNORM_RELATIVE
            stuck = balance.stalls if secants is None else secants.stuck
            given_up = balance.guessed and reason == Reason.ITERATING and stuck
            return Reason.DIVERGED_LINE_SEARCH if given_up else reason

        snes = linear.snes
        self._set_search(snes, self.search if secants is None else SEARCHES[0])
        if secants is not None:
            snes.setLineSearchPreCheck(shorten)
        snes.setTolerances(rtol=0, atol=0, stol=0, max_it=self.max_iterations)
        snes.setFunction(residual, linear.vector())
        snes.setJacobian(jacobian, linear.true, matrix.petsc)
        snes.setConvergenceTest(test)
        return snes

    def _resolved(self, operator: Operator) -> float:
        """Change of the increments (m) that ends the iterations; 0 where none does. Collective.

        F = 1 + ∇u rounds strains, so that forces of tiny strains balance to a few digits only. The
        change tells of it if Newton's steps are full ones. Other fields, such as pressures, must
        be in balance.
        """
        full = bool(self.searches) and self.search == SEARCHES[0]
        newton = self.linear.snes.getType() == "newtonls"
        if not (full and newton and operator.here.movers):
            return 0.0
        low, high = bounds(operator.form.points.grid)
        return _RESOLVED * float(np.linalg.norm(high - low))

    def _set_search(self, snes: PETSc.SNES, search: str) -> None:
        """Set the line search, unless the user has chosen one. Collective."""
        if not self.searches or self._set == (snes, search):
            return
        self._set = snes, search
        # petsc4py 3.22 sets line searches by the database of options only
        database, name = PETSc.Options(), self._options.prefix + _SEARCH_OPTION
        database[name] = search
        snes.setFromOptions()
        # an entry left in the database would look like the user's choice
        database.delValue(name)

    def _predict(self, operator: Operator, balance: ConvergenceTest) -> Array:
        """First guess under prescribed increments g: the linear step K x = −f − K g. Collective."""
        operator.move_to_zero()
        self.linear.take_tangent(operator)
        f = operator.predictor_residual()
        # the reference of a body without loads: the forces that the motion alone would make
        square = operator.here.unknowns.comm.allreduce(float(f @ f), op=MPI.SUM)
        balance.motion, balance.predicted = math.sqrt(square), True
        return self.linear.solve(-f)


def _secants(operator: Operator) -> Secants:
    """Secants along the displacements, which may be some of the unknowns. Collective."""
    here, unknowns, displacements = operator.here, operator.here.unknowns, None
    if len(here.movers) < len(here.fields):
        ones = np.ones(unknowns.owned)
        displacements = np.sum([unknowns.only(k, ones) for k in here.movers], axis=0)
    if _meets(operator):
        return Secants(unknowns.comm, operator.residual, displacements)
    return Secants(unknowns.comm, operator.residual, displacements, _NEAREST_ON_WALLS)


def _takes_whole_steps(operator: Operator, secants: Secants | None) -> bool:
    """Whether the last Newton step was a whole one, or shortened by rounding alone. Collective."""
    if secants is None:
        return True
    # secants shorten steps in contact; where nothing touches they follow rounding
    return (secants.whole or not _rough(operator)) and not _touched(operator)


def _meets(operator: Operator) -> bool:
    """Whether the form has rigid bodies that may touch."""
    return any(contact.pushes for contact in operator.contacts)


def _rough(operator: Operator) -> bool:
    """Whether the form has walls with friction, see `signorini`."""
    conditions = (c for of in operator.form.boundaries for c in of.conditions)
    return any(c.pushes and c.friction for c in conditions)


def _touched(operator: Operator) -> bool:
    """Whether a rigid body touches in the present state. Collective."""
    touched = any(bool(term.states.any()) for term in operator.contacts if term.pushes)
    return bool(operator.here.unknowns.comm.allreduce(touched, op=MPI.LOR))


def _moved(operator: Operator, change: PETSc.Vec) -> float:
    """Largest change of a displacement in an iteration (m). Collective.

    Args:
        operator: The equations.
        change: Change of the unknowns.
    """
    unknowns, values = operator.here.unknowns, change.getArray(readonly=True)
    parts = [unknowns.only(k, values) for k in operator.here.movers]
    most = max(float(np.abs(part).max(initial=0.0)) for part in parts)
    return float(unknowns.comm.allreduce(most, op=MPI.MAX))


def name_of(reason: int) -> str:
    """PETSc's name for the reason why SNES ended."""
    return _REASONS.get(reason, str(reason))
