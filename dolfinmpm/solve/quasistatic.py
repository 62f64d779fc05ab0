"""Quasi-static steps: activate → solve → advance → commit → migrate."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import (
    CheckpointError,
    ConvergenceError,
    ParameterError,
    raise_together,
)
from dolfinmpm.assembly.points import Matrix
from dolfinmpm.basis.conditions import Condition, warn_idle
from dolfinmpm.body.migration import settle
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Activation, Field, Kept, Prolongate, activate
from dolfinmpm.cut.held import Held
from dolfinmpm.cut.remedies import Stabilisation
from dolfinmpm.forms.checks import check_fields, check_form
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.io import checkpoint
from dolfinmpm.solve.advance import NewState, advance, commit
from dolfinmpm.solve.arguments import (
    advice,
    agree,
    check_callable,
    check_conditions,
    check_limits,
    check_petsc_options,
    check_spaces,
    check_updates,
    increments_of,
    remedies_of,
)
from dolfinmpm.solve.loads import Loads, check_loads, loads_of
from dolfinmpm.solve.memory import memory_of, saved_loads, set_loads, set_memory
from dolfinmpm.solve.newton import Newton, Solver
from dolfinmpm.solve.operator import Operator, WeakForm
from dolfinmpm.solve.options import Options
from dolfinmpm.solve.setup import Remedies, updates_of, with_moduli, with_remedies
from dolfinmpm.solve.step import Failed, Step, StepRecord

__all__ = ["QuasiStatic"]

Array = npt.NDArray[np.float64]


class QuasiStatic:
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
        stabilisation: Remedy against small cuts: a `Stabilisation`, or the name of
            one with its usual parameters; one for all fields, or a list with one for each.
        prolongation: Function of stencils and active nodes that returns a matrix C,
            shape (nodes, nodes), by which some nodes' values follow from others'.
        options_prefix: Prefix of PETSc options that change the solver: those in PETSc's
            database and on the command line, such as `-mpm_ksp_type cg`, hold for every
            problem of that prefix.
        petsc_options: Options of this problem alone, without the prefix.

    Attributes:
        history: One record a step.
        points: The material points.
        fields: The fields, with their spaces and remedies.
        form: The weak form, made ready.
        solver: What solves a step's equations.
        here: What took part in the last step, or None before the first.

    Raises:
        ParameterError: An argument is not what it may be.
        FormError: A term of the form cannot be evaluated where it stands.
        ConflictingConditionsError: Two conditions contradict each other.
    """

    _of_step: type[StepRecord] = StepRecord

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
        stabilisation: Remedies = "none",
        prolongation: Prolongate | None = None,
        options_prefix: str = "mpm_",
        petsc_options: dict[str, Any] | None = None,
    ):
        increments = increments_of(increment, points)
        spaces = [u._dolfinmpm_space for u in increments]
        check_spaces(spaces)
        check_form(form)
        check_limits(tolerance, max_iterations, max_halvings)
        bcs = check_conditions(bcs, spaces)
        updates = check_updates(updates, points)
        own = check_petsc_options(petsc_options, options_prefix, points.comm)
        remedies = remedies_of(stabilisation, len(spaces))
        check_callable("prolongation", prolongation)
        agree(
            points.comm, bcs=bcs, tolerance=tolerance, max_iterations=max_iterations,
            max_halvings=max_halvings, stabilisation=remedies, petsc_options=own,
        )  # fmt: skip
        self.points = points
        self.max_halvings = max_halvings
        self.history: list[StepRecord] = []
        remedies = with_moduli(remedies, spaces, form, points)
        self.fields = [Field(*both, prolongation) for both in zip(spaces, remedies)]
        whole, softening = with_remedies(form, self.fields, points)
        self.form = WeakForm(whole, spaces, points, softening)
        check_fields(form, spaces)
        self.here: Activation | None = None
        self._kept: Kept | None = None
        self._held = Held(bcs, spaces)
        self._updates = updates_of(self.form, updates)
        options = Options(self, options_prefix, own)
        softened = self.form.softening is not None
        self.solver: Solver = Newton(
            points.comm, points.gdim, softened, options, tolerance, max_iterations
        )
        loads = loads_of(self.form.loads)
        for condition in self.bcs:
            if any(condition.value is load for load in loads):
                raise ParameterError(
                    f"a constant is both a load of the form and the increment prescribed at "
                    f"'{condition.where}'; a part of a step would scale it twice: use two constants"
                )
        self._loads = Loads(loads, increments)
        self._share = 1.0
        self._record = StepRecord()
        settle(points, self.configuration)

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the points."""
        return self.points.comm

    @property
    def bcs(self) -> list[Condition]:
        """The essential conditions."""
        return self._held.conditions

    @property
    def stabilisation(self) -> Stabilisation | list[Stabilisation]:
        """The remedy with all its parameters, a list of several fields' ones."""
        remedies = [field.remedy for field in self.fields]
        return remedies if len(remedies) > 1 else remedies[0]

    @property
    def configuration(self) -> str:
        """Configuration that stencils and gradients are taken in."""
        return self.fields[0].space.configuration

    @property
    def newton(self) -> Newton:
        """Newton's method, which has the tolerances and the linear solver."""
        assert isinstance(self.solver, Newton)
        return self.solver

    @property
    def _moves(self) -> bool:
        """Whether the points move with the first field."""
        return self.fields[0].space.increment.ufl_shape == (self.points.gdim,)

    def step(self) -> StepRecord:
        """Take one step to the load that the form's constants and functions now hold. Collective.

        Raises:
            ConvergenceError: The step did not converge, however small it was made.
            PointsOutsideGridError: Points would leave the grid; if they would leave it by
                more than a cell, the step is halved first.

        After an error the state, and the load, are those of the last converged
        part of the step.
        """
        started = time.perf_counter()
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
            raise
        finally:
            self._loads.release()
        self._share = share
        record.seconds = time.perf_counter() - started
        self.history.append(record)
        return record

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all that it takes to go on from here into one HDF5 file. Collective.

        The file is written beside the one of that name, and takes its place when it is
        whole: a run that is killed at any time leaves one that `load` reads. Save between
        steps; what the user has set since the last one is not in the file.

        Args:
            path: File to write, in a folder that is there.

        Raises:
            CheckpointError: The file cannot be written, or h5py is missing.
        """
        state, local, cells = self._memory()
        history = [dataclasses.asdict(record) for record in self.history]
        checkpoint.write(path, self.points, state, local, history, cells, self._laws)

    def load(self, path: str | os.PathLike[str]) -> None:
        """Go on from where `save` was called, on any number of ranks. Collective.

        Build the same problem first: grid, points with their fields and laws, form and
        conditions. Points, loads and `history` are then those of the file, so that a script
        goes on with `for k in range(len(problem.history), steps)`. The constants and
        functions of the form, and the constants of the conditions, hold what they held in
        the saved state: set what is to differ, such as a modulus, after this call.
        Increments are zero until the next step.

        A run that goes on gives the same figures as one that was not interrupted: bit for
        bit on one rank, and on as many ranks as before if the grid is distributed as it
        was and the linear solver repeats itself (MUMPS on several ranks does not); else to
        rounding. A file of a total Lagrangian problem may be loaded into an updated one.

        Args:
            path: The file.

        Raises:
            CheckpointError: The file is missing, cut short, damaged, of a newer version, of
                another grid or of another problem, or h5py is missing. The state is then
                what it was.
        """
        found = checkpoint.read(path, self.points, self._laws)
        raise_together(self.comm, self._mismatch(os.fspath(path), found.state))
        found.put(self.points)
        self._remember(found.state, found.local, found.cells)
        names = {f.name for f in dataclasses.fields(self._of_step)}
        self.history = [
            self._of_step(**{k: v for k, v in row.items() if k in names}) for row in found.history
        ]

    @property
    def _laws(self) -> list[str]:
        """Laws with their measures of strain; a next stage may have other parameters."""
        declared = self.form.parts.declarations
        return sorted({f"{type(d.law).__name__} under {d.strain} strain" for d in declared})

    def _problem(self) -> dict[str, Any]:
        """What a checkpoint must have in common with this problem."""
        constants = [bc.value for bc in self.bcs if isinstance(bc.value, fem.Constant)]
        return {
            "solver": type(self).__name__,
            "unknown fields": str([space.increment.ufl_shape for space in self.form.spaces]),
            "loads": str([load.ufl_shape for load, _ in self._loads.converged()]),
            "prescribed": len(constants),
        }

    def _mismatch(self, path: str, state: dict[str, Any]) -> CheckpointError | None:
        for what, here in self._problem().items():
            if state.get(what) != here:
                return CheckpointError(
                    f"{path} is of another problem: its {what} is {state.get(what)}, that of this "
                    f"one {here}; build the same problem before you load"
                )
        return None

    def _memory(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        """State that all ranks share, that of this rank, and that of its cells."""
        state, local = memory_of(self.newton, self.form, self.here)
        loads, cells = saved_loads(self._loads)
        values = [bc.value for bc in self.bcs if isinstance(bc.value, fem.Constant)]
        given = {f"prescribed {k}": np.array(value.value) for k, value in enumerate(values)}
        return {**self._problem(), "share": self._share, **state, **loads, **given}, local, cells

    def _remember(
        self, state: dict[str, Any], local: dict[str, Any] | None, cells: dict[str, Any]
    ) -> None:
        """Take what `_memory` returned. Collective."""
        self._share = state["share"]
        values = [bc.value for bc in self.bcs if isinstance(bc.value, fem.Constant)]
        for k, value in enumerate(values):
            value.value = state[f"prescribed {k}"]
        set_loads(self._loads, state, cells)
        self.here = None
        self._kept = set_memory(self.newton, self.form, state, local)

    def activate(self, step: Step | None = None) -> Activation:
        """What takes part in a step from where the points are now. Collective.

        Args:
            step: The step; all of it by default.
        """
        share = 1.0 if step is None else step.share
        self.form.bind()
        first, kept, self._kept = self.here is None, self._kept, None
        self.here = activate(
            self.points, self.fields, self._held, self.form, share, self.here, kept
        )
        if first and kept is None:
            active = [f.active[f.active < f.basis.nodes.owned] for f in self.here.fields]
            warn_idle(self.bcs, self.form.spaces, active)
        return self.here

    def operator(self) -> Operator:
        """The weak form on what takes part now: residual, tangent and external. Collective."""
        return self.form.on(self.activate())

    def stiffness(self) -> PETSc.Mat:
        """Tangent stiffness of the active unknowns in the present state. Collective."""
        operator = self.operator()
        operator.rest()
        matrix = Matrix(operator.here.pattern, operator.here.unknowns)
        operator.tangent(matrix)
        return matrix.petsc

    def _part(self, done: float, share: float) -> Step:
        """What is asked for of a part of a step."""
        return Step(done + share, share, share)

    def _operator(self, step: Step) -> Operator:
        """The equations of a step. Collective."""
        return self.form.on(self.activate(step))

    def _attempt(self, step: Step) -> Failed | None:
        """Solve and commit a step; returns why not, the state being untouched."""
        points, record = self.points, self._record
        raise_together(self.comm, points.fault())
        operator = self._operator(step)
        outcome = self.solver.solve(operator)
        record.iterations += outcome.iterations
        record.residuals = outcome.residuals
        record.unknowns = operator.here.unknowns.total
        state: NewState | str | None = outcome.reason
        if state is None:
            state = self._advance(operator, outcome.x, step)
        if isinstance(state, str):
            return Failed(state, self._worst(operator))
        record.migrated += commit(points, state)
        operator.fill_functions()
        return None

    def _advance(self, operator: Operator, x: Array, step: Step) -> NewState | str:
        """The state at the end of a step, or why there is none. Collective.

        Args:
            operator: The step's equations, moved to their solution.
            x: The owned unknowns, shape (owned,).
            step: What was asked for.
        """
        return advance(
            operator, self._updates, self._moves, largest_cell(self.points.grid),
            len(self.history) + 1,
        )  # fmt: skip

    def _worst(self, operator: Operator) -> str:
        """The point whose law failed, or that is compressed most, for messages. Collective."""
        points, d = self.points, self.points.gdim
        found = None
        if len(points):
            dF = operator.points.gradient[0][:, :d, :d] + np.eye(d) if self._moves else None
            J = np.linalg.det(dF) if dF is not None else np.ones(len(points))
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
            f"{done:.4g} of the step: {self._advice()}"
        )

    def _advice(self) -> str:
        """What to do about a step that failed. Collective."""
        here = self.here
        assert here is not None
        first = here.fields[0]
        named = any(field.remedy.kind != "none" for field in self.fields)
        active = first.active[first.active < first.basis.nodes.owned]
        return advice(named or here.ghost_facets > 0, self.bcs, first.space, active)
