"""The nonlinear system of one step: activate → evaluate → assemble → solve."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse

from dolfinmpm.assembly.cellmeans import CellCouplings, CellMeans, widen
from dolfinmpm.assembly.evaluation import PointEvaluator
from dolfinmpm.assembly.gridterms import OrdinaryAssembler
from dolfinmpm.assembly.points import Matrix, Pattern, add_blocks, multiply_blocks
from dolfinmpm.basis import Stencils
from dolfinmpm.basis.conditions import Condition, apply_conditions
from dolfinmpm.basis.space import Space, extraction
from dolfinmpm.body.points import ACTIVE_CELLS, GHOST_FACETS, MaterialPoints
from dolfinmpm.cut.active import active_cells, active_nodes, ghost_facets
from dolfinmpm.cut.prolongation import Prolongation, reduce_blocks
from dolfinmpm.cut.remedies import Stabilisation
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.forms.splitting import OrdinaryTerms, SplitForm
from dolfinmpm.solve.linesearch import SEARCHES, has_search, name_of, set_search
from dolfinmpm.solve.solver import Mumps, create_snes
from dolfinmpm.solve.unsoftened import Unsoftened

__all__ = ["NewtonSystem", "Prolongate"]

Array = npt.NDArray[np.float64]
Prolongate = Callable[[Stencils, npt.NDArray[np.int32]], sparse.spmatrix]

# PETSc's numbers for an error in an external library and for a zero pivot
_FACTORISATION = (76, 71)


class NewtonSystem:
    """Residual, tangent and solver of a split weak form on the active unknowns.

    Nothing here changes the points. `activate` finds stencils, unknowns, facets
    and the matrix's pattern for where they are; `solve` finds the increments, and
    leaves their values and gradients at the points in `evaluator`.

    Args:
        form: Split weak form.
        spaces: Spaces of the increments, all of one basis.
        points: Material points.
        bcs: Essential conditions.
        tolerance: Relative out-of-balance force to reach.
        max_iterations: Newton iterations allowed.
        prolongate: Function of stencils and active nodes that returns C, or None.
        stabilisation: Remedy against small cuts; its terms are in the form already.
        tangent_terms: Terms of the tangent only, or None.
        prefix: Prefix of the PETSc options.
        options: PETSc options without it.
    """

    def __init__(
        self,
        form: SplitForm,
        spaces: Sequence[Space],
        points: MaterialPoints,
        bcs: Sequence[Condition],
        tolerance: float,
        max_iterations: int,
        prolongate: Prolongate | None,
        stabilisation: Stabilisation,
        tangent_terms: OrdinaryTerms | None,
        prefix: str,
        options: dict[str, Any],
    ):
        self.comm: MPI.Intracomm = points.comm
        self.spaces = list(spaces)
        self.basis = spaces[0].basis
        self.components = sum(space.components for space in spaces)
        self.evaluator = PointEvaluator(form.points, spaces, points)
        self.ordinary = OrdinaryAssembler(form.ordinary, spaces) if form.has_ordinary else None
        self._tangent_only = OrdinaryAssembler(tangent_terms, spaces) if tangent_terms else None
        self.residuals: list[float] = []
        self.iterations = 0
        self._points = points
        self._stabilisation = stabilisation
        stabilisation.prepare(self.basis)
        self._bcs = list(bcs)
        self._tolerance = tolerance
        self._max_iterations = max_iterations
        self._prolongate = prolongate
        changing = any(condition.changes for condition in bcs)
        self._changing = self.comm.allreduce(changing, op=MPI.LOR)
        self._assemblers = [a for a in (self.ordinary, self._tangent_only) if a]
        self._moving = set().union(*(a.moving for a in self._assemblers))
        self._facets = ghost_facets(points.grid) if GHOST_FACETS in self._moving else None
        self._numbering: Any = None
        self._settings = prefix, options
        self._configure(prefix, options)
        self._set_numbering()

    def _configure(self, prefix: str, options: dict[str, Any]) -> None:
        database = PETSc.Options()
        for name, value in options.items():
            database[prefix + name] = value
        self._searches = () if has_search(prefix) else SEARCHES
        self._snes = create_snes(self.comm, prefix, bool(self._tangent_only))
        self._snes.setTolerances(rtol=0, atol=0, stol=0, max_it=self._max_iterations)
        self._snes.setFromOptions()
        self._mumps = Mumps(self._snes, self._points.gdim)
        if self._searches:
            self._search = self._searches[0]
            set_search(self._snes, prefix, self._search)

    # -- activate -------------------------------------------------------------

    def _set_numbering(self) -> None:
        """Arrays over the nodes, made again when the basis knows more nodes of other ranks."""
        if self._numbering is self.basis.nodes:
            return
        self._numbering = self.basis.nodes
        self.unknowns = Unknowns(self._numbering, self.components)
        vectors = [self._numbering.vector(self.components) for _ in range(4)]
        self._shared = dict(zip(("u", "r", "external", "lift"), vectors))
        self._unsoftened: Unsoftened | None = None
        if self._tangent_only:
            self._unsoftened = Unsoftened(self._numbering, self.components)
        shape = (self._numbering.size, self.components)
        self._u, self._r, self._external, self._lift = (v.array.reshape(shape) for v in vectors)
        self._touched: npt.NDArray[np.int32] = np.empty(0, np.int32)
        self._blocks: Any = None
        self._soft: Any = None
        self._filled: npt.NDArray[np.int32] = np.empty(0, np.int32)
        self._pattern: Any = None
        self._matrix: Any = None
        self._attached: dict[int, npt.NDArray[np.int32]] | None = None
        self._extraction = extraction(self.spaces[0])
        self._set_conditions(1.0)

    def _set_conditions(self, share: float) -> None:
        unknowns = self.unknowns
        apply_conditions(self._bcs, self.spaces, unknowns.fixed, unknowns.prescribed, share)
        if self.comm.size > 1:
            shared = self._numbering.vector(self.components)
            for values in (unknowns.fixed, unknowns.prescribed):
                shared.array[:] = values.ravel()
                shared.scatter_forward()
                values[:] = shared.array.reshape(values.shape)

    def activate(self, share: float) -> None:
        """Stencils, unknowns, facets and matrix for where the points are now. Collective.

        Args:
            share: Share of the step's prescribed increments to apply.
        """
        stencils = self.basis.stencils(self._points)
        self._set_numbering()
        if self._changing:
            self._set_conditions(share)
        nodes = active_nodes(stencils, self._numbering)
        self._cells = stencils
        # u_Lagrange = T x: what splines and ties make of the solver's unknowns
        self._T = self._extraction
        self._C: sparse.csr_matrix | None = None
        self._penalty: Any = None
        tie = self._ties(stencils, nodes)
        if self._numbering is not self.basis.nodes:
            # roots on other ranks: their nodes are known from now on
            return self.activate(share)
        if tie is not None:
            C = Prolongation(tie)
            self._C = C.matrix
            self._T = C.matrix if self._T is None else self._T @ C.matrix
            stencils = C.stencils(stencils)
            nodes = nodes[~C.tied[nodes]]
        couplings = None
        if self.evaluator.averages:
            means = CellMeans(self._points, self._cells, self.basis)
            couplings = CellCouplings(means, stencils, self._numbering, nodes)
            if not couplings.complete:
                widen(self.basis)
                return self.activate(share)
        self._stencils = stencils
        changed = self.unknowns.activate(nodes)
        if changed:
            for values in (self._u, self._r, self._external, self._lift):
                values[self._touched] = 0.0
            self._touched = nodes
        self.evaluator.start_step(stencils, couplings)
        if self._assemblers:
            self._attach()
        rows, columns = self._couplings()
        old = None if changed else self._pattern
        graph = stencils if couplings is None else couplings.graph()
        pattern = Pattern.build(graph, self.unknowns, rows, columns, old)
        # with its pattern a matrix keeps its symbolic factorisation; creating one is collective
        kept = pattern is old and self._matrix is not None
        if not self.comm.allreduce(kept, op=MPI.LAND):
            # the old matrix and its factors go before the new ones come: they are the largest
            self._snes.reset()
            self._matrix = None
            self._pattern = pattern
            self._matrix = Matrix(pattern, self.unknowns)
            size = (self.unknowns.owned, self.unknowns.total)
            self._x = PETSc.Vec().createMPI(size, comm=self.comm)
            self._snes.setFunction(self._residual, self._x.duplicate())
            tangent = self._matrix.petsc
            if self._unsoftened:
                true = self._unsoftened.operator(tangent, self._soft, self.unknowns)
                self._snes.setJacobian(self._jacobian, true, tangent)
            else:
                self._snes.setJacobian(self._jacobian, tangent)
            self._snes.setConvergenceTest(self._test)
            if self.unknowns.total:
                self._mumps.attach(self._matrix.petsc)
        self._assemble_external()

    @property
    def stencils(self) -> Stencils:
        """Stencils on all active nodes, before any prolongation."""
        return self._cells

    @property
    def active_nodes(self) -> npt.NDArray[np.int32]:
        """Active nodes, those that follow others included. Collective."""
        return active_nodes(self._cells, self._numbering)

    @property
    def active_cells(self) -> int:
        """Number of active cells on all ranks. Collective."""
        flags = active_cells(self._cells, self.basis.cells)
        return self.comm.allreduce(int(flags[: self.basis.cells.owned].sum()), op=MPI.SUM)

    @property
    def ghost_facets(self) -> int:
        """Number of ghost facets on all ranks that own them, 0 if no term asks. Collective."""
        rows = (self._attached or {}).get(GHOST_FACETS, np.empty(0, np.int32))
        return self.comm.allreduce(rows.size // 4, op=MPI.SUM)

    def assemble_ordinary(self) -> None:
        """Assemble again what DOLFINx integrates and is linear in the increments. Collective."""
        if self.ordinary is not None and self.ordinary.linear:
            self._blocks = self._reduced(self.ordinary)

    def _ties(self, stencils: Stencils, nodes) -> sparse.csr_matrix | None:
        """C of nodes that follow others; a weak one becomes a penalty instead. Collective."""
        remedy, fixed = self._stabilisation, self.unknowns.fixed
        C = remedy.ties(self._points, self.basis, stencils, nodes, fixed)
        if self._numbering is not self.basis.nodes:
            return None
        if C is not None and remedy.kind == "weak-aggregation":
            owned = nodes[: np.searchsorted(nodes, self._numbering.owned)]
            self._penalty = remedy.penalty(
                self._points, self.basis.degree, C, owned, self.components
            )
            C = None
        if self._prolongate is not None:
            own = sparse.csr_matrix(self._prolongate(stencils, nodes))
            C = own if C is None else C @ own
        return C

    def _attach(self) -> None:
        """Let DOLFINx integrate over the facets and cells that are active now. Collective."""
        entities: dict[int, npt.NDArray[np.int32]] = {}
        if self._moving:
            active = active_cells(self._cells, self.basis.cells)
            if self._facets is not None:
                entities[GHOST_FACETS] = self._facets.select(active, self.basis.cells)
            if ACTIVE_CELLS in self._moving:
                owned = np.flatnonzero(active[: self.basis.cells.owned])
                entities[ACTIVE_CELLS] = owned.astype(np.int32)
        same = self._attached is not None and all(
            np.array_equal(rows, self._attached[number]) for number, rows in entities.items()
        )
        # every rank keeps its forms or none does: creating them is collective
        if not self.comm.allreduce(same, op=MPI.LAND):
            for assembler in self._assemblers:
                assembler.attach(entities)
            self._attached = entities
        # what is linear in the increments is assembled once a step
        self.assemble_ordinary()
        self._soft = self._reduced(self._tangent_only) if self._tangent_only else None
        if self._unsoftened:
            self._unsoftened.renew(self._soft)

    def _reduced(self, assembler: OrdinaryAssembler | None) -> tuple[Any, Any, Any]:
        """Rows, columns and blocks of ordinary terms, on the solver's nodes."""
        assert assembler is not None
        blocks = assembler.rows, assembler.columns, assembler.jacobian()
        T = self._C if assembler.on_splines else self._T
        return blocks if T is None else reduce_blocks(T, *blocks)

    def _couplings(self):
        """Pairs of active nodes that terms other than the points' couple."""
        sets = [b for b in (self._blocks, self._penalty, self._soft) if b is not None]
        if self.ordinary and self._blocks is None:
            sets.append(self._reduced(self.ordinary))
        rows = np.concatenate([np.empty(0, np.int32), *(b[0] for b in sets)])
        columns = np.concatenate([np.empty(0, np.int32), *(b[1] for b in sets)])
        active = np.zeros(self._numbering.size, bool)
        active[self.unknowns.nodes] = True
        keep = active[rows] & active[columns]
        return rows[keep], columns[keep]

    def _assemble_external(self) -> None:
        out = self._external
        out[self._touched] = 0.0
        self.evaluator.add_external(out)
        if self.ordinary:
            self._add_ordinary(self.ordinary.add_external, out)
        if self.comm.size > 1:
            self._shared["external"].scatter_reverse(InsertMode.add)

    def _add_ordinary(self, add: Callable[[Array], None], out: Array) -> None:
        size = self._numbering.size if self._T is None else self._T.shape[0]
        part = np.zeros((size, self.components))
        add(part)
        if self._T is not None:
            part = self._T.T @ part
        nodes = self.unknowns.nodes
        out[nodes] += part[nodes]

    # -- evaluate and assemble ------------------------------------------------

    def _spread(self, x: Array) -> None:
        """Nodal increments of the unknowns x, on every rank that sees the nodes. Collective."""
        self.unknowns.scatter(x, self._u)
        if self.comm.size > 1:
            self._shared["u"].scatter_forward()
        self.evaluator.interpolate(self._u)

    def fill_functions(self) -> None:
        """Hand the increments to the DOLFINx functions."""
        u, nodes = self._u, self._touched
        if self._T is not None:
            u = self._T @ u
            nodes = np.arange(len(u), dtype=np.int32)
        start = 0
        for space in self.spaces:
            values = space.increment.x.array.reshape(-1, space.components)
            values[self._filled] = 0.0
            known = nodes[nodes < len(values)]
            values[known] = u[known, start : start + space.components]
            start += space.components
        self._filled = known

    def _add_internal(self) -> None:
        """Internal forces at the present increments, summed over ranks. Collective."""
        r = self._r
        r[self._touched] = 0.0
        if not self.evaluator.add_internal(r):
            # SNES sees on all ranks that the norm is not a number
            r[self._touched] = math.nan
        for blocks in (self._blocks, self._penalty):
            if blocks is not None:
                multiply_blocks(*blocks, self._u, r)
        if self.ordinary and not self.ordinary.linear:
            self.fill_functions()
            self._add_ordinary(self.ordinary.add_internal, r)
        if self.comm.size > 1:
            self._shared["r"].scatter_reverse(InsertMode.add)

    def _residual(self, snes, x, f) -> None:
        self._spread(x.getArray(readonly=True))
        self._add_internal()
        nodes = self.unknowns.owned_nodes
        internal, external = self._r[nodes], self._external[nodes]
        fixed = self.unknowns.fixed[nodes]
        f.getArray()[:] = (internal + external)[~fixed]
        # external forces, and reactions where they are what balances the internal ones
        square = np.sum(external[~fixed] ** 2) + np.sum(internal[fixed] ** 2)
        self._reference = math.sqrt(self.comm.allreduce(square, op=MPI.SUM))

    def _jacobian(self, snes, x, A, P) -> None:
        data = self._matrix.data
        data[:] = 0.0
        self._lift[self._touched] = 0.0
        sets: list[Any] = [self._blocks, self._penalty, self._soft]
        if self.ordinary and not self.ordinary.linear:
            self.fill_functions()
            sets.append(self._reduced(self.ordinary))
        for blocks in sets:
            if blocks is not None:
                rows, columns, values = blocks
                add_blocks(rows, columns, values, self.unknowns, self._pattern, data, self._lift)
        self.evaluator.add_tangent(self.unknowns, self._pattern, data, self._lift)
        self._matrix.finish()

    def tangent_matrix(self) -> PETSc.Mat:
        """Tangent stiffness of the active unknowns at the start of the step. Collective."""
        self._u[self._touched] = 0.0
        self.evaluator.interpolate(self._u)
        self._jacobian(None, None, None, None)
        return self._matrix.petsc

    # -- solve ----------------------------------------------------------------

    def solve(self) -> str | None:
        """Find the increments; returns why it did not, or None. Collective.

        Newton's method may cycle or overshoot where points begin and cease to yield. It then
        starts again with the other line search, and begins with that the next time.
        """
        self.iterations = 0
        reason = self._newton()
        for search in [s for s in self._searches if s != self._search]:
            # without a matrix the linear solver failed, which no line search helps
            if reason is None or self._matrix is None:
                break
            self._search = search
            set_search(self._snes, self._settings[0], search)
            reason = self._newton()
        return reason

    def _newton(self) -> str | None:
        unknowns = self.unknowns
        self.residuals = []
        self._reference = self._first = self._motion = 0.0
        x, snes = self._x, self._snes
        x.set(0.0)
        if unknowns.total == 0:
            self._spread(x.getArray(readonly=True))
            return None
        if self._changing and self._driven():
            self._predict(x)
        try:
            snes.solve(None, x)
        except PETSc.Error as error:
            return self._singular(error)
        krylov = self._tangent_only is not None
        self.iterations += snes.getIterationNumber() if krylov else snes.getLinearSolveIterations()
        reason = snes.getConvergedReason()
        if reason == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
            if self._mumps.enlarge(self._matrix.petsc):
                return self._newton()
            # factors that failed fail again, whatever the matrix: begin anew
            self._configure(*self._settings)
            self._pattern = self._matrix = None
        if reason <= 0:
            return name_of(reason)
        if not self.residuals or self.residuals[-1] > self._tolerance:
            # SNES has criteria of its own; only the out-of-balance force counts
            return f"{name_of(reason)} without balance"
        self._spread(x.getArray(readonly=True))
        return None

    def _singular(self, error: PETSc.Error) -> str:
        """Why the solver failed, if that is no fault of the program; else raises what it is."""
        # what PETSc was in the middle of cannot be gone on with
        self._configure(*self._settings)
        self._pattern = self._matrix = None
        cause = error.__cause__
        if cause is not None and not isinstance(cause, PETSc.Error):
            raise cause from None
        if error.ierr not in _FACTORISATION:
            raise error
        return "the linear solver failed: the tangent is singular"

    def _driven(self) -> bool:
        moved = any(np.any(condition.increment != 0.0) for condition in self._bcs)
        return self.comm.allreduce(moved, op=MPI.LOR)

    def _predict(self, x: PETSc.Vec) -> None:
        """First guess under prescribed increments: one linear step from rest, K x = −f − K g."""
        matrix = self.tangent_matrix()
        self._add_internal()
        if self.comm.size > 1:
            self._shared["lift"].scatter_reverse(InsertMode.add)
        nodes = self.unknowns.owned_nodes
        f = (self._r + self._external + self._lift)[nodes][~self.unknowns.fixed[nodes]]
        # a body without loads is measured against the forces that the motion would make
        self._motion = math.sqrt(self.comm.allreduce(float(f @ f), op=MPI.SUM))
        b = x.duplicate()
        b.getArray()[:] = -f
        ksp = self._snes.getKSP()
        ksp.setOperators(matrix)
        ksp.solve(b, x)
        self.iterations += 1

    def _test(self, snes, iteration, norms):
        residual = norms[2]
        if not math.isfinite(residual):
            return PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN
        if iteration == 0:
            self._first = residual
        # a body that is unloaded ends without loads and reactions to measure against
        reference = max(self._reference, self._first, self._motion)
        relative = residual / reference if reference else 0.0
        self.residuals.append(relative)
        if relative <= self._tolerance:
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE
        if iteration >= self._max_iterations:
            return PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        return PETSc.SNES.ConvergedReason.ITERATING
