"""A preconditioner is kept while counted work says that it pays."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.solve import linearsolver
from dolfinmpm.solve import preconditionerreuse as reuse_module
from dolfinmpm.solve.preconditionerreuse import _OTHERWISE as OTHERWISE
from dolfinmpm.solve.preconditionerreuse import PreconditionerReuse, setup_cost, solution_cost


class Counted:
    """A Krylov solver, and its preconditioner, whose flops are set."""

    kept, flops, after, reason, most = False, 0.0, 1e-3, 2, 500

    def setReusePreconditioner(self, flag):
        self.kept = flag

    def getPC(self):
        return self

    def getType(self):
        return "a user's own"

    def setUp(self):
        pass

    def getConvergenceHistory(self):
        return np.array([1.0, self.after])

    def getIterationNumber(self):
        return 1

    def getTolerances(self):
        return 1e-5, 0.0, 1e5, self.most

    def getConvergedReason(self):
        return self.reason

    def setConvergedReason(self, reason):
        self.reason = reason

    def solve(self, reuse, cost):
        PETSc.Log.logFlops(cost / OTHERWISE[0])
        reuse.note(self)


def keeps(costs, setup, monkeypatch):
    """Whether each of several solutions is with a preconditioner that was kept."""
    monkeypatch.setattr(reuse_module, "setup_cost", lambda pc, flops: setup)
    reuse, ksp = PreconditionerReuse(MPI.COMM_SELF), Counted()
    kept = []
    for each in costs:
        reuse.prepare(ksp)
        kept.append(ksp.kept)
        ksp.solve(reuse, each)
    assert reuse.counts == (len(kept), kept.count(False))
    assert reuse.taken() == pytest.approx(
        (sum(costs) + setup * kept.count(False), len(kept), len(kept))
    )
    return kept


def test_a_preconditioner_is_kept_while_it_pays(monkeypatch):
    # beyond 1000 of a fresh one: 0, 1000, 2000, 3000. After that one costs 3000 more, and these
    # four were (8000 + 6000)/4 = 3500 each with their set-up; after 4000 it is (8000 + 10000)/5
    costs = (1e3, 2e3, 3e3, 4e3, 5.1e3, 1e3)
    assert keeps(costs, 8e3, monkeypatch) == [False, True, True, True, True, False]
    assert keeps((1e3, 1e3, 5e3, 1e3), 2e3, monkeypatch) == [False, True, True, False]


def test_what_did_not_pay_is_tried_more_rarely(monkeypatch):
    bad = [1e3, 9e3, 1e3, 9e3, 1e3, 1e3, 9e3, 1e3]
    assert keeps(bad, 2e3, monkeypatch) == [False, True, False, True, False, False, True, False]


def test_what_a_new_matrix_ends_is_tried_again(monkeypatch):
    """A preconditioner that another pattern of the matrix makes useless has not failed."""
    monkeypatch.setattr(reuse_module, "setup_cost", lambda pc, flops: 8e3)
    reuse, ksp = PreconditionerReuse(MPI.COMM_SELF), Counted()
    for _ in range(4):
        for old in (False, True):
            reuse.prepare(ksp)
            assert ksp.kept is old
            ksp.solve(reuse, 1e3)
        reuse.renew()


def test_what_failed_is_not_kept_again_in_the_next_iterations(monkeypatch):
    """Newton's method that begins again must not fail in the same way for ever."""
    monkeypatch.setattr(reuse_module, "setup_cost", lambda pc, flops: 8e3)
    reuse, ksp = PreconditionerReuse(MPI.COMM_SELF), Counted()
    for failures, fresh in ((1, 32), (2, 64)):
        for _ in range(2):
            reuse.prepare(ksp)
            ksp.solve(reuse, 1e3)
        assert reuse.old, failures
        reuse.distrust()
        for _ in range(fresh):
            reuse.prepare(ksp)
            assert not reuse.old
            ksp.solve(reuse, 1e3)


