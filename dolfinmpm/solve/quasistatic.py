"""Quasi-static steps: scheme.system → solver.solve → scheme.finish → commit."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinmpm._platform import stages
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ConvergenceError, raise_together
from dolfinmpm._platform.garbagecollector import free_petsc
from dolfinmpm.assembly.state import HasState
from dolfinmpm.assembly.term import NewState
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.loadbalance import balance, imbalance
from dolfinmpm.body.pointchecks import overwritten
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.incompatiblegaps import gaps_stay
from dolfinmpm.cut.activation import Prolongate
from dolfinmpm.solve import failures
from dolfinmpm.solve.adaptation import adapt
from dolfinmpm.solve.agreement import of_step
from dolfinmpm.solve.arguments import check_limits, check_petsc_options, check_points, checked_share
from dolfinmpm.solve.bodyrecords import BodyRecords
from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.description import size_and_solver
from dolfinmpm.solve.freebodies import FreeBodies
from dolfinmpm.solve.loads import check_loads
from dolfinmpm.solve.method import Tangent, symmetric
from dolfinmpm.solve.newstate import commit
from dolfinmpm.solve.newton import Newton, Outcome, Solver
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.problem import Problem
from dolfinmpm.solve.restart import SolverState, SupportForces
from dolfinmpm.solve.scheme import Static
from dolfinmpm.solve.setup import Stabilisations
from dolfinmpm.solve.step import Failed, Step, StepRecord
from dolfinmpm.terms.gridterm import fill_functions

__all__ = ["QuasiStatic"]

# Largest number of updates of the multipliers of contact in a substep
_MOST_AUGMENTATIONS = 50


class QuasiStatic(Problem):
    """Quasi-static problem, solved step by step with Newton's method.

    Every step starts from the undeformed grid. The points find their stencils, and the active
    unknowns are numbered. PETSc's SNES finds the increment for which the form vanishes. Only then
    the state of the points changes.

    An attempt that does not converge changes no state, and its substep is halved. If the smallest
    substep fails too, substeps may release by shares what is out of balance, see
    `dolfinmpm.solve.failures`. After a substep that converges the next one is twice as long, at
    most a whole step. The next step begins with this length.

    The DOLFINx constants and functions in the form carry the load. In substeps they go from their
    values at the last converged step to the values set by the user. Prescribed increments are
    divided likewise.

    Args:
        form: Weak form, linear in the test functions; see `momentum`.
        increment: The unknown function, or functions: `Space.increment`. The points move with the
            first function.
        points: Material points.
        bcs: Essential conditions.
        tolerance: Newton's method stops when the out-of-balance force is this share of the
            external forces and reactions. If the first out-of-balance force is larger, the
            share is of that force.
        max_iterations: Newton iterations before a step is halved.
        max_halvings: The smallest substep is the share 2 ** -max_halvings of a step. If it fails,
            the step is given up.
        updates: Name of a field of the points → UFL expression of state and increment. A converged
            step sets the field to the expression.
        stabilisation: Stabilisation against small cuts: a `Stabilisation`, or the name of a
            stabilisation with its default parameters. One for all fields, or a list with one per
            field.
        prolongation: Function of stencils and active nodes. It returns a matrix C, shape
            (nodes, nodes), by which the values of some nodes follow from other nodes.
        options_prefix: Prefix of PETSc options of the solver. Options in PETSc's database and on
            the command line, such as `-mpm_ksp_type cg`, hold for every problem with this prefix.
        petsc_options: Options of this problem alone, without the prefix.
        scheme: The scheme of a step: loads, times, equations and the state at the end; see
            `dolfinmpm.solve.scheme`. By default forces balance at the end of each step.

    Attributes:
        scheme: The scheme.
        share: Share of the next step that is tried first.
        history: One record per step.
        points: The material points.
        fields: The fields, with their spaces and stabilisations.
        form: The compiled weak form.
        solver: The solver of a step's equations.
        here: The `Activation` of the last step, or None before the first step.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.
        FormError: A term of the form cannot be evaluated in its integral.
        ConflictingConditionsError: Two conditions contradict each other.

    A block in an oedometer, 1 % shorter:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 4)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.0), points, V.increment, V.test)
    >>> bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, "top", 1, increment=-0.04)
    >>> problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    >>> record = problem.step()
    >>> points["stress"][0, 1, 1].round(2).item()
    -10151.85
    """

    _live = frozenset({"tolerance", "max_iterations", "max_halvings", "share"})

    scheme: Static

    @collective
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
        scheme: Static | None = None,
    ):
        check_points(points)
        check_limits(tolerance, max_iterations, max_halvings)
        own = check_petsc_options(petsc_options, options_prefix, points.comm)
        super().__init__(
            form, increment, points, bcs, updates=updates, stabilisation=stabilisation,
            prolongation=prolongation, scheme=Static() if scheme is None else scheme,
        )  # fmt: skip
        self._max_halvings = max_halvings
        options = Options(self, options_prefix, own)
        # Several fields usually make a saddle point. A pressure on a curved surface turns with it.
        definite = len(self.fields) == 1 and all(term.definite for term in self.form.terms)
        shapes = [space.increment.ufl_shape for space in self.form.spaces]
        basis = self.form.spaces[0].basis
        tangent = Tangent(
            symmetric(self.form), definite, self.form.softened, len(shapes),
            shapes == [(points.gdim,), ()], wide=basis.averaged or basis.continuity > 0,
            degree=basis.degree if isinstance(basis, LatticeBasis) else 0,
        )  # fmt: skip
        self.solver: Solver = Newton(
            points.comm, points.gdim, tangent, options, tolerance, max_iterations
        )
        if self.bodies.free:
            self.solver = Bordered(self.solver, FreeBodies(self.bodies, tolerance))
        self.share = 1.0
        self._record = StepRecord()

    def use(self, scheme: Static) -> None:
        """Use another scheme in the next steps."""
        vars(self)["scheme"] = scheme

    @property
    def newton(self) -> Newton:
        """Newton's method, with its tolerances and its linear solver."""
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

    @property
    def blocks_from(self) -> float:
        """See `Problem`."""
        return self.newton.linear.choice.blocks_from

    @collective(compared=of_step)
    def step(self, t: float | None = None) -> Any:
        """Take one step, to the present load or to the time t. Collective.

        A quasi-static step goes to the present values of the constants and functions of the form.

        Args:
            t: In problems with a time: the time to go to (s), later than `time`. A time of
                `times(end, dt="auto")` lets the error of the last step choose the length.
                In problems without a time: None.

        Raises:
            ParameterError: The time is missing, or not later than `time`, or the problem has no
                time.
            ConvergenceError: The step did not converge after all halvings.
            PointsOutsideGridError: Points would leave the grid. If they would leave the grid by
                more than a cell, the step is halved first.

        After an error the state, the load and the time are those of the last converged substep. A
        step that failed has no record in `history`.
        """
        started, watch = time.perf_counter(), stages.Watch()
        check_loads(self.loads.items, self.form.given, self.essential_conditions, self.comm)
        self.scheme.begin(self, t)
        self.loads.set_target()
        self._record = record = self.scheme.record()
        self._follow_leaves()
        done, share, whole, releases = 0.0, checked_share(self.share), False, False
        try:
            while done < 1.0:
                share = min(share, 1.0 - done)
                step = self.scheme.substep(done, share)
                release = share / (1.0 - done) if releases else 1.0
                self.loads.set(done + share)
                failed = self._attempt(step, release)
                if failed is None:
                    done = 1.0 if 1.0 - done - share < 1e-12 else done + share
                    record.parts += 1
                    share = min(1.0, 2.0 * share)
                    continue
                # half of it would be shorter than the smallest substep; 1e-9: shares are rounded
                if share * (1 + 1e-9) < 2 * 0.5**self.max_halvings:
                    if not releases and failures.begins_unbalanced(self, record.residuals):
                        releases, share = True, failures.FIRST_RELEASED
                        continue
                    raise ConvergenceError(failures.why_step_failed(self, failed, done, share))
                record.halvings += 1
                share *= 0.5
            whole = True
        except BaseException:
            # load and state must belong to the same substep, also after an interruption
            self.loads.set(done)
            self.scheme.fail()
            self.bodies.reset()
            raise
        finally:
            self.loads.accept(whole)
            self.scheme.end(record if whole else None)
        self.share = share
        if self.bodies.all:
            record.bodies = BodyRecords(record.bodies | self.bodies.record())
        record.seconds, record.stages = time.perf_counter() - started, watch.stop()
        self.history.append(record)
        return record

    def _follow_leaves(self) -> None:
        """Let the points follow the leaves, and record it. Collective."""
        raise_together(self.comm, overwritten(self.points))
        self.form.check_new_tags()
        if self.form.adaptive:
            adapted = adapt(self)
            self._record.split, self._record.merged = adapted.split, adapted.merged
            self.scheme.adapted()

    def _attempt(self, step: Step, release: float = 1.0) -> Failed | None:
        """Take a step or a substep; return None, or the reason of a failure. Collective.

        A failed attempt changes no state: new values stay in `NewState` until `_commit`. The next
        attempt sets loads from the last converged substep, and bodies from their start. It finds
        ranks and cells of points, places of markers and the activation anew.

        Args:
            step: The step or substep.
            release: Share of the forces out of balance at its start that it releases.
        """
        failed = self._prepare(step)
        if failed is not None:
            return failed
        operator = self.scheme.system(self, step)
        if release < 1.0:
            failures.hold_back(operator, release)
        self._record.unknowns = operator.here.unknowns.total
        self.newton.guess.length = step.dt
        for contact in operator.contacts:
            contact.clings, contact.depths = True, []
        # multipliers of contact bound the penetration: they change between solutions
        for _ in range(_MOST_AUGMENTATIONS):
            with stages.solve:
                outcome = self.solver.solve(operator)
            self._record_solution(outcome)
            if outcome.reason is not None:
                break
            exceeding = [contact for contact in operator.contacts if contact.augment()]
            if not exceeding or gaps_stay(exceeding):
                break
        else:
            outcome.reason = (
                f"{_MOST_AUGMENTATIONS} augmentations bound no penetration; take a larger penalty"
            )
        state: NewState | str | None = outcome.reason
        if state is None:
            held = operator.holding_forces()
            state = self.scheme.finish(self, operator, outcome.x, step)
        if isinstance(state, str):
            return failures.failed_step(self, operator, state)
        held = self.scheme.holding_forces(operator, held)
        self._commit(operator, state)
        self.essential_conditions.keep_forces(operator.here, held)
        return None

    def _prepare(self, step: Step) -> Failed | None:
        """Check that a step may begin, and distribute the points over the ranks. Collective."""
        self._check_still_valid()
        raise_together(self.comm, self.points.error_in_fields())
        if self.comm.size > 1:
            free_petsc(self.comm)
            self._record.migrated += balance(self.points)
        if not self.bodies.all:
            return None
        fault = self.bodies.too_fast(step.dt, self.scheme.inertia)
        return None if fault is None else Failed(fault, "that body")

    def _record_solution(self, outcome: Outcome) -> None:
        """Add the iterations of a solution to the record."""
        linear = self.newton.linear
        self._record.add(outcome.iterations, outcome.residuals, linear.iterations)
        # a step that follows another run's solutions has not used this solver
        if outcome.reason is None and outcome.iterations and not linear.failed:
            linear.warn_of_unread_options()

    def _commit(self, operator: Operator, state: NewState) -> None:
        """Write the new state of bodies, points and markers. Collective."""
        points, record = self.points, self._record
        if self.bodies.all:
            # it counts the work of friction, too
            work = self.bodies.commit(self.bodies.acting(operator))
            self.scheme.add_body_work(work)
        found = (contact.record() for contact in operator.contacts)
        record.bodies = BodyRecords(row for rows in found for row in rows.items())
        record.migrated += commit(points, state)
        if self.comm.size > 1:
            record.imbalance = max(imbalance(points), operator.here.unknowns.imbalance)
        with stages.commit:
            fill_functions(operator.here.fields, operator.increments)

    def scheme_lines(self) -> list[str]:
        """See `Problem`."""
        method = self.newton.linear.used
        return [
            *self.scheme.summary(),
            f"solver: Newton's method to {self.tolerance:g} of the loads in {self.max_iterations} "
            f"iterations at most, up to {self.max_halvings} halvings; linear solver: "
            f"{method or 'chosen in the first step'}",
        ]

    @collective
    def info(self) -> str:
        """Lines to print: points, unknowns and the linear solver at present. Collective."""
        return size_and_solver(self)

    def keeping(self) -> list[tuple[str, HasState]]:
        """See `Problem`."""
        supports = SupportForces(self.essential_conditions)
        return [*super().keeping(), ("supports", supports), ("solver", SolverState(self))]

    @property
    def last_residual(self) -> str:
        """The last relative out-of-balance force, for messages."""
        residuals = self._record.residuals
        return f"{residuals[-1]:.3g}" if residuals else "none"
