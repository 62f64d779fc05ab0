"""Newton's method for an operator: PETSc's SNES on the active unknowns."""

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

from dolfinmpm._platform.compat import DIVERGED_NAN
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.solve.guess import Guess
from dolfinmpm.solve.linearsolver import LinearSolver
from dolfinmpm.solve.linesearch import SEARCHES, name_of, set_search
from dolfinmpm.solve.method import Tangent
from dolfinmpm.solve.operator import Operator, Residual
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.secants import Secants

__all__ = ["Newton", "Outcome", "Solver"]

Array = npt.NDArray[np.float64]
Reason = PETSc.SNES.ConvergedReason


@dataclass
class Outcome:
    """What a solver found.

    Attributes:
        reason: Why it did not converge, or None.
        x: The owned unknowns, shape (owned,).
        iterations: Newton iterations, those of failed attempts included; a linear step that
            predicts the increment counts as one.
        residuals: Relative out-of-balance force before and after each iteration.
    """

    reason: str | None = None
    x: Array = field(default_factory=lambda: np.empty(0))
    iterations: int = 0
    residuals: list[float] = field(default_factory=list)


class Solver(Protocol):
    """What a step asks to solve an operator's equations."""

    def solve(self, operator: Operator) -> Outcome:
        """Find the increments; leaves the operator moved to them. Collective."""


# Share of the tolerance to which a linear solution need not be better
_SPARE = 0.3


class ConvergenceTest:
    """When forces balance: the measure of Newton's iterations.

    Args:
        tolerance: Share of the reference to reach.
        most: Iterations allowed.

    Attributes:
        residuals: Relative out-of-balance forces so far.
        motion: Norm of the forces that the prescribed motion, or that of a tool, alone would make.
        predicted: Whether a linear step has been taken, whose tangent is known.
        guessed: Whether it begins from increments that are not those of a linear step.
    """

    def __init__(self, tolerance: float, most: int):
        self.tolerance, self.most = tolerance, most
        self.residuals: list[float] = []
        self.motion, self.predicted, self.guessed = 0.0, False, False
        self._first = 0.0

    def test(
        self, norm: float, reference: float, iteration: int, parts: Array | None = None
    ) -> int:
        """SNES's reason to go on or to end.

        Args:
            norm: Norm of the forces out of balance.
            reference: Norm of external forces and reactions.
            iteration: Number of the iteration, from 0.
            parts: Norm and reference of each field, whose units differ, shape (fields, 2); None
                if there is one, or if references are not known yet.
        """
        if not math.isfinite(norm):
            return DIVERGED_NAN
        if iteration == 0 and not self.guessed:
            self._first = norm
        # a body that is unloaded ends without loads and reactions to measure against
        reference = max(reference, self._first, self.motion)
        relative = norm / reference if reference else 0.0
        for one, own in parts if parts is not None else ():
            relative = max(relative, one / own if own else 0.0)
        self.residuals.append(float(relative))
        if relative <= self.tolerance:
            return Reason.CONVERGED_FNORM_RELATIVE
        return Reason.DIVERGED_MAX_IT if iteration >= self.most else Reason.ITERATING


