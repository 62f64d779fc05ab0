"""Quasi-static steps: activate → solve → commit → move → migrate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.la import InsertMode
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse
from ufl.core.expr import Expr

from dolfinmpm.active import active_cells, active_nodes, ghost_facets
from dolfinmpm.assemble import (
    Matrix,
    Pattern,
    add_blocks,
    add_stiffness,
    add_vector,
    multiply_blocks,
)
from dolfinmpm.basis import Stencils
from dolfinmpm.boundary import Condition, apply_conditions
from dolfinmpm.errors import (
    ConvergenceError,
    FormError,
    ParameterError,
    PointsOutsideGridError,
    raise_together,
)
from dolfinmpm.evaluate import PointEvaluator, PointUpdates
from dolfinmpm.forms.split import split
from dolfinmpm.kinematics import update_domains
from dolfinmpm.locate import destinations
from dolfinmpm.ordinary import OrdinaryAssembler
from dolfinmpm.points import MaterialPoints
from dolfinmpm.prolong import Prolongation
from dolfinmpm.space import Space
from dolfinmpm.unknowns import Unknowns

__all__ = ["QuasiStatic", "StepRecord"]

Array = npt.NDArray[np.float64]
_REASONS = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}


@dataclass
class StepRecord:
    """What one call of `step` did.

    Attributes:
        iterations: Newton iterations, those of failed attempts included.
        residuals: Relative out-of-balance force after each iteration of the last
            (sub)step, the first before any.
        substeps: Converged parts that the step was made of.
        halvings: How often it was halved.
        unknowns: Unknowns in the last one.
        active_nodes: Active nodes in it.
        migrated: Points that changed rank.
        seconds: Wall time (s).
    """

    iterations: int = 0
    residuals: list[float] = field(default_factory=list)
    substeps: int = 0
    halvings: int = 0
    unknowns: int = 0
    active_nodes: int = 0
    migrated: int = 0
    seconds: float = 0.0


class QuasiStatic:
    """Quasi-static problem, solved step by step with Newton's method.

    Every step starts from the undeformed grid: the points find their stencils,
    the active unknowns are numbered, PETSc's SNES finds the increment for which
    the form vanishes, and only then the points' state is changed. A step that
    does not converge leaves the state as it was and is halved: the DOLFINx
    constants and functions in the form, which carry the load, then go from their
    values at the last converged step to those set by the user in parts, and so do
    prescribed increments.

    Args:
        form: Weak form, linear in the test functions; see `momentum`.
        increment: The function(s) solved for, `Space.increment`.
        points: Material points.
        bcs: Essential conditions.
        spaces: Spaces of the increments; found from them if left out.
        tolerance: Newton stops when the out-of-balance force is this share of
            external forces and reactions.
        max_iterations: Newton iterations before a step is halved.
        max_halvings: Halvings before a step is given up.
        updates: Fields of the points that a converged step sets to UFL
            expressions of state and increment, by name.
        prolongation: Function of the active nodes that returns a matrix C, shape
            (nodes, nodes), by which some nodes' values follow from others'.
        options_prefix: Prefix of the PETSc options that change the solver.
        petsc_options: Such options, without the prefix.

    Raises:
        FormError: A term of the form cannot be evaluated where it stands.
        ConflictingConditionsError: Two conditions contradict each other.
    """

    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        spaces: Sequence[Space] | None = None,
        tolerance: float = 1e-9,
        max_iterations: int = 20,
        max_halvings: int = 10,
        updates: dict[str, Expr] | None = None,
        prolongation: Callable[[npt.NDArray[np.int32]], sparse.spmatrix] | None = None,
        options_prefix: str = "mpm_",
        petsc_options: dict[str, Any] | None = None,
    ):
        increments = list(increment) if isinstance(increment, Sequence) else [increment]
        self.spaces = [_space_of(u, spaces) for u in increments]
        self.points = points
        self.comm: MPI.Comm = points.comm
        self.basis = self.spaces[0].basis
        if any(space.basis is not self.basis for space in self.spaces):
            raise ParameterError("all fields of a problem must have the same basis on one grid")
        if self.spaces[0].grid is not points.grid:
            raise ParameterError("the material points live on another grid than the increment")
        if not (math.isfinite(tolerance) and 0 < tolerance < 1):
            raise ParameterError(f"tolerance = {tolerance} must be between 0 and 1")
        self.bcs = list(bcs)
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self.max_halvings = max_halvings
        self.history: list[StepRecord] = []
        self._prolong = prolongation
        parts = split(form, self.spaces, points)
        self._evaluator = PointEvaluator(parts.points, self.spaces, points)
        self._updates = PointUpdates({**points.updates, **(updates or {})}, self.spaces, points)
        self._ordinary = (
            OrdinaryAssembler(parts.ordinary, self.spaces) if parts.has_ordinary else None
        )
        loads: list[Any] = list(parts.points.constants)
        loads += [function for function, _ in parts.points.functions]
        if self._ordinary:
            loads += self._ordinary.constants() + self._ordinary.functions()
        self._loads = _Loads(loads, [space.increment for space in self.spaces])
        self._facets = None
        if self._ordinary and self._ordinary.has_ghost:
            self._facets = ghost_facets(points.grid)
        self._components = sum(space.components for space in self.spaces)
        self._numbering: Any = None
        self._share = 1.0
        self._reference = 0.0
        self._record = StepRecord()
        self._snes = PETSc.SNES().create(self.comm)
        self._configure(options_prefix, petsc_options or {})
        self._set_numbering()

    # -- set-up ---------------------------------------------------------------

    def _configure(self, prefix: str, options: dict[str, Any]) -> None:
        snes = self._snes
        snes.setOptionsPrefix(prefix)
        snes.setType("newtonls")
        snes.setTolerances(rtol=0, atol=0, stol=0, max_it=self.max_iterations)
        ksp = snes.getKSP()
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
        database = PETSc.Options()
        if not database.hasName(prefix + "snes_linesearch_type"):
            database[prefix + "snes_linesearch_type"] = "basic"
        for name, value in options.items():
            database[prefix + name] = value
        snes.setFromOptions()
        snes.setConvergenceTest(self._test)

    def _set_numbering(self) -> None:
        """Arrays over the nodes, made again when the basis knows more nodes of other ranks."""
        if self._numbering is self.basis.nodes:
            return
        self._numbering = self.basis.nodes
        self.unknowns = Unknowns(self._numbering, self._components)
        self._u = self._numbering.vector(self._components)
        self._r = self._numbering.vector(self._components)
        self._external = self._numbering.vector(self._components)
        shape = (self._numbering.size, self._components)
        self._u_nodes = self._u.array.reshape(shape)
        self._r_nodes = self._r.array.reshape(shape)
        self._external_nodes = self._external.array.reshape(shape)
        self._touched = np.empty(0, np.int32)
        self._pattern: Pattern | None = None
        self._matrix: Matrix | None = None
        self._attached: npt.NDArray[np.int32] | None = None
        self._set_conditions(1.0)

    def _set_conditions(self, scale: float) -> None:
        unknowns = self.unknowns
        apply_conditions(self.bcs, self.spaces, unknowns.fixed, unknowns.prescribed, scale)
        if self.comm.size > 1:
            for values in (unknowns.fixed, unknowns.prescribed):
                shared = self._numbering.vector(self._components)
                shared.array[:] = values.ravel()
                shared.scatter_forward()
                values[:] = shared.array.reshape(values.shape)
        self._driven = bool(self.comm.allreduce(np.any(unknowns.prescribed != 0), op=MPI.LOR))

    # -- one step -------------------------------------------------------------

    def step(self) -> StepRecord:
        """Take one step to the load that the form's constants and functions now hold. Collective.

        Raises:
            ConvergenceError: The step did not converge, however small it was made.
            PointsOutsideGridError: Points would leave the grid; the state is that
                of the last converged part of the step.
        """
        started = time.perf_counter()
        self._record = record = StepRecord()
        self._loads.aim()
        done, share = 0.0, min(1.0, self._share)
        while done < 1.0:
            share = min(share, 1.0 - done)
            self._loads.set(done + share)
            reason = self._attempt(share)
            if reason is None:
                done = 1.0 if 1.0 - done - share < 1e-12 else done + share
                record.substeps += 1
                share = min(1.0, 2.0 * share)
                continue
            record.halvings += 1
            share *= 0.5
            if share < 0.5**self.max_halvings * (1 - 1e-9):
                self._loads.set(done)
                self._loads.release()
                raise ConvergenceError(self._failure(reason, done, 2 * share))
        self._share = share
        self._loads.release()
        record.seconds = time.perf_counter() - started
        self.history.append(record)
        return record

    def _attempt(self, share: float) -> str | None:
        """Solve and commit a share of the step; returns why not, the state being untouched."""
        stencils = self._activate(share)
        unknowns = self.unknowns
        x = PETSc.Vec().createMPI((unknowns.owned, unknowns.total), comm=self.comm)
        self._f = x.duplicate()
        if self._driven:
            self._predict(x)
        snes = self._snes
        snes.reset()
        snes.setFunction(self._residual, self._f)
        snes.setJacobian(self._jacobian, self._matrix.petsc)
        snes.setConvergenceTest(self._test)
        self._residuals: list[float] = []
        if unknowns.total:
            snes.solve(None, x)
            reason = snes.getConvergedReason()
            self._record.iterations += snes.getLinearSolveIterations()
        else:
            reason = 1
        self._record.residuals = self._residuals
        self._record.unknowns = unknowns.total
        self._record.active_nodes = self.comm.allreduce(unknowns.owned_nodes.size, op=MPI.SUM)
        if reason <= 0:
            return _REASONS.get(reason, str(reason))
        self._spread(x.getArray(readonly=True))
        return self._commit(stencils)

    def _activate(self, share: float) -> Stencils:
        """Stencils, unknowns, facets and matrix for where the points are now. Collective."""
        stencils = self.basis.stencils(self.points)
        self._set_numbering()
        if self._driven or share != 1.0:
            self._set_conditions(share)
        self._stencils_all = stencils
        nodes = active_nodes(stencils, self._numbering)
        self._C: Prolongation | None = None
        if self._prolong is not None:
            self._C = Prolongation(self._prolong(nodes))
            stencils = self._C.stencils(stencils)
            self._all_nodes = nodes
            nodes = nodes[~self._C.tied[nodes]]
        changed = self.unknowns.activate(nodes)
        self._stencils = stencils
        if changed:
            for values in (self._u_nodes, self._r_nodes, self._external_nodes):
                values[self._touched] = 0.0
            self._touched = nodes
        self._evaluator.start_step(stencils)
        rows = columns = np.empty(0, np.int32)
        if self._ordinary:
            self._attach(stencils)
            rows, columns = self._couplings()
        old = None if changed else self._pattern
        pattern = Pattern.build(stencils, self.unknowns, rows, columns, old)
        kept = pattern is old and self._matrix is not None
        if not self.comm.allreduce(kept, op=MPI.LAND):
            self._pattern = pattern
            self._matrix = Matrix(pattern, self.unknowns)
        self._lift = np.zeros(self.unknowns.local)
        self._assemble_external()
        return stencils

    def _attach(self, stencils: Stencils) -> None:
        facets = None
        if self._facets is not None:
            active = active_cells(stencils, self.basis.cells)
            facets = self._facets.select(active, self.basis.cells)
        same = self._attached is not None and (
            facets is None or np.array_equal(facets, self._attached)
        )
        # every rank keeps its forms or none does: creating them is collective
        if not self.comm.allreduce(same, op=MPI.LAND):
            self._ordinary.attach(facets)
            self._attached = np.empty(0, np.int32) if facets is None else facets
        self._blocks = self._ordinary.jacobian() if self._ordinary.linear else None

    def _couplings(self):
        """Pairs of nodes that the ordinary terms couple, among the active ones."""
        rows, columns = self._ordinary.rows, self._ordinary.columns
        if self._C is not None:
            blocks = self._blocks if self._blocks is not None else self._ordinary.jacobian()
            rows, columns, blocks = self._C.reduce(rows, columns, blocks, self._components)
            if self._blocks is not None:
                self._blocks = blocks
            self._reduced = rows, columns
        active = np.zeros(self._numbering.size, bool)
        active[self.unknowns.nodes] = True
        keep = active[rows] & active[columns]
        return rows[keep], columns[keep]

    def _linear_part(self):
        rows, columns = self._ordinary.rows, self._ordinary.columns
        if self._C is not None:
            rows, columns = self._reduced
        return rows, columns, self._blocks

    def _assemble_external(self) -> None:
        out = self._external_nodes
        out[self._touched] = 0.0
        flux = self._evaluator.external_flux()
        if flux is not None:
            add_vector(self._stencils, flux, out)
        if self._ordinary:
            self._add_ordinary(self._ordinary.add_external, out)
        if self.comm.size > 1:
            self._external.scatter_reverse(InsertMode.add)

    def _add_ordinary(self, add: Callable[[Array], None], out: Array) -> None:
        """Add a vector of DOLFINx's on the grid to the one of the solver's nodes."""
        part = np.zeros_like(out)
        add(part)
        if self._C is not None:
            part = self._C.reduce_vector(part)
        nodes = self.unknowns.nodes
        out[nodes] += part[nodes]

    # -- what SNES calls ------------------------------------------------------

    def _spread(self, x: Array) -> None:
        """Nodal increments of the unknowns x, on every rank that sees the nodes. Collective."""
        self.unknowns.scatter(x, self._u_nodes)
        if self.comm.size > 1:
            self._u.scatter_forward()
        self._evaluator.interpolate(self._u_nodes)

    def _fill_functions(self) -> None:
        """Hand the increments to DOLFINx."""
        u, nodes = self._u_nodes, self._touched
        if self._C is not None:
            u, nodes = self._C.expand(u), self._all_nodes
        start = 0
        for space in self.spaces:
            end = start + space.components
            values = space.increment.x.array.reshape(-1, space.components)
            values[:] = 0.0
            known = nodes[nodes < len(values)]
            values[known] = u[known, start:end]
            start = end

    def _residual(self, snes, x, f) -> None:
        self._spread(x.getArray(readonly=True))
        r = self._r_nodes
        r[self._touched] = 0.0
        flux = self._evaluator.flux()
        if flux is None:
            # SNES sees that the norm is not a number, on all ranks
            r[self._touched] = math.nan
        else:
            add_vector(self._stencils, flux, r)
        if self._ordinary:
            if self._ordinary.linear:
                if self._ordinary.has_jacobian:
                    multiply_blocks(*self._linear_part(), self._u_nodes, r)
            else:
                self._fill_functions()
                self._add_ordinary(self._ordinary.add_internal, r)
        if self.comm.size > 1:
            self._r.scatter_reverse(InsertMode.add)
        nodes = self.unknowns.owned_nodes
        internal, external = r[nodes], self._external_nodes[nodes]
        fixed = self.unknowns.fixed[nodes]
        f.getArray()[:] = (internal + external)[~fixed]
        square = np.sum(external[~fixed] ** 2) + np.sum(internal[fixed] ** 2)
        self._reference = math.sqrt(self.comm.allreduce(square, op=MPI.SUM))

    def _jacobian(self, snes, x, A, P) -> None:
        matrix = self._matrix
        matrix.data[:] = 0.0
        self._lift[:] = 0.0
        if self._ordinary and self._ordinary.has_jacobian:
            if self._ordinary.linear:
                rows, columns, blocks = self._linear_part()
            else:
                self._fill_functions()
                blocks = self._ordinary.jacobian()
                rows, columns = self._ordinary.rows, self._ordinary.columns
                if self._C is not None:
                    rows, columns, blocks = self._C.reduce(rows, columns, blocks, self._components)
            add_blocks(rows, columns, blocks, self.unknowns, self._pattern, matrix.data, self._lift)
        tangent = self._evaluator.tangent()
        if tangent is not None:
            add_stiffness(
                self._stencils, tangent, self._evaluator.gradient_only, self.unknowns,
                self._pattern, matrix.data, self._lift,
            )  # fmt: skip
        matrix.finish()

    def _test(self, snes, iteration, norms):
        residual = norms[2]
        if not math.isfinite(residual):
            return PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN
        if self._reference == 0.0:
            self._reference = self._first if iteration else residual
        if iteration == 0:
            self._first = residual
        relative = residual / self._reference if self._reference else 0.0
        self._residuals.append(relative)
        if relative <= self.tolerance:
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE
        if iteration >= self.max_iterations:
            return PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        return PETSc.SNES.ConvergedReason.ITERATING

    def _predict(self, x: PETSc.Vec) -> None:
        """First guess under prescribed increments: one linear step from rest."""
        raise NotImplementedError

    # -- the end of a step ----------------------------------------------------

    def _commit(self, stencils: Stencils) -> str | None:
        """Write the converged state, move the points; returns why not, the state untouched."""
        points, evaluator, d = self.points, self._evaluator, self.points.gdim
        moving = self.spaces[0].components == d and self.spaces[0].increment.ufl_shape == (d,)
        new: dict[str, Array] = evaluator.commit()
        new |= self._updates.run(evaluator)
        if moving:
            dF = evaluator.gradient[:, :d] + np.eye(d)
            new["F"] = np.ascontiguousarray(dF @ points["F"])
            J = np.linalg.det(new["F"])
            new["V"] = J * points["V0"]
            new["x"] = points["x"] + evaluator.value[:, :d]
            new["l"] = update_domains(new["F"], points["l0"])
            bad = np.flatnonzero(~(J > 0))
            evaluator.failed_point = int(bad[0]) if bad.size else -1
        finite = all(np.isfinite(values).all() for values in new.values())
        ok = finite and evaluator.failed_point < 0
        if not self.comm.allreduce(ok, op=MPI.LAND):
            return "a material point's state is not finite or its volume not positive"
        to = None
        if moving:
            to = destinations(points.grid, new["x"], points["cell"])
            raise_together(self.comm, self._outside(new["x"], to.rank))
        for name, values in new.items():
            points.fields[name][...] = values
        self._loads.commit()
        if to is not None:
            self._record.migrated += points.migrate(to)
        return None

    def _outside(self, x: Array, rank) -> PointsOutsideGridError | None:
        lost = np.flatnonzero(rank < 0)
        if lost.size == 0:
            return None
        p = lost[0]
        return PointsOutsideGridError(
            f"{lost.size} material points would leave the grid in step {len(self.history) + 1}; "
            f"point {self.points['id'][p]} goes from {self.points['x'][p]} m to {x[p]} m. The state "
            "is that before it: enlarge the grid or hold the points with boundary conditions"
        )

    def _failure(self, reason: str, done: float, share: float) -> str:
        p = self._evaluator.failed_point
        places = ""
        if len(self.points):
            if p < 0:
                dF = self._evaluator.gradient[:, : self.points.gdim] + np.eye(self.points.gdim)
                p = int(np.argmin(np.nan_to_num(np.linalg.det(dF), nan=-np.inf)))
            dF = self._evaluator.gradient[p, : self.points.gdim] + np.eye(self.points.gdim)
            places = (
                f"the worst point is {self.points['id'][p]} at {self.points['x'][p]} m with "
                f"det ΔF = {np.linalg.det(dF):.4g}"
            )
        worst = [w for w in self.comm.allgather((self._evaluator.failed_point >= 0, places)) if w[1]]
        place = max(worst)[1] if worst else "no rank has points"
        last = f"{self._residuals[-1]:.3g}" if self._residuals else "none"
        return (
            f"step {len(self.history) + 1} failed at {done + share:.4g} of its load "
            f"({self._loads.describe()}) with parts of {share:.3g}: SNES says {reason}, the relative "
            f"out-of-balance force is {last} (tolerance {self.tolerance:g}); {place}. The state is "
            f"that at {done:.4g} of the step: take smaller steps or add stabilisation"
        )


def _space_of(increment: fem.Function, spaces: Sequence[Space] | None) -> Space:
    for space in spaces or ():
        if space.increment is increment:
            return space
    owner = getattr(increment, "_dolfinmpm_space", None)
    if owner is None:
        raise FormError(f"'{increment}' is not the increment of a dolfinmpm.Space")
    return owner


class _Loads:
    """The constants and functions of a form, taken from their last converged values to new ones."""

    def __init__(self, items: Sequence[Any], increments: Sequence[Any]):
        self._items: list[Any] = []
        for item in items:
            if not any(item is known for known in (*self._items, *increments)):
                self._items.append(item)
        self._start = self._read()
        self._target = self._read()

    @staticmethod
    def _array(item) -> Array:
        return item.x.array if isinstance(item, fem.Function) else item.value

    def _read(self) -> list[Array]:
        return [np.array(self._array(item), copy=True) for item in self._items]

    def aim(self) -> None:
        """Take the present values as the load to reach."""
        self._target = self._read()

    def set(self, share: float) -> None:
        """Set that share of the way."""
        for item, start, target in zip(self._items, self._start, self._target):
            values = target if share >= 1.0 else start + share * (target - start)
            self._array(item)[...] = values

    def commit(self) -> None:
        """Nothing to keep between parts of a step: shares count from the step's start."""

    def release(self) -> None:
        """The present values are those of a converged state."""
        self._start = self._read()

    def describe(self) -> str:
        """The constants' present values."""
        values = [f"{item.value}" for item in self._items if isinstance(item, fem.Constant)]
        return "constants " + ", ".join(values) if values else "no constants"
