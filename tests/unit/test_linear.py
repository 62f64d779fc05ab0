"""Linear solvers: what is chosen for which tangent, and what happens where it fails."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem
from petsc4py import PETSc

import dolfinmpm as mpm
from dolfinmpm.solve import krylov, method
from dolfinmpm.solve.linearsolver import LinearSolver
from dolfinmpm.solve.method import SUBSTRUCTURES, Tangent, choose
from dolfinmpm.solve.schur import schur_matrix
from dolfinmpm.solve.solverchoice import IncompleteFactorsChoice, MethodChoice

ELASTIC = {"E": 1e3, "nu": 0.3}


def block(
    cells=4, kind="quadrilateral", law=None, basis="linear", load=-1.0, extra=None, **options
):
    """A block that stands on the bottom of a unit grid and is loaded by its weight."""
    grid = unit_grid(kind, cells)
    d = grid.geometry.dim
    points = mpm.fill(grid, mpm.Box((0,) * d, (0.9,) * (d - 1) + (0.6,)), 2, 1.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0,) * (d - 1) + (load,))
    F = mpm.momentum(law or mpm.materials.Hencky(**ELASTIC), points, u, v, **(extra or {}))
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.fixed(V, lambda x: x[d - 1] < 1e-9) + mpm.rollers(V, "left")
    return mpm.QuasiStatic(F, u, points, bcs, **options)


def chosen(problem):
    problem.step()
    found = problem.newton.linear.method
    return found.ksp, found.pc, found.package


def few_at_all(monkeypatch):
    """As if a handful of unknowns were too many for factors."""
    for name in ("_CROSSOVER", "_CROSSOVER_OF_WIDE"):
        monkeypatch.setattr(method, name, {1: 10**9, 2: 20, 3: 20})
    few = {degree: {1: 10**9, 2: 20, 3: 20} for degree in (1, 2, 3)}
    monkeypatch.setattr(method, "_CROSSOVER_ON_LATTICE", few)


@pytest.fixture
def few_are_many(monkeypatch):
    """As if a handful of unknowns were too many for factors."""
    few_at_all(monkeypatch)


@pytest.mark.parametrize(
    ("tangent", "count", "gdim", "ranks", "expected"),
    [
        (Tangent(True, True, False), 1000, 2, 1, ("preonly", "cholesky", "cholmod")),
        (Tangent(True, True, False), 1000, 2, 2, ("preonly", "cholesky", "mumps")),
        (Tangent(True, False, False), 1000, 2, 1, ("preonly", "cholesky", "mumps")),
        (Tangent(False, True, False), 1000, 3, 1, ("preonly", "lu", "mumps")),
        (Tangent(True, True, True), 1000, 2, 1, ("gmres", "cholesky", "cholmod")),
        (Tangent(True, True, False), 10**6, 3, 1, ("cg", "gamg", "")),
        (Tangent(False, True, False), 10**6, 3, 1, ("gmres", "gamg", "")),
        (Tangent(True, True, False, degree=1), 10**6, 3, 1, ("cg", "mg", "")),
        (Tangent(False, True, False, degree=2), 10**6, 2, 1, ("gmres", "mg", "")),
        (Tangent(False, False, False, 2, True, degree=1), 10**6, 3, 1, ("gmres", "fieldsplit", "")),
        (Tangent(False, False, False, 2, True), 10**6, 3, 1, ("gmres", "fieldsplit", "")),
        (Tangent(False, False, False, 2, False), 10**6, 3, 1, ("gmres", "lu", "mumps")),
        (Tangent(False, False, False, 3, True), 100, 3, 1, ("preonly", "lu", "mumps")),
    ],
)
def test_what_is_chosen(tangent, count, gdim, ranks, expected):
    found = choose(tangent, count, gdim, ranks)
    assert (found.ksp, found.pc, found.package) == expected
    assert str(count) in str(found)


@pytest.mark.parametrize(
    ("wide", "count", "smoother"), [(False, 9000, "jacobi"), (True, 60000, "sor")]
)
def test_wide_functions_are_smoothed_by_gauss_seidel_and_solved_directly_for_longer(
    wide, count, smoother
):
    tangent = Tangent(True, True, False, wide=wide)
    assert choose(tangent, count - 1, 3, 1).factors
    found = choose(tangent, count, 3, 1)
    assert found.pc == "gamg"
    assert found.options["mg_levels_pc_type"] == smoother
    assert choose(tangent, 10**6, 2, 1).options["mg_levels_pc_type"] == "jacobi"


def test_several_ranks_take_a_substructure_each_where_they_may():
    tangent = Tangent(True, True, False)
    assert choose(tangent, 1000, 2, 2, substructures=True).package == SUBSTRUCTURES
    assert "CHOLMOD in substructures" in str(choose(tangent, 1000, 2, 2, substructures=True))
    assert choose(tangent, 1000, 2, 1, substructures=True).package == "cholmod"
    assert choose(Tangent(True, False, False), 1000, 2, 2, substructures=True).package == "mumps"


def test_laws_say_whether_they_are_symmetric():
    materials = mpm.materials
    strength = {"cohesion": 10.0, "friction_angle": 20.0}
    assert chosen(block(law=materials.VonMises(**ELASTIC, radius=5.0)))[1] == "cholesky"
    assert chosen(block(law=materials.NeoHookean(**ELASTIC)))[1] == "cholesky"
    assert chosen(block(law=materials.MohrCoulomb(**ELASTIC, **strength)))[1] == "lu"
    assert chosen(block(extra={"fbar": True}))[1] == "lu"
    assert chosen(block(extra={"strain": "jaumann"}))[1] == "lu"


def tangent_with(term):
    """Method for a block with a further term, a function of increment, test function and points."""
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (0.9, 0.6)), 2, 1.0)
    V = mpm.Space(grid)
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(**ELASTIC), points, u, v)
    F -= ufl.inner(ufl.as_vector([0.0, -1.0]), v) * points.dX
    F = term(F, u, v, points)
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    found = chosen(problem)
    assert problem.history[0].residuals[-1] < 1e-9
    return found[1]


def nothing_yet(points):
    return fem.Constant(points.grid, 0.0)


def test_what_laws_do_not_say_is_found_out():
    drift = ufl.as_matrix([[0.0, 1.0], [0.0, 0.0]])
    assert tangent_with(lambda F, u, v, p: F) == "cholesky"
    assert tangent_with(lambda F, u, v, p: F + ufl.inner(u, v) * p.dC) == "cholesky"
    assert tangent_with(lambda F, u, v, p: F + ufl.inner(drift * u, v) * p.dC) == "lu"
    # terms of the points may change their mind later, as pressure that is not yet there
    assert tangent_with(lambda F, u, v, p: F - nothing_yet(p) * ufl.inner(u, v) * p.dX) == "lu"


@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
@pytest.mark.parametrize("stabilisation", ["none", "ghost", "aggregation", "soft"])
@pytest.mark.parametrize("basis", ["linear", "bspline2"])
def test_multigrid_finds_what_factors_find(few_are_many, monkeypatch, kind, stabilisation, basis):
    many = block(4, kind, basis=basis, stabilisation=stabilisation)
    assert chosen(many)[1] == "mg"
    assert many.here.unknowns.block == many.points.gdim
    assert many.history[0].residuals[-1] < 1e-9
    monkeypatch.undo()
    few = block(4, kind, basis=basis, stabilisation=stabilisation)
    assert chosen(few)[1] == "cholesky"
    assert few.here.unknowns.block == 1
    assert many.history[0].unknowns == few.history[0].unknowns
    u, w = (p.points["x"] - p.points["x0"] for p in (many, few))
    # forces on functions that hardly feel the body say little of their motion
    share = 1e-6 if stabilisation == "soft" else 1e-8
    np.testing.assert_allclose(u, w, atol=share * np.abs(w).max())


def test_multigrid_of_an_unsymmetric_tangent(few_are_many):
    problem = block(4, "hexahedron", extra={"strain": "jaumann"})
    assert chosen(problem)[:2] == ("gmres", "mg")
    assert problem.history[0].residuals[-1] < 1e-9


def sand(dilation_angle=0.0, **options):
    """A block of sand part of which yields."""
    law = mpm.materials.MohrCoulomb(
        **ELASTIC, cohesion=0.05, friction_angle=25.0, dilation_angle=dilation_angle
    )
    return block(12, law=law, load=-0.4, stabilisation="ghost", **options)


@pytest.mark.parametrize("most", [200, 2])
def test_incomplete_factors_find_what_factors_find(monkeypatch, most):
    """Where they find nothing within so many iterations, factors do, and are asked first then."""
    few = sand()
    assert chosen(few) == ("preonly", "lu", "mumps")
    monkeypatch.setattr(method, "_KEPT", {1: 10**9, 2: 20, 3: 20})
    monkeypatch.setattr(krylov, "_MOST_OF_INCOMPLETE", most)
    many = sand()
    assert chosen(many)[:2] == ("gmres", "ilu" if most == 200 else "lu")
    assert many.history[0].halvings == 0
    assert max(many.history[0].linear_iterations) > 1
    for problem in few, many:
        assert problem.history[0].residuals[-1] < 1e-9
        assert (problem.points["plastic_strain"] > 0).any()
    u, w = (p.points["x"] - p.points["x0"] for p in (many, few))
    np.testing.assert_allclose(u, w, atol=1e-7 * np.abs(w).max())


def test_another_solver_goes_on_where_one_failed(monkeypatch):
    """No iteration is made twice, and the forces are compared with those at the first one."""
    monkeypatch.setattr(method, "_KEPT", {1: 10**9, 2: 20, 3: 20})
    prepare, count = LinearSolver.assembled, 0

    def fails_once(self, *norms):
        nonlocal count
        count += 1
        prepare(self, *norms)
        if count == 3:
            assert self.method.incomplete
            self._ksp.setTolerances(max_it=1)

    whole = sand()
    assert chosen(whole)[1] == "ilu"
    monkeypatch.setattr(LinearSolver, "assembled", fails_once)
    problem = sand()
    assert chosen(problem)[1] == "lu"
    one, other = problem.history[0], whole.history[0]
    assert one.iterations == len(one.residuals) - 1 == other.iterations
    np.testing.assert_allclose(one.residuals[:4], other.residuals[:4], rtol=1e-3)
    # iterations before the failure count, too
    count = 0
    late = sand(max_iterations=one.iterations - 1, max_halvings=0)
    with pytest.raises(mpm.errors.ConvergenceError):
        late.step()


@pytest.mark.parametrize("options", [{"pc_type": "lu"}, {"ksp_type": "preonly"}])
def test_what_a_user_chooses_has_no_rival(monkeypatch, options):
    monkeypatch.setattr(method, "_KEPT", {1: 10**9, 2: 20, 3: 20})
    problem = sand(petsc_options=options)
    assert chosen(problem)[1] == "lu"
    assert problem.newton.linear.snes.getKSP().getPC().getType() == "lu"


def test_incomplete_factors_are_left_for_what_costs_less():
    choice = IncompleteFactorsChoice()
    # few iterations: nothing else is tried, whatever they cost
    choice.weigh(1.0, 1, 12)
    assert choice.incomplete
    # many: factors have a turn, and lose it; the next one is eight attachments later
    choice.weigh(2.0, 1, 60)
    assert not choice.incomplete
    choice.weigh(3.0, 1, 1)
    assert choice.incomplete
    turns = [choice.incomplete for _ in range(8) if choice.weigh(2.0, 1, 60) is None]
    assert turns == [True] * 7 + [False]
    # this time they cost less, and stay until the other one has a turn
    turns = [choice.incomplete for _ in range(16) if choice.weigh(1.0, 1, 1) is None]
    assert turns == [False] * 15 + [True]


def test_incomplete_factors_that_failed_wait_for_longer_each_time():
    choice, waits = IncompleteFactorsChoice(), []
    for _ in range(8):
        # a failure that costs as much as six solutions by the other method
        choice.failed(6.0)
        waits.append(0)
        while not choice.incomplete:
            choice.weigh(2.0, 2, 2)
            waits[-1] += 1
    assert waits == [3, 6, 12, 24, 48, 96, 192, 192]
    # what works is trusted again
    choice.weigh(1.0, 1, 12)
    choice.failed(6.0)
    choice.weigh(6.0, 1, 1)
    assert choice.incomplete


def test_iterations_that_failed_wait_for_longer_each_time():
    problem = block(kind="hexahedron")
    choice = MethodChoice(
        problem.comm, 3, Tangent(False, False, False), problem.newton.linear._options
    )
    choice.no_incomplete, waits = True, []
    for _ in range(6):
        method = choice.method(10_000)
        assert method.pc == "gamg"
        assert choice.failed(method, None)
        waits.append(0)
        while choice.method(10_000).pc == "lu":
            choice.attached()
            waits[-1] += 1
    assert waits == [4, 8, 16, 32, 64, 64]


@pytest.mark.parametrize("many", [False, True])
def test_a_tangent_that_is_not_definite_is_solved_all_the_same(monkeypatch, many):
    """Springs that push instead of pull give the stiffness negative eigenvalues."""
    if many:
        few_at_all(monkeypatch)
    grid = unit_grid("quadrilateral", 12)
    points = mpm.fill(grid, mpm.Box((0, 0), (0.95, 0.95)), 2, 1.0)
    V = mpm.Space(grid)
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.3), points, u, v, strain="small")
    F -= ufl.inner(ufl.as_vector([1e-3, 0.0]), v) * points.dX + 20.0 * ufl.inner(u, v) * points.dC
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    record = problem.step()
    assert record.residuals[-1] < 1e-9
    assert record.halvings == 0
    K = problem.stiffness()
    eigenvalues = np.linalg.eigvalsh(K.convert("dense").getDenseArray())
    assert eigenvalues[0] < 0 < eigenvalues[-1]


def test_info_tells_what_solves_and_how_work_is_spread():
    problem = block()
    assert "chosen in the first step" in problem.info()
    problem.step()
    text = problem.info()
    assert f"points: {problem.points.total}" in text
    assert f"unknowns: {problem.history[0].unknowns}" in text
    assert "Cholesky" in text
    assert "positive definite" in text


@pytest.mark.parametrize("scale", [1.0, 1e6, -2.0])
def test_what_a_pressure_block_stores(scale):
    """S = C − 3 diag(B₂ diag(A)⁻¹ B₁), whatever the scale and the sign of the second equation."""
    A, B, C = np.diag([2.0, 4.0, 5.0]), np.array([[1.0, 2.0, 0.0], [0.0, 1.0, -3.0]]), np.eye(2)
    whole = np.block([[A, -B.T], [scale * B, scale * C]])
    matrix = PETSc.Mat().createDense(whole.shape, array=whole, comm=PETSc.COMM_SELF)
    matrix = matrix.convert("aij")
    u, p = (PETSc.IS().createGeneral(rows, PETSc.COMM_SELF) for rows in ([0, 1, 2], [3, 4]))
    S = schur_matrix(matrix, u, p)[:, :]
    exact = np.diag(scale * (C + B @ np.linalg.inv(A) @ B.T))
    np.testing.assert_allclose(S, np.diag(scale + 3 * (exact - scale)), rtol=1e-9)
