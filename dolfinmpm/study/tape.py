"""Solutions of a run, and runs with other parameters that follow them by few linear solutions each.

A run at parameters m solves R(u; s, m) = 0 in each substep, and keeps u and the tangent K at u. A
run at m + ε Δm with the state s' follows: u' = u − K⁻¹ [R(u; s', m + ε Δm) − R(u; s, m)]. This is
Newton's first iteration from u, so that u' is exact up to a term in ε² that does not change with
the sign of ε. With the tangent of another iteration in place of K, a second solution corrects u'.
The difference of two runs that follow, at m ± ε Δm, is thus the derivative.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.contact.contactlaw import SHEARS, SLIPS
from dolfinmpm.contact.contactpoints import ActiveContact
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.dynamics.kinks import AT_LIMIT, CORNERS
from dolfinmpm.solve.bordered import Border, Bordered
from dolfinmpm.solve.newton import Newton, Outcome
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.study.tapedtangent import (
    ACCURATE,
    CONTRACTS,
    MOST,
    NOISE,
    ROUNDING,
    SpareSolver,
    TapedTangent,
)

__all__ = ["Reader", "Tape", "TapedStep", "follow", "record"]

Array = npt.NDArray[np.float64]
Kind = TypeVar("Kind")

# With additional equations: share of the forces, and of these equations' changes, that may remain,
# and the share from which it is told
_LEFT, _TOLD = 1e-6, 1e-3


@dataclass
class TapedStep:
    """One solution of a run.

    Attributes:
        outcome: The result of the solver.
        unknowns: Numbering of the unknowns.
        force: Out-of-balance force that remained (N), shape (owned,).
        tangent: The tangent.
        states: States of the contact points, for each contact.
        border: The additional equations, if there are any.
    """

    outcome: Outcome
    unknowns: Unknowns
    force: Array = field(default_factory=lambda: np.empty(0))
    tangent: TapedTangent | None = None
    states: list[npt.NDArray[np.int8]] = field(default_factory=list)
    border: _BorderAt | None = None


@dataclass
class _BorderAt:
    """The additional equations g(x, y) = 0 at a solution; see `Bordered`.

    Attributes:
        value: The additional unknowns y, shape (m,).
        gap: g, shape (m,).
        sizes: By what the equations are divided, likewise.
        by_x: Derivative of g by the owned unknowns x, shape (owned, m).
        slopes: Derivative of the forces by y (N per unit of y), shape (owned, m).
        columns: dx/dy along which forces stay in balance, shape (owned, m).
        system: Derivative of g by y along these columns, shape (m, m).
    """

    value: Array
    gap: Array
    sizes: Array
    by_x: Array
    slopes: Array
    columns: Array
    system: Array

    @classmethod
    def of(cls, border: Border, operator: Operator, x: Array, tangent: TapedTangent) -> _BorderAt:
        """The equations at the unknowns x, with the tangent there. Collective."""
        gap, by_x, by_y = border.gap(x)
        slopes = border.slopes(x)
        columns = np.column_stack(
            [tangent.solve(operator, -column, ACCURATE) for column in slopes.T]
        )
        comm = operator.here.unknowns.comm
        system = comm.allreduce(by_x.T @ columns, op=MPI.SUM) + by_y
        return cls(border.value.copy(), gap, border.sizes.copy(), by_x, slopes, columns, system)

    def rest(self, border: Border, x: Array) -> Array:
        """What the equations of a run that follows have more than those here. Collective.

        They are divided by the sizes here: near free flight the sizes change with the state.

        Args:
            border: The equations of that run.
            x: Its owned unknowns, shape (owned,).
        """
        gap = border.gap(x)[0]
        return gap * (border.sizes / self.sizes) - self.gap

    def change(self, rest: Array, b: Array, comm: MPI.Intracomm) -> tuple[Array, Array]:
        """Change of y by a change of the equations. Collective.

        Args:
            rest: See `rest`, shape (m,).
            b: Change of x with y unchanged, shape (owned,).
            comm: The ranks.

        Returns:
            The change, and the sizes of the equations' changes, shapes (m,).
        """
        more = comm.allreduce(self.by_x.T @ b, op=MPI.SUM)
        return np.linalg.solve(self.system, -(rest + more)), np.abs(rest) + np.abs(more)


class Tape:
    """The solutions of a run since the last `clear`, in their order.

    Attributes:
        stages: The solutions.
        readers: Number of runs that follow.
    """

    def __init__(self) -> None:
        self.stages: list[TapedStep] = []
        self.readers = 0
        self._spare: list[SpareSolver] = []

    def clear(self) -> None:
        """Forget the solutions; the spare solvers are used again."""
        self.stages.clear()

    def add(
        self, newton: Newton, operator: Operator, outcome: Outcome, border: Border | None = None
    ) -> None:
        """Keep a solution. Collective.

        Args:
            newton: Newton's method that found it.
            operator: The equations, at the solution.
            outcome: The result.
            border: The additional equations, if there are any.
        """
        unknowns = operator.here.unknowns
        stage = TapedStep(outcome, unknowns)
        at = sum(one.tangent is not None for one in self.stages)
        self.stages.append(stage)
        if outcome.reason is not None or unknowns.total == 0:
            return
        if at == len(self._spare):
            self._spare.append(SpareSolver())
        stage.force = unknowns.restrict(operator.forces())
        stage.tangent = TapedTangent(
            operator, newton.linear, outcome.x, self.readers, self._spare[at], lend=border is None
        )
        stage.states = _contact_states(operator)
        if border is not None:
            stage.border = _BorderAt.of(border, operator, outcome.x, stage.tangent)


def _contact_states(operator: Operator) -> list[npt.NDArray[np.int8]]:
    """Copies of the states of all contact points, for each contact."""
    return [term.states.copy() for term in operator.terms if isinstance(term, ActiveContact)]


def _apart(one: npt.NDArray[np.int8], two: npt.NDArray[np.int8]) -> npt.NDArray[np.int64]:
    """Numbers of contact points that touch, stick or slip, and that shear, on one side alone."""
    shears = one == SHEARS, two == SHEARS
    slips = np.minimum(one, SLIPS), np.minimum(two, SLIPS)
    if one.shape == two.shape:
        moves = slips[0] != slips[1]
        changed = [moves, (shears[0] != shears[1]) & ~moves]
        return np.array([np.count_nonzero(at) for at in changed])
    # without pairs of points only their numbers can be compared
    a, b = (np.bincount(at, minlength=3) for at in slips)
    return np.array([np.abs(a - b)[1:].sum(), abs(shears[0].sum() - shears[1].sum())])


class Reader:
    """Reads a tape from its start.

    Args:
        tape: The tape.
        pair: What this reader and that of the mirror image of its run have in common.
        even: Share of the forces that may remain by errors that cancel in such a pair.

    Attributes:
        off: Reasons why the reader does not take the same way as the tape.
        converged: Whether the equations of the run are solved to the digits of a derivative.
    """

    def __init__(self, tape: Tape, pair: object = None, even: float = 0.0):
        self.tape, self.pair, self.even, self._place = tape, pair, even, 0
        tape.readers += 1
        self.off: list[str] = []
        self.converged = True

    def begin(self) -> None:
        """Begin at the start of the tape."""
        self._place, self.off, self.converged = 0, [], True

    def next(self, operator: Operator) -> TapedStep | None:
        """The next solution, or None if the equations have other unknowns. Collective."""
        stages = self.tape.stages
        if self._place >= len(stages):
            self.off.append("other substeps are taken")
            return None
        stage = stages[self._place]
        self._place += 1
        mine, known = operator.here.unknowns, stage.unknowns
        same = len(mine.fields) == len(known.fields) and all(
            np.array_equal(a.nodes, b.nodes) and np.array_equal(a.places[0], b.places[0])
            for a, b in zip(mine.fields, known.fields)
        )
        if mine.comm.allreduce(same, op=MPI.LAND):
            # the forces at the end come from the same results of the laws as the new state
            operator.points.keep_results()
            return stage
        self.off.append("other cells are active")
        return None

    def compare(self, stage: TapedStep, operator: Operator) -> None:
        """Note contact points that are in other states than on the tape. Collective."""
        if not stage.states:
            return
        changed = np.zeros(2, np.int64)
        for known, found in zip(stage.states, _contact_states(operator)):
            changed += _apart(known, found)
        changed = operator.here.unknowns.comm.allreduce(changed, op=MPI.SUM)
        self.off += [f"{n} {what}" for n, what in zip(changed, (CORNERS, AT_LIMIT)) if n]

    def arrive(self, stage: TapedStep, operator: Operator, x: Array) -> Outcome:
        """Set the increments, compare contacts with those on the tape, and end. Collective.

        Args:
            stage: The solution on the tape.
            operator: The equations of the run.
            x: Its unknowns, shape (owned,).
        """
        # the last forces may be those at x
        if stage.tangent is None or stage.tangent.last is not x:
            operator.move(x)
            operator.update_contact()
        self.compare(stage, operator)
        return Outcome(None, x, stage.outcome.iterations, list(stage.outcome.residuals))


class RecordedNewton(Newton):
    """Newton's method that keeps its solutions on a tape."""

    tape: Tape

    def solve(self, operator: Operator) -> Outcome:
        """See `Newton`. Collective."""
        outcome = super().solve(operator)
        self.tape.add(self, operator, outcome)
        return outcome

    def anew(self, softened: bool = False) -> Newton:
        """See `Newton`; its solutions are kept on the same tape."""
        return _like(RecordedNewton, super().anew(softened), tape=self.tape)