@pytest.mark.parametrize("after", [0.0, math.inf, math.nan])
def test_residuals_that_are_no_numbers_count_no_digits(monkeypatch, after):
    monkeypatch.setattr(reuse_module, "setup_cost", lambda pc, flops: 0.0)
    reuse, ksp = PreconditionerReuse(MPI.COMM_SELF), Counted()
    reuse.prepare(ksp)
    ksp.after = after
    ksp.solve(reuse, 1e3)
    assert reuse.iterations == [1]


def test_too_many_iterations_with_an_old_preconditioner_end_early(monkeypatch):
    """They end at two set-ups more than with a fresh one, which is made next; no failure."""
    monkeypatch.setattr(reuse_module, "setup_cost", lambda pc, flops: 8e3)
    reuse, ksp = PreconditionerReuse(MPI.COMM_SELF), Counted()
    reuse.prepare(ksp)
    assert reuse.most(1e-6, 500) == 500
    ksp.solve(reuse, 1e3)
    reuse.prepare(ksp)
    assert reuse.old
    # an iteration costs 1e3, and reduces the residual by three digits: 1.9 iterations, and 16.
    # A whole number would depend on the rounding of PETSc's count of flops
    assert reuse.most(2e-6, 500) == 18
    assert reuse.most(1e-6, 10) == 10
    ksp.most, ksp.reason = 1, PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT
    ksp.solve(reuse, 2e3)
    assert ksp.reason == PETSc.KSP.ConvergedReason.CONVERGED_ITS
    reuse.prepare(ksp)
    assert not reuse.old
    ksp.reason = PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT
    ksp.solve(reuse, 2e3)
    assert ksp.reason == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT


def test_old_factors_that_need_all_iterations_are_made_anew(monkeypatch):
    """PETSc calls their last iteration converged, see `krylov.create`, whatever it leaves."""
    monkeypatch.setattr(reuse_module, "setup_cost", lambda pc, flops: 8e3)
    reuse, ksp = PreconditionerReuse(MPI.COMM_SELF), Counted()
    ksp.reason = PETSc.KSP.ConvergedReason.CONVERGED_ITS
    for most, old in ((500, False), (500, True), (1, True), (1, False)):
        ksp.most = most
        reuse.prepare(ksp)
        assert reuse.old == old
        ksp.solve(reuse, 1e3)


def laplacian(n=30):
    """A symmetric positive definite matrix of n² unknowns."""
    A = PETSc.Mat().createAIJ((n * n, n * n), nnz=5, comm=PETSc.COMM_SELF)
    for i in range(n * n):
        for j in (i - n, i - 1, i, i + 1, i + n):
            if 0 <= j < n * n:
                A[i, j] = 4.1 if i == j else -1.0
    A.assemble()
    return A


@pytest.mark.parametrize(
    ("kind", "package"),
    [("lu", "mumps"), ("cholesky", "cholmod"), ("lu", "petsc"), ("ilu", ""), ("gamg", "")],
)
def test_what_a_set_up_and_a_solution_cost_is_counted(kind, package):
    """The same each time, more for more work, and more for a set-up than for a solution."""
    found = []
    for n in (30, 30, 60):
        A = laplacian(n)
        ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        ksp.setType("gmres")
        pc = ksp.getPC()
        pc.setType(kind)
        if package:
            pc.setFactorSolverType(package)
        ksp.setOperators(A)
        before = PETSc.Log.getFlops()
        ksp.setUp()
        between = PETSc.Log.getFlops()
        b, x = A.createVecRight(), A.createVecRight()
        b.set(1.0)
        pc.apply(b, x)
        after = PETSc.Log.getFlops()
        found.append((setup_cost(pc, between - before), solution_cost(pc, after - between)))
    assert found[0] == found[1]
    assert found[2][0] > 2 * found[0][0] > 2 * found[0][1] > 0
    assert found[2][1] > 2 * found[0][1]


def test_no_clock_decides():
    """Seconds are for records only: `seconds` of a step is all that a solver asks a clock for."""
    for path in Path(linearsolver.__file__).parent.glob("*.py"):
        for line in path.read_text().splitlines():
            if any(clock in line for clock in ("perf_counter", "process_time", "monotonic()")):
                assert line.strip().startswith(("started, watch = ", "record.seconds, ")), path
