"""Quasi-static steps: activate → solve → commit → move → migrate."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import (
    CheckpointError,
    ConvergenceError,
    FormError,
    ParameterError,
    PointsOutsideGridError,
    call_together,
    raise_together,
)
from dolfinmpm.assembly.evaluation import PointUpdates
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.basis.space import Space
from dolfinmpm.body.location import destinations
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.remedies import Stabilisation
from dolfinmpm.forms.splitting import split
from dolfinmpm.grid.lattice import cell_size
from dolfinmpm.io import checkpoint
from dolfinmpm.kinematics import parameters_at, update_domains
from dolfinmpm.materials.base import Law
from dolfinmpm.solve.loads import Loads
from dolfinmpm.solve.memory import loads_of, memory_of, set_loads, set_memory
from dolfinmpm.solve.newton import NewtonSystem, Prolongate

__all__ = ["QuasiStatic", "StepRecord"]


@dataclass
class StepRecord:
    """What one call of `step` did.

    Attributes:
        iterations: Newton iterations, those of failed attempts included.
        residuals: Relative out-of-balance force before and after each iteration
            of the last part of the step.
        parts: Converged parts that the step was made of.
        halvings: How often it was halved.
        unknowns: Unknowns in the last part.
        migrated: Points that changed rank.
        seconds: Wall time (s).
    """

    iterations: int = 0
    residuals: list[float] = field(default_factory=list)
    parts: int = 0
    halvings: int = 0
    unknowns: int = 0
    migrated: int = 0
    seconds: float = 0.0


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
            one with its usual parameters.
        prolongation: Function of stencils and active nodes that returns a matrix C,
            shape (nodes, nodes), by which some nodes' values follow from others'.
        options_prefix: Prefix of the PETSc options that change the solver.
        petsc_options: Such options, without the prefix.

    Attributes:
        history: One record a step.
        bcs: The essential conditions.
        stabilisation: The remedy with all its parameters.
        system: The nonlinear system of the present step.

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
        stabilisation: Stabilisation | str = "none",
        prolongation: Prolongate | None = None,
        options_prefix: str = "mpm_",
        petsc_options: dict[str, Any] | None = None,
    ):
        increments = list(increment) if isinstance(increment, Sequence) else [increment]
        spaces = [_space_of(u) for u in increments]
        if any(space.basis is not spaces[0].basis for space in spaces):
            raise ParameterError("all fields of a problem must have the same basis on one grid")
        if spaces[0].grid is not points.grid:
            raise ParameterError("the material points live on another grid than the increment")
        if not (math.isfinite(tolerance) and 0 < tolerance < 1):
            raise ParameterError(f"tolerance = {tolerance} must be between 0 and 1")
        if max_iterations < 1 or max_halvings < 0:
            raise ParameterError(
                f"max_iterations = {max_iterations} must be at least 1, max_halvings = "
                f"{max_halvings} at least 0"
            )
        for condition in bcs:
            if not isinstance(condition, Condition):
                raise ParameterError(
                    f"bcs holds a {type(condition).__name__}; use mpm.fixed, mpm.rollers or "
                    "mpm.prescribed"
                )
        self.points = points
        self.comm: MPI.Intracomm = points.comm
        self.max_halvings = max_halvings
        self.history: list[StepRecord] = []
        self.bcs = list(bcs)
        self.stabilisation = remedy = _with_modulus(stabilisation, form, points)
        trial = increments[0], spaces[0].test
        extra = remedy.force_terms(points, *trial)
        parts = split(form if extra is None else form + extra, spaces, points)
        tangent = remedy.tangent_terms(points, *trial)
        tangent_terms = None if tangent is None else split(tangent, spaces, points).ordinary
        self.system = self._system_of(
            parts, spaces, points, bcs, tolerance, max_iterations, prolongation, remedy,
            tangent_terms, options_prefix, petsc_options or {},
        )  # fmt: skip
        self._tolerance = tolerance
        self._updates = PointUpdates({**points.updates, **(updates or {})}, spaces, points)
        loads: list[Any] = list(parts.points.constants)
        loads += [function for function, _ in parts.points.functions]
        if self.system.ordinary:
            loads += self.system.ordinary.constants() + self.system.ordinary.functions()
        for condition in bcs:
            if any(condition.value is load for load in loads):
                raise ParameterError(
                    f"a constant is both a load of the form and the increment prescribed at "
                    f"'{condition.where}'; a part of a step would scale it twice: use two constants"
                )
        self._loads = Loads(loads, increments)
        self._moves = increments[0].ufl_shape == (points.gdim,)
        h = cell_size(points.grid)
        sizes = h.x.array if isinstance(h, fem.Function) else np.array([h.value])
        self._cell_size = self.comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX)
        self._share = 1.0
        self._record = StepRecord()

    def _system_of(self, *arguments: Any) -> NewtonSystem:
        """The nonlinear system; solvers with more equations make another."""
        return NewtonSystem(*arguments)

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
        self._record = record = StepRecord()
        self._loads.aim()
        done, share = 0.0, self._share
        try:
            while done < 1.0:
                share = min(share, 1.0 - done)
                self._loads.set(done + share)
                reason = self._attempt(share)
                if reason is None:
                    done = 1.0 if 1.0 - done - share < 1e-12 else done + share
                    record.parts += 1
                    share = min(1.0, 2.0 * share)
                    continue
                if share * (1 + 1e-9) < 2 * 0.5**self.max_halvings:
                    raise ConvergenceError(self._failure(reason, done, share))
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
        history = [asdict(record) for record in self.history]
        checkpoint.write(path, self.points, state, local, history, cells)

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
        was; else to rounding.

        Args:
            path: The file.

        Raises:
            CheckpointError: The file is missing, cut short, damaged, of a newer version, of
                another grid or of another problem, or h5py is missing. The state is then
                what it was.
        """
        found = checkpoint.read(path, self.points)
        raise_together(self.comm, self._mismatch(os.fspath(path), found.state))
        found.put(self.points)
        self._remember(found.state, found.local, found.cells)
        names = {f.name for f in fields(self._of_step)}
        self.history = [
            self._of_step(**{k: v for k, v in row.items() if k in names}) for row in found.history
        ]

    def _problem(self) -> dict[str, Any]:
        """What a checkpoint must have in common with this problem."""
        constants = [bc.value for bc in self.bcs if isinstance(bc.value, fem.Constant)]
        return {
            "solver": type(self).__name__,
            "unknown fields": str([space.increment.ufl_shape for space in self.system.spaces]),
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
        state, local = memory_of(self.system)
        loads, cells = loads_of(self._loads)
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
        set_memory(self.system, state, local)

    def stiffness(self) -> PETSc.Mat:
        """Tangent stiffness of the active unknowns in the present state. Collective."""
        self.system.activate(1.0)
        return self.system.tangent_matrix()

    def _attempt(self, share: float) -> str | None:
        """Solve and commit a share of the step; returns why not, the state being untouched."""
        system = self.system
        raise_together(self.comm, self.points.fault())
        system.activate(share)
        reason = system.solve()
        self._record.iterations += system.iterations
        self._record.residuals = system.residuals
        self._record.unknowns = system.unknowns.total
        return self._commit() if reason is None else reason

    def _commit(self) -> str | None:
        """Write the converged state and move the points; returns why not, the state untouched."""
        points, evaluator, d = self.points, self.system.evaluator, self.points.gdim
        new = evaluator.commit()
        new |= self._updates.run(evaluator)
        bad: npt.NDArray[np.intp] = np.empty(0, np.intp)
        if self._moves:
            dF = evaluator.gradient[:, :d] + np.eye(d)
            new["F"] = np.ascontiguousarray(dF @ points["F"])
            J = np.linalg.det(new["F"])
            bad = np.flatnonzero(~(J > 0))
            new["V"] = J * points["V0"]
            new["x"] = points["x"] + evaluator.value[:, :d]
            if self.system.basis.averaged:
                new["l"] = update_domains(new["F"], points["l0"])
        finite = all(np.isfinite(values).all() for values in new.values())
        if not self.comm.allreduce(finite and bad.size == 0, op=MPI.LAND):
            evaluator.failed_point = int(bad[0]) if bad.size else evaluator.failed_point
            return "a material point's state is not finite or its volume not positive"
        destination = None
        if self._moves:
            destination = destinations(points.grid, new["x"], points["cell"])
            lost = np.flatnonzero(destination.rank < 0)
            far = np.any(np.abs(evaluator.value[lost, :d]) > self._cell_size)
            if self.comm.allreduce(bool(far), op=MPI.LOR):
                # Newton may find a state of equilibrium on the far side of a singular one
                return "material points would be thrown out of the grid, further than a cell"
            raise_together(self.comm, self._outside(new["x"], lost))
        for name, values in new.items():
            points.fields[name][...] = values
        self.system.fill_functions()
        if destination is not None:
            self._record.migrated += points.migrate(destination)
        return None

    def _outside(self, x, lost) -> PointsOutsideGridError | None:
        if lost.size == 0:
            return None
        p = lost[0]
        return PointsOutsideGridError(
            f"{lost.size} material points would leave the grid in step {len(self.history) + 1}; "
            f"point {self.points['id'][p]} goes from {self.points['x'][p]} m to {x[p]} m. The "
            "state is that before it: enlarge the grid or hold the points with boundary conditions"
        )

    def _worst(self) -> str:
        """The point whose law failed, or that is compressed most, for messages. Collective."""
        points, evaluator, d = self.points, self.system.evaluator, self.points.gdim
        found = None
        if len(points):
            dF = evaluator.gradient[:, :d, :d] + np.eye(d) if self._moves else None
            J = np.linalg.det(dF) if dF is not None else np.ones(len(points))
            failed = evaluator.failed_point >= 0
            p = evaluator.failed_point if failed else int(np.argmin(np.nan_to_num(J, nan=-np.inf)))
            place = f"point {points['id'][p]} at {points['x'][p]} m with det ΔF = {J[p]:.4g}"
            cause = evaluator.failure()
            place += f": {cause}" if cause else ""
            found = (not failed, np.nan_to_num(J[p], nan=-np.inf), place)
        candidates = [c for c in self.comm.allgather(found) if c is not None]
        return min(candidates)[2] if candidates else "none"

    def _failure(self, reason: str, done: float, share: float) -> str:
        last = f"{self.system.residuals[-1]:.3g}" if self.system.residuals else "none"
        return (
            f"step {len(self.history) + 1} failed at {done + share:.4g} of its load "
            f"({self._loads.describe()}) with parts of {share:.3g}: SNES says {reason}, the "
            f"relative out-of-balance force is {last} (tolerance {self._tolerance:g}); the worst "
            f"is {self._worst()}. The state is that at {done:.4g} of the step: take smaller steps "
            "or add stabilisation"
        )


def _with_modulus(
    stabilisation: Stabilisation | str, form: ufl.Form, points: MaterialPoints
) -> Stabilisation:
    """The remedy with the moduli of the form's law where it names none. Collective.

    Of moduli that vary from point to point it takes the largest: too stiff a penalty
    costs less than one that leaves the stiffest cells ill-conditioned.
    """
    remedy = Stabilisation(stabilisation) if isinstance(stabilisation, str) else stabilisation
    if not isinstance(form, ufl.Form):
        raise FormError(f"the weak form must be a UFL form, got {type(form).__name__}")
    if not remedy.needs_modulus or remedy.E is not None:
        return remedy
    integrands = [integral.integrand() for integral in form.integrals()]
    for coefficient in (c for i in integrands for c in extract_coefficients(i)):
        law = getattr(getattr(coefficient, "law", None), "law", None)
        if law is not None and "E" in law.values:
            E, nu = _largest(law, points, "E"), _largest(law, points, "nu")
            return replace(remedy, E=E, nu=nu)
    raise ParameterError(
        f'stabilisation="{remedy.kind}" needs a modulus, and no law in the form has one: give '
        f'mpm.Stabilisation("{remedy.kind}", E=...)'
    )


def _largest(law: Law, points: MaterialPoints, name: str) -> float:
    """Largest value of a parameter over the points of all ranks; 0 if it has none. Collective."""
    if name not in law.values:
        return 0.0
    column = list(law.parameters).index(name)
    values = call_together(points.comm, lambda: parameters_at(law, points)[:, column])
    return float(points.comm.allreduce(values.max(initial=-math.inf), op=MPI.MAX))


def _space_of(increment: fem.Function) -> Space:
    space = getattr(increment, "_dolfinmpm_space", None)
    if space is None:
        raise FormError(f"'{increment}' is not the increment of a dolfinmpm.Space")
    return space
