"""Quasi-static steps: activate → solve → advance → commit → migrate."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinmpm._platform import garbage, stages
from dolfinmpm._platform.errors import (
    ConvergenceError,
    raise_together,
)
from dolfinmpm._platform.together import together
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.axisymmetry import deformation
from dolfinmpm.body.loadbalance import balance, imbalance
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.activecontact import ActiveContact
from dolfinmpm.contact.touching import ActiveBetween
from dolfinmpm.cut.activation import active_on_grid
from dolfinmpm.cut.participants import Activation, Prolongate
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.solve.advance import NewState, advance, commit
from dolfinmpm.solve.agreement import of_step
from dolfinmpm.solve.arguments import (
    advice,
    check_limits,
    check_petsc_options,
    check_points,
)
from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.freebodies import FreeBodies
from dolfinmpm.solve.loads import check_loads
from dolfinmpm.solve.memory import memory_of, set_memory
from dolfinmpm.solve.method import Tangent, symmetric
from dolfinmpm.solve.newton import Newton, Outcome, Solver
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.problem import Problem
from dolfinmpm.solve.setup import Stabilisations
from dolfinmpm.solve.step import Failed, Step, StepRecord
from dolfinmpm.solve.timeless import refuse_time
from dolfinmpm.solve.unsupported import unsupported

__all__ = ["QuasiStatic"]

# Times that multipliers of contact are renewed in a part of a step
_MOST_AUGMENTATIONS = 50

Array = npt.NDArray[np.float64]


class QuasiStatic(Problem):
    """Quasi-static problem, solved step by step with Newton's method.

    Every step starts from the undeformed grid: the points find their stencils,
    the active unknowns are numbered, PETSc's SNES finds the increment for which
    the form vanishes, and only then the points' state is changed. A step that
    does not converge leaves the state as it was and is halved: the DOLFINx
    constants and functions in the form, which carry the load, then go in parts
    from their values at the last converged step to those set by the user, and so
    do prescribed increments.

    Args:
        form: Weak form, linear in the test functions; see `momentum`.
        increment: The function, or the functions, solved for: `Space.increment`.
            The points move with the first.
        points: Material points.
        bcs: Essential conditions.
        tolerance: Newton stops when the out-of-balance force is this share of
            external forces and reactions, or of what it was at first if that is more.
        max_iterations: Newton iterations before a step is halved.
        max_halvings: Halvings before a step is given up.
        updates: Fields of the points that a converged step sets to UFL
            expressions of state and increment, by name.
        stabilisation: Stabilisation against small cuts: a `Stabilisation`, or the name of
            one with its usual parameters; one for all fields, or a list with one for each.
        prolongation: Function of stencils and active nodes that returns a matrix C,
            shape (nodes, nodes), by which some nodes' values follow from others'.
        options_prefix: Prefix of PETSc options that change the solver: those in PETSc's
            database and on the command line, such as `-mpm_ksp_type cg`, hold for every
            problem of that prefix.
        petsc_options: Options of this problem alone, without the prefix.

    Attributes:
        history: One record per step.
        points: The material points.
        fields: The fields, with their spaces and stabilisations.
        form: The weak form, made ready.
        solver: What solves a step's equations.
        here: What took part in the last step, or None before the first.

    Raises:
        ParameterError: An argument is not what it may be.
        FormError: A term of the form cannot be evaluated where it stands.
        ConflictingConditionsError: Two conditions contradict each other.
    """

    _live = frozenset({"tolerance", "max_iterations", "max_halvings"})

    # what is made of what takes part before it has equations, see `equilibrate`
    changed: Callable[[Activation], Activation] | None = None

    @together
    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        tolerance: float = 1e-9,
        max_iterations: int = 20,
        max_halvings: int = 10,
        updates: dict[str, Expr] | None = None,
        stabilisation: Stabilisations = "none",
        prolongation: Prolongate | None = None,
        options_prefix: str = "mpm_",
        petsc_options: dict[str, Any] | None = None,
    ):
        check_points(points)
        check_limits(tolerance, max_iterations, max_halvings)
        own = check_petsc_options(petsc_options, options_prefix, points.comm)
        super().__init__(
            form, increment, points, bcs, updates=updates, stabilisation=stabilisation,
            prolongation=prolongation,
        )  # fmt: skip
        self._max_halvings = max_halvings
        options = Options(self, options_prefix, own)
        # several fields are as a rule a saddle point, and pressure on what is round turns with it
        definite = len(self.fields) == 1 and not self.form.parts.contacts
        shapes = [space.increment.ufl_shape for space in self.form.spaces]
        basis = self.form.spaces[0].basis
        tangent = Tangent(
            symmetric(self.form), definite, self.form.soft is not None, len(shapes),
            shapes == [(points.gdim,), ()], wide=basis.averaged or basis.continuity > 0,
        )  # fmt: skip
        self.solver: Solver = Newton(
            points.comm, points.gdim, tangent, options, tolerance, max_iterations
        )
        if self.bodies.free:
            self.solver = Bordered(self.solver, FreeBodies(self.bodies, tolerance))
        self._share = 1.0
        self._record = StepRecord()

    @property
    def newton(self) -> Newton:
        """Newton's method, which has the tolerances and the linear solver."""
        if isinstance(self.solver, Bordered):
            return self.solver.newton
        assert isinstance(self.solver, Newton)
        return self.solver

    @property
    def tolerance(self) -> float:
        """Share of external forces and reactions at which Newton's method stops."""
        return self.newton.tolerance

    @tolerance.setter
    def tolerance(self, value: float) -> None:
        check_limits(value, self.max_iterations, self.max_halvings)
        self.newton.tolerance = value
        if isinstance(self.solver, Bordered) and isinstance(self.solver.border, FreeBodies):
            self.solver.border.tolerance = value

    @property
    def max_iterations(self) -> int:
        """Newton iterations before a step is halved."""
        return self.newton.max_iterations

    @max_iterations.setter
    def max_iterations(self, value: int) -> None:
        check_limits(self.tolerance, value, self.max_halvings)
        self.newton.max_iterations = value

    @property
    def max_halvings(self) -> int:
        """Halvings before a step is given up."""
        return self._max_halvings

    @max_halvings.setter
    def max_halvings(self, value: int) -> None:
        check_limits(self.tolerance, self.max_iterations, value)
        self._max_halvings = value

    def _in_blocks(self, count: int) -> bool:
        return self.newton.linear.in_blocks(count)

    @together(given=of_step)
    def step(self, t: float | None = None) -> StepRecord:
        """Take one step to the load that the form's constants and functions now hold. Collective.

        Args:
            t: None; time is of other problems.

        Raises:
            ParameterError: A time is given.
            ConvergenceError: The step did not converge, however small it was made.
            PointsOutsideGridError: Points would leave the grid; if they would leave it by
                more than a cell, the step is halved first.

        After an error the state, and the load, are those of the last converged
        part of the step.
        """
        refuse_time(t, type(self).__name__)
        started, watch = time.perf_counter(), stages.Watch()
        self._record = record = self._of_step()
        check_loads(self._loads.items, self.form.given, self.bcs, self.comm)
        self._loads.aim()
        done, share = 0.0, self._share
        try:
            while done < 1.0:
                share = min(share, 1.0 - done)
                step = self._part(done, share)
                self._loads.set(done + share)
                failed = self._attempt(step)
                if failed is None:
                    done = 1.0 if 1.0 - done - share < 1e-12 else done + share
                    record.parts += 1
                    share = min(1.0, 2.0 * share)
                    continue
                if share * (1 + 1e-9) < 2 * 0.5**self.max_halvings:
                    raise ConvergenceError(self._failure(failed, done, share))
                record.halvings += 1
                share *= 0.5
        except BaseException:
            # an interruption too leaves the load where the state is
            self._loads.set(done)
            self.bodies.reset()
            raise
        finally:
            self._loads.release()
        self._share = share
        record.bodies |= self.bodies.record()
        record.seconds, record.stages = time.perf_counter() - started, watch.stop()
        self.history.append(record)
        return record

    def _scheme(self) -> list[str]:
        method = self.newton.linear.used
        return [
            f"solver: Newton's method to {self.tolerance:g} of the loads in {self.max_iterations} "
            f"iterations at most, up to {self.max_halvings} halvings; linear solver: "
            f"{method or 'chosen in the first step'}"
        ]

    @together
    def info(self) -> str:
        """What takes part now and what solves it, in lines to be printed. Collective."""
        points, here, comm = self.points, self.here, self.comm
        counts = comm.allgather((len(points), 0 if here is None else here.unknowns.owned))
        lines = [_spread("points", [count[0] for count in counts])]
        if here is not None:
            lines.append(_spread("unknowns", [count[1] for count in counts], here.unknowns.total))
            lines.append(f"active cells: {here.active_cells}, ghost facets: {here.ghost_facets}")
        method = self.newton.linear.used
        lines.append(f"linear solver: {method or 'chosen in the first step'}")
        return "\n".join(lines)

    def _memory(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        state, local, cells = super()._memory()
        own, couplings = memory_of(self.newton, self.form, self.here)
        return {**state, "share": self._share, **own}, {**local, **couplings}, cells

    def _remember(
        self, state: dict[str, Any], local: dict[str, Any] | None, cells: dict[str, Any]
    ) -> None:
        super()._remember(state, local, cells)
        self._share = state["share"]
        self._kept = set_memory(self.newton, self.form, state, local)

    def _part(self, done: float, share: float) -> Step:
        """What is asked for of a part of a step."""
        return Step(done + share, share, share)

    def _operator(self, step: Step) -> Operator:
        """The equations of a step. Collective."""
        self.bodies.begin(step.dt)
        here = self.activate(step)
        return Operator(self.form, here if self.changed is None else self.changed(here))

    def _attempt(self, step: Step) -> Failed | None:
        """Solve and commit a step; returns why not, the state being untouched."""
        points, record = self.points, self._record
        self._begin()
        raise_together(self.comm, points.fault())
        garbage.free(self.comm)
        record.migrated += balance(points)
        fault = self.bodies.fault(step.dt, self._has_inertia)
        if fault is not None:
            return Failed(fault, "that body")
        operator = self._operator(step)
        self.newton.guess.length = step.dt
        outcome = self._solve(operator)
        if outcome.reason is None and outcome.iterations:
            self.newton.linear.warn_of_unread_options()
        record.unknowns = operator.here.unknowns.total
        state: NewState | str | None = outcome.reason
        if state is None:
            state = self._advance(operator, outcome.x, step)
        if isinstance(state, str):
            free = [] if self._has_inertia else self.bodies.free
            advice = unsupported(free, operator.contacts, state, self.comm)
            return Failed(state, self._worst(operator), advice)
        self._count(self.bodies.commit(operator.contacts))
        record.bodies = {
            one.contact.name: {"force": [float(f) for f in one.total()]} for one in operator.between
        }
        record.migrated += commit(points, state)
        record.imbalance = max(imbalance(points), operator.here.unknowns.imbalance)
        with stages.commit:
            operator.fill_functions()
        return None

    def _count(self, work: float) -> None:
        """Take note of the work (J) that rigid bodies have done in a step."""

    def _solve(self, operator: Operator) -> Outcome:
        """Solve the equations of a step, with multipliers of contact that bound penetrations."""
        record = self._record
        contacts: list[ActiveContact | ActiveBetween] = [*operator.contacts, *operator.between]
        for contact in contacts:
            contact.clings = True
        for _ in range(_MOST_AUGMENTATIONS):
            outcome = self.solver.solve(operator)
            record.iterations += outcome.iterations
            record.residuals = outcome.residuals
            record.linear_iterations += self.newton.linear.iterations
            deep = not outcome.reason and [c.augment() for c in contacts]
            if not deep or not any(deep):
                return outcome
        outcome.reason = (
            f"{_MOST_AUGMENTATIONS} augmentations do not bound the penetration; take a larger "
            "penalty"
        )
        return outcome

    def _advance(
        self, operator: Operator, x: Array, step: Step, kept: dict[str, Array] | None = None
    ) -> NewState | str:
        """The state at the end of a step, or why there is none. Collective.

        Args:
            operator: The step's equations, moved to their solution.
            x: The owned unknowns, shape (owned,).
            step: What was asked for.
            kept: Fields that the form carries, where they are known already.
        """
        return advance(
            operator, self._updates, self._moves, largest_cell(self.points.grid),
            len(self.history) + 1, kept=kept,
        )  # fmt: skip

    def _worst(self, operator: Operator) -> str:
        """The point whose law failed, or that is compressed most, for messages. Collective."""
        points = self.points
        found = None
        if len(points):
            J = np.ones(len(points))
            if self._moves:
                motion = operator.points.motion(operator.here.movers)
                J = np.linalg.det(deformation(points, *motion))
            failure = operator.points.failure
            p = int(np.argmin(np.nan_to_num(J, nan=-np.inf))) if failure is None else failure.point
            place = f"point {points['id'][p]} at {points['x'][p]} m with det ΔF = {J[p]:.4g}"
            place += f": {failure.cause}" if failure is not None and failure.cause else ""
            found = (failure is None, np.nan_to_num(J[p], nan=-np.inf), place)
        candidates = [c for c in self.comm.allgather(found) if c is not None]
        return min(candidates)[2] if candidates else "none"

    def _failure(self, failed: Failed, done: float, share: float) -> str:
        residuals = self._record.residuals
        last = f"{residuals[-1]:.3g}" if residuals else "none"
        return (
            f"step {len(self.history) + 1} failed at {done + share:.4g} of its load "
            f"({self._loads.describe()}) with parts of {share:.3g}: SNES says "
            f"{failed.reason}, the relative out-of-balance force is {last} (tolerance "
            f"{self.newton.tolerance:g}); the worst is {failed.worst}. The state is that at "
            f"{done:.4g} of the step: {failed.advice or self._advice()}"
        )

    def _advice(self) -> str:
        """What to do about a step that failed. Collective."""
        here = self.here
        if here is None:
            # a rigid body goes too far, and no step was begun
            return "take smaller steps"
        first = here.fields[0]
        named = any(field.stabilisation.kind != "none" for field in self.fields)
        active = active_on_grid(first)
        stabilised = named or here.ghost_facets > 0
        return advice(stabilised, self.bcs, first.space, active, self.points.axisymmetric)


def _spread(what: str, counts: list[int], total: int | None = None) -> str:
    """A number of all ranks, and how it is spread over them."""
    text = f"{what}: {sum(counts) if total is None else total}"
    if len(counts) == 1:
        return text
    mean = sum(counts) / len(counts)
    most = f", {max(counts) / mean:.2f} times the mean" if mean else ""
    return f"{text}, {min(counts)} to {max(counts)} a rank{most}"