class Newton:
    """Newton's method with two line searches, the second where the first fails.

    Newton's method may cycle or overshoot where points begin and cease to yield. It then
    starts again with the other line search, and begins with that the next time. Where rigid bodies
    touch it looks for the share of each step by `Secants`, and begins from the last step's
    increments, or from rest where that leads nowhere.

    Args:
        comm: Communicator of the problem.
        gdim: Dimension of space.
        tangent: What is known of the tangent.
        options: PETSc options.
        tolerance: Relative out-of-balance force to reach.
        max_iterations: Newton iterations allowed.

    Attributes:
        linear: The linear solver.
        tolerance, max_iterations: The arguments.
        search: The line search to begin with.
        searches: All that are tried; none where the user has chosen one.
        guess: The increments that the last step found, where rigid bodies touch.
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
        chosen = options.has("snes_linesearch_type")
        self.searches: Sequence[str] = () if chosen else SEARCHES
        self.search = SEARCHES[0]
        self._set: tuple[PETSc.SNES | None, str] = None, ""
        self.linear = LinearSolver(comm, gdim, tangent, options)
        self.guess = Guess()

    def anew(self, softened: bool = False) -> Newton:
        """The same with nothing learnt yet.

        Args:
            softened: Whether the matrix of its equations has terms more than their tangent.
        """
        tangent = replace(self._tangent, softened=softened or self._tangent.softened)
        limits = self.tolerance, self.max_iterations
        return Newton(self._comm, self._gdim, tangent, self._options, *limits)

    def solve(self, operator: Operator) -> Outcome:
        """Find the increments; see `Solver`. Collective."""
        outcome = Outcome()
        if self._pushed(operator):
            self._touch(operator, outcome)
            return outcome
        self._attempt(operator, outcome)
        for search in [s for s in self.searches if s != self.search]:
            # no line search helps where the linear solver failed
            if outcome.reason is None or self.linear.failed:
                break
            self.search = search
            self._attempt(operator, outcome)
        return outcome

    def _pushed(self, operator: Operator) -> bool:
        """Whether rigid bodies touch, and each step does work: all unknowns are displacements.

        Where some are pressures the component of the residual along a step is forces by
        displacements less volumes by pressures, which says nothing of how long it should be.
        """
        here = operator.here
        return operator.pushed and bool(self.searches) and len(here.movers) == len(here.fields)

    def _touch(self, operator: Operator, outcome: Outcome) -> None:
        """Solve where rigid bodies touch: from the last increments, then from rest. Collective."""
        guess = None if operator.here.driven else self.guess.on(operator)
        self._attempt(operator, outcome, guess)
        if guess is not None and outcome.reason is not None and not self.linear.failed:
            self._attempt(operator, outcome)
        if outcome.reason is None:
            self.guess.keep(operator)

    def _attempt(self, operator: Operator, outcome: Outcome, guess: Array | None = None) -> None:
        """One run of SNES, from a guess of the unknowns or from rest. Collective."""
        unknowns, linear = operator.here.unknowns, self.linear
        balance = ConvergenceTest(self.tolerance, self.max_iterations)
        outcome.residuals, outcome.reason = balance.residuals, None
        outcome.x = np.zeros(unknowns.owned)
        if unknowns.total == 0:
            operator.move(outcome.x)
            return
        try:
            linear.attach(operator)
            if operator.here.driven:
                outcome.x = self._predict(operator, balance)
                outcome.iterations += 1
            elif guess is not None:
                # forces count as out of balance by the same measure wherever it begins
                balance.motion = operator.residual(outcome.x).norm
                balance.guessed, outcome.x = True, guess.copy()
            reason, iterations = self._run(operator, balance, outcome.x)
        except PETSc.Error as error:
            outcome.reason = linear.why(error)
            if linear.relax():
                self._attempt(operator, outcome, guess)
            return
        outcome.iterations += iterations
        if reason == Reason.DIVERGED_LINEAR_SOLVE:
            if linear.enlarge() or linear.relax():
                self._attempt(operator, outcome, guess)
                return
            # factors that failed fail again, whatever the matrix: begin anew
            linear.forget()
        if reason <= 0:
            outcome.reason = name_of(reason)
        elif not balance.residuals or balance.residuals[-1] > self.tolerance:
            # SNES has criteria of its own; only the out-of-balance force counts
            outcome.reason = f"{name_of(reason)} without balance"
        elif not (self.searches and linear.snes.getType() == "newtonls"):
            # what a user chose may end elsewhere than at the last residual
            operator.move(outcome.x)

    def _run(self, operator: Operator, balance: ConvergenceTest, start: Array) -> tuple[int, int]:
        """Let SNES iterate; writes what it finds over the start. Collective.

        The line searches of `SEARCHES`, and `Secants`, end with the residual of the step that they
        choose, which leaves the operator moved to what was found.
        """
        linear, touches = self.linear, self._pushed(operator)
        assert linear.matrix is not None
        matrix: Matrix = linear.matrix
        found: Residual = Residual(start, 0.0, 0.0)
        # where the next step ends, once it is known
        ahead: Residual | None = None
        secants = Secants(operator.here.unknowns.comm, operator.residual)
        spare, smallest = _SPARE * self.tolerance, 0.0
        # a solver that kept what keeps the solver would never be freed
        ready = weakref.proxy(linear)

        def residual(snes: Any, x: PETSc.Vec, f: PETSc.Vec) -> None:
            nonlocal found, ahead
            found = operator.residual(x.getArray(readonly=True)) if ahead is None else ahead
            f.getArray()[:], ahead = found.values, None

        def shorten(x: PETSc.Vec, y: PETSc.Vec) -> None:
            nonlocal ahead
            share, ahead = secants.find(
                x.getArray(readonly=True), -y.getArray(readonly=True), found
            )
            y.scale(share)

        def jacobian(snes: Any, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
            operator.tangent(matrix)
            # each field is to be balanced by its own measure
            least = found.reference if found.parts is None else smallest
            ready.assembled(found.norm, spare * least)

        def test(snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
            nonlocal smallest
            parts = None
            if found.parts is not None and (iteration > 0 or balance.predicted):
                parts = _references(operator, matrix.petsc, snes.getSolution(), found.parts)
                smallest = float(parts[:, 1].min())
            reason = balance.test(norms[2], found.reference, iteration, parts)
            if balance.guessed and iteration == 0:
                # what turns back is further from balance than what has not moved
                if not norms[2] < balance.motion:
                    return Reason.DIVERGED_LINE_SEARCH
                # what several fields are measured against takes a tangent
                return reason if found.parts is None else Reason.ITERATING
            if balance.guessed and reason == Reason.ITERATING and secants.stuck:
                return Reason.DIVERGED_LINE_SEARCH
            return reason

        snes, x = linear.snes, linear.vector()
        self._set_search(snes, SEARCHES[0] if touches else self.search)
        if touches:
            snes.setLineSearchPreCheck(shorten)
        snes.setTolerances(rtol=0, atol=0, stol=0, max_it=self.max_iterations)
        snes.setFunction(residual, linear.vector())
        snes.setJacobian(jacobian, linear.true, matrix.petsc)
        snes.setConvergenceTest(test)
        x.getArray()[:] = start
        snes.solve(None, x)
        start[:] = x.getArray(readonly=True)
        return snes.getConvergedReason(), snes.getIterationNumber()

    def _set_search(self, snes: PETSc.SNES, search: str) -> None:
        """Choose the line search, unless the user has. Collective."""
        if self.searches and self._set != (snes, search):
            set_search(snes, self._options.prefix, search)
            self._set = snes, search

    def _predict(self, operator: Operator, balance: ConvergenceTest) -> Array:
        """First guess under prescribed increments: one linear step from rest, K x = −f − K g."""
        operator.rest()
        assert self.linear.matrix is not None
        operator.tangent(self.linear.matrix)
        f = operator.push()
        # a body without loads is measured against the forces that the motion would make
        square = operator.here.unknowns.comm.allreduce(float(f @ f), op=MPI.SUM)
        balance.motion, balance.predicted = math.sqrt(square), True
        return self.linear.solve(-f)


def _references(operator: Operator, matrix: PETSc.Mat, x: PETSc.Vec, parts: Array) -> Array:
    """What each field's residual is measured against, once a tangent is known. Collective.

    The largest of an equation's own terms: external forces and reactions, and what each field's
    unknowns make. Where all of these are next to nothing, as volumes are where nothing moves, what
    is out of balance is measured by the forces of the displacement that would make it up: by
    the ratio of what a displacement makes in the first equation and in this one.

    Args:
        operator: The equations.
        matrix: Their tangent.
        x: The unknowns.
        parts: Norms of residual, and of external forces and reactions, shape (fields, 2).

    Returns:
        Norms of residual and reference, shape (fields, 2).
    """
    own = np.maximum(parts[:, 1], operator.sizes(matrix, x).max(axis=0))
    if np.all(parts[:, 0] <= 1e-9 * own):
        return np.stack([parts[:, 0], own], axis=1)
    probe = x.duplicate()
    probe.setRandom()
    stiffness = operator.sizes(matrix, probe)[0]
    same = own[0] * np.divide(stiffness, stiffness[0], out=np.zeros_like(own), where=stiffness > 0)
    return np.stack([parts[:, 0], np.maximum(own, same)], axis=1)