class FollowingNewton(Newton):
    """Newton's method from each solution of a tape, with the tangent of the tape."""

    reader: Reader

    def solve(self, operator: Operator) -> Outcome:
        """See `Solver`. Collective."""
        stage = self.reader.next(operator)
        if stage is None:
            # any state will do: it is replaced by the mirror image of another run
            return super().solve(operator)
        known = stage.outcome
        if known.reason is not None:
            # who tells why a step failed looks at terms, which know no increments so far
            operator.move_to_zero()
            return Outcome(known.reason, np.zeros(operator.here.unknowns.owned), known.iterations)
        x = known.x.copy()
        if stage.tangent is not None:
            reader = self.reader
            x, converged = stage.tangent.follow(operator, x, stage.force, reader.pair, reader.even)
            reader.converged &= converged
        return self.reader.arrive(stage, operator, x)

    def anew(self, softened: bool = False) -> Newton:
        """See `Newton`; it follows the same tape."""
        return _like(FollowingNewton, super().anew(softened), reader=self.reader)


class RecordedBordered(Bordered):
    """Newton's method with additional equations that keeps its solutions on a tape."""

    tape: Tape

    def solve(self, operator: Operator) -> Outcome:
        """See `Bordered`. Collective."""
        outcome = super().solve(operator)
        self.tape.add(self.newton, operator, outcome, self.border)
        return outcome


class FollowingBordered(Bordered):
    """Newton iterations with additional equations from each solution of a tape."""

    reader: Reader

    def solve(self, operator: Operator) -> Outcome:
        """See `Solver`. Collective."""
        stage = self.reader.next(operator)
        if stage is None:
            return super().solve(operator)
        known, at, border = stage.outcome, stage.border, self.border
        if known.reason is not None:
            operator.move_to_zero()
        if known.reason is not None or stage.tangent is None or at is None:
            return Outcome(known.reason, known.x.copy(), known.iterations, list(known.residuals))
        border.begin(operator)
        if not border.settled:
            self.newton.linear.attach(operator)
            border.predict(self.newton, operator)
        border.move(at.value - border.value)
        operator.update_external()
        x = self._corrected(operator, stage, stage.tangent, at)
        return self.reader.arrive(stage, operator, x)

    def _corrected(
        self, operator: Operator, stage: TapedStep, tangent: TapedTangent, at: _BorderAt
    ) -> Array:
        """The owned unknowns of the run, shape (owned,); also sets y. Collective.

        Further iterations correct what an inexact tangent leaves, see `TapedTangent.follow`. The
        second run of a pair takes as many as the first one.
        """
        border, reader, comm = self.border, self.reader, operator.here.unknowns.comm
        x, known = stage.outcome.x.copy(), tangent.corrections.get(reader.pair)
        count, former, converged = 0, np.inf, True
        first: tuple[float, Array] = 0.0, np.zeros(at.gap.size)
        while known is None or count <= known[0]:
            residual = operator.residual(x)
            force, rest = stage.force - residual.values, at.rest(border, x)
            if count and known is None:
                noise = NOISE * ROUNDING * residual.reference
                left = _share(max(tangent.norm(force) - noise, 0.0), first[0])
                left = max(left, _share(np.abs(rest).max(), first[1].max()))
                if left <= max(_LEFT, reader.even):
                    break
                if not left <= CONTRACTS * former or count == MOST:
                    converged = left <= _TOLD
                    break
                former = left
            b = tangent.solve(operator, force)
            change, sizes = at.change(rest, b, comm)
            if not count:
                first = max(tangent.norm(force), tangent.norm(at.slopes @ change)), sizes
            x = x + b + at.columns @ change
            border.move(change)
            operator.update_external()
            count += 1
        tangent.corrections.setdefault(reader.pair, (count - 1, converged))
        reader.converged &= converged if known is None else known[1]
        return x


def _share(part: float, whole: float) -> float:
    """A part of a whole; none of nothing."""
    return part / whole if whole else 0.0


def _like(kind: type[Kind], solver: Any, **more: Any) -> Kind:
    """A solver of a subclass with the attributes of another solver."""
    new = kind.__new__(kind)
    new.__dict__.update(solver.__dict__, **more)
    return new


def record(problem: QuasiStatic, tape: Tape) -> None:
    """Let a problem keep its solutions on a tape."""
    kind: Any = RecordedBordered if isinstance(problem.solver, Bordered) else RecordedNewton
    problem.solver = _like(kind, problem.solver, tape=tape)


def follow(problem: QuasiStatic, reader: Reader) -> None:
    """Let the steps of a problem follow the solutions of a tape."""
    kind: Any = FollowingBordered if isinstance(problem.solver, Bordered) else FollowingNewton
    problem.solver = _like(kind, problem.solver, reader=reader)
