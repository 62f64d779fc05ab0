"""Steps: halving, rollback, errors, and what is kept between them."""

from __future__ import annotations

import re

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    ConflictingConditionsError,
    ConvergenceError,
    ParameterError,
    PointsOutsideGridError,
)
from dolfinmpm.assembly.evaluation import Evaluation
from dolfinmpm.body.points import GHOST_FACETS
from dolfinmpm.solve.newton import Newton


def column(n=8, E=1e4, **options):
    grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (50 / n, 50)], (1, n),
                                 mesh.CellType.quadrilateral)  # fmt: skip
    points = mpm.fill(grid, mpm.Box((0, 0), (50 / n, 50)), 2, 80.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=0.0), points, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    if options.pop("ghost", False):
        F += mpm.ghost(points, u, v, gamma=E / 30)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return mpm.QuasiStatic(F, u, points, bcs, **options), g


def state(points):
    return {name: values.copy() for name, values in points.fields.items()}


def test_a_step_that_is_too_large_is_halved_and_grows_back():
    problem, g = column(max_iterations=5)
    g.value[1] = -10.0
    record = problem.step()
    assert record.halvings > 0
    assert record.parts > 1
    # parts double after each success: fewer of them than steps of the smallest size
    assert record.parts < 2**record.halvings
    assert g.value[1] == -10.0
    sigma = problem.points["stress"][:, 1, 1]
    exact = -800 * (50 - problem.points["x0"][:, 1])
    assert np.abs(sigma - exact).mean() < 0.04 * 800 * 50


def test_parts_of_a_step_reach_what_small_steps_reach():
    """Halving goes through the same loads as the user's own smaller steps."""
    small, g = column()
    for load in (0.25, 0.5, 0.75, 1.0):
        g.value[1] = -2.0 * load
        small.step()
    large, g = column()
    large.share = 0.25
    g.value[1] = -2.0
    grown = large.step()
    assert grown.parts == 3  # 1/4, 1/2 and the 1/4 that is left
    np.testing.assert_allclose(large.points["x"], small.points["x"], rtol=2e-3)


def test_giving_up_keeps_the_state_and_names_the_place():
    problem, g = column(max_iterations=1, max_halvings=2)
    before = state(problem.points)
    g.value[1] = -10.0
    with pytest.raises(ConvergenceError) as caught:
        problem.step()
    message = str(caught.value)
    assert "step 1 failed" in message
    assert "DIVERGED_MAX_IT" in message
    assert re.search(r"point \d+ at \[.*\] m with det ΔF = ", message)
    assert "[ 0.  -2.5]" in message
    for name, values in problem.points.fields.items():
        assert np.array_equal(values, before[name]), name
    assert g.value[1] == 0.0
    # and the problem can go on
    problem.newton.max_iterations = 20
    g.value[1] = -0.25
    assert problem.step().parts >= 1


def test_a_law_without_a_stress_halves_the_step():
    """An increment that turns cells inside out is not a number, and no crash."""
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    push = fem.Constant(grid, -0.3)
    bcs = mpm.fixed(V, "bottom")
    bcs += mpm.prescribed(V, lambda x: np.isclose(x[1], 0.6), 1, increment=push)
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.3), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs)

    def push_through():
        for _ in range(30):
            problem.step()

    with pytest.raises((ConvergenceError, PointsOutsideGridError)):
        push_through()
    assert all(np.isfinite(values).all() for values in points.fields.values())
    assert points["x"].min() >= 0


def test_points_that_leave_the_grid():
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0.5, 0.5), (0.75, 0.75)), 2, 1.0)
    V = mpm.Space(grid, "linear")
    everywhere = [
        c for i in (0, 1)
        for c in mpm.prescribed(V, lambda x: np.full(x.shape[1], True), i, increment=(0.2, 0.0)[i])
    ]  # fmt: skip
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, everywhere)
    problem.step()
    before = state(points)
    with pytest.raises(PointsOutsideGridError, match=r"point \d+ goes from .* enlarge the grid"):
        problem.step()
    for name, values in points.fields.items():
        assert np.array_equal(values, before[name]), name


def test_conflicting_conditions():
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)
    V = mpm.Space(grid)
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
    agreeing = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "bottom")
    mpm.QuasiStatic(F, V.increment, points, agreeing)
    with pytest.raises(ConflictingConditionsError, match=r"by 'bottom' and as 0\.1 by 'left'"):
        mpm.QuasiStatic(
            F,
            V.increment,
            points,
            mpm.fixed(V, "bottom") + mpm.prescribed(V, "left", 0, increment=0.1),
        )
    # rounded values of functions agree: cos(pi / 2) is 6e-17
    agreeing = mpm.rollers(V, "left") + mpm.prescribed(
        V, "top", 0, increment=lambda x: 0.1 * np.cos(np.pi / 2 * (1 - x[0]))
    )
    mpm.QuasiStatic(F, V.increment, points, agreeing)
    with pytest.raises(ParameterError, match="side = 'north'"):
        mpm.fixed(V, "north")
    with pytest.raises(ParameterError, match="component = 2"):
        mpm.prescribed(V, "left", 2)
    with pytest.raises(ParameterError, match="no node"):
        mpm.fixed(V, lambda x: x[0] > 7)
    with pytest.raises(ParameterError, match="must be finite"):
        mpm.prescribed(V, "left", 0, increment=float("nan"))


@pytest.mark.parametrize(
    ("kind", "named"),
    [("quadrilateral", {"x-": "left", "X+": "right", "y-": "bottom", "y+": "top"}),
     ("hexahedron", {"x-": "left", "x+": "right", "y-": "front", "y+": "back", "z-": "bottom",
                     "z+": "top"})],
)  # fmt: skip
def test_sides_by_axis_are_those_by_name(kind, named):
    grid = unit_grid(kind)
    points = mpm.fill(grid, mpm.Box(*np.array([[0.0], [1.0]]).repeat(len(named) // 2, 1)), 2, 1.0)
    V = mpm.Space(grid)
    for axis, name in named.items():
        for found, expected in zip(
            mpm.rollers(V, axis) + mpm.frictional(V, axis, friction=0.1),
            mpm.rollers(V, name) + mpm.frictional(V, name, friction=0.1),
        ):
            assert found.where == expected.where == name
            assert np.array_equal(found.nodes, expected.nodes)
        walls = [mpm.Boundary.from_side(points, side) for side in (axis, name)]
        assert np.array_equal(walls[0].markers["x"], walls[1].markers["x"])
    with pytest.raises(ParameterError, match="is given twice"):
        mpm.frictional(V, "left", "x-", friction=0.1)
    with pytest.raises(
        ParameterError, match=r'side = .w-. must be one of "left".* by its axis, "x-", "x\+"'
    ):
        mpm.fixed(V, "w-")


def test_only_active_unknowns_are_solved_on_a_large_grid():
    sizes = []
    for n in (1, 10):
        grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (4.0 * n, 4.0)], (4 * n, 4),
                                     mesh.CellType.quadrilateral)  # fmt: skip
        points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1.0)
        V = mpm.Space(grid, "gimp")
        g = fem.Constant(grid, (0.0, -1e-3))
        F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.3), points, V.increment, V.test)
        F -= ufl.inner(g, V.test) * points.dX + 0 * mpm.ghost(points, V.increment, V.test, 1.0)
        problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
        record = problem.step()
        assert problem.newton.linear.matrix.petsc.getSize() == (record.unknowns, record.unknowns)
        assert problem.here.active_cells == 4
        sizes.append(record.unknowns)
    assert sizes == [12, 12]


def test_an_unchanged_active_set_keeps_its_matrix():
    problem, g = column(4)
    for load in (1e-3, 2e-3):  # the first step lets domains reach across the cells' edges
        g.value[1] = -load
        problem.step()
    matrix = problem.newton.linear.matrix
    for load in (3e-3, 4e-3):
        g.value[1] = -load
        problem.step()
        assert problem.newton.linear.matrix is matrix
    for load in range(20):
        g.value[1] = -0.2 * load
        problem.step()
    assert problem.newton.linear.matrix is not matrix


def test_without_ghost_terms_no_facets_are_searched():
    problem, _ = column(4)
    assert problem.activate().fields[0].entities == {}
    assert not problem.form.parts.grid
    problem, _ = column(4, ghost=True)
    assert GHOST_FACETS in problem.activate().fields[0].entities


def test_petsc_options_reach_the_solver():
    problem, g = column(
        4, options_prefix="other_", petsc_options={"pc_factor_mat_solver_type": "petsc"}
    )
    g.value[1] = -0.25
    problem.step()
    pc = problem.newton.linear.snes.getKSP().getPC()
    assert pc.getFactorSolverType() == "petsc"
    default, g = column(4)
    g.value[1] = -0.25
    default.step()
    package = "cholmod" if default.comm.size == 1 else "mumps"
    assert default.newton.linear.snes.getKSP().getPC().getFactorSolverType() == package


def test_the_increment_can_be_read_after_a_step():
    problem, g = column(4)
    g.value[1] = -0.25
    x = problem.points["x"].copy()
    problem.step()
    u = problem.fields[0].space.increment
    moved = np.zeros((len(x), 3))
    moved[:, :2] = x
    # all domains were inside one cell, where the average of u is u at the middle
    values = u.eval(moved, problem.points["cell"])
    np.testing.assert_allclose(values, problem.points["x"] - x, atol=1e-12)
    assert np.abs(values).max() > 0


def test_fields_set_to_what_cannot_be():
    for name, value in (("density", -80.0), ("V", 0.0), ("x", np.nan), ("F", np.nan)):
        problem, _ = column(4)
        problem.points[name] = np.full_like(problem.points[name], value)
        with pytest.raises(ParameterError, match="must be"):
            problem.step()


def test_an_interruption_leaves_a_problem_that_can_go_on(monkeypatch):
    problem, g = column(8)
    g.value[1] = -0.25
    problem.step()
    before = state(problem.points)
    calls = 0
    original = Evaluation.internal

    def interrupted(self, out):
        nonlocal calls
        calls += 1
        if calls == 3:
            raise KeyboardInterrupt
        return original(self, out)

    monkeypatch.setattr(Evaluation, "internal", interrupted)
    g.value[1] = -0.5
    with pytest.raises(KeyboardInterrupt):
        problem.step()
    assert g.value[1] == -0.25
    for name, values in problem.points.fields.items():
        assert np.array_equal(values, before[name]), name
    g.value[1] = -0.5
    assert problem.step().parts == 1


def test_iterations_before_a_failed_factorisation_count(monkeypatch):
    prepared, failed = Newton._prepared, []

    class Failing:
        def __init__(self, balance):
            self.balance = balance

        def solve(self, *_):
            self.balance.residuals += [1.0, 0.1, 0.01]
            raise PETSc.Error(71)

    def once(self, operator, balance):
        found = prepared(self, operator, balance)
        failed.append(balance)
        return found if len(failed) > 1 else Failing(balance)

    def iterations():
        problem, g = column()
        g.value[1] = -0.1
        return problem.step().iterations

    count = iterations()
    monkeypatch.setattr(Newton, "_prepared", once)
    assert iterations() == count + 2
    assert len(failed) == 2


def test_a_body_moved_without_loads_converges():
    """Nothing to balance: the prediction is exact and Newton has nothing to do."""
    grid = unit_grid("quadrilateral", 8)
    for d in (0.01, 0.1):
        points = mpm.fill(grid, mpm.Box((0.2, 0.2), (0.5, 0.6)), 2, 1.0)
        V = mpm.Space(grid, "gimp")
        bcs = mpm.prescribed(V, lambda x: x[1] < 0.4, 0, increment=d)
        bcs += mpm.prescribed(V, lambda x: x[1] < 0.4, 1, increment=0.0)
        F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.3), points, V.increment, V.test)
        record = mpm.QuasiStatic(F, V.increment, points, bcs).step()
        assert record.iterations <= 2
        np.testing.assert_allclose(points["x"] - points["x0"], [[d, 0]] * len(points), atol=1e-9)


def test_one_constant_for_two_purposes():
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.7)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    c = fem.Constant(grid, 0.1)
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
    F -= c * V.test[0] * points.dX
    with pytest.raises(ParameterError, match="use two constants"):
        mpm.QuasiStatic(F, V.increment, points, mpm.prescribed(V, "bottom", 0, increment=c))
    with pytest.raises(ParameterError, match="bcs holds 'bottom'"):
        mpm.QuasiStatic(F, V.increment, points, ["bottom"])


@pytest.mark.parametrize("offset", [1e3, 1e6])
@pytest.mark.parametrize("kind", ["triangle", "distorted quadrilateral", "tetrahedron"])
def test_far_from_the_origin(kind, offset):
    """Rounding of large coordinates loses no point on a grid without a lattice."""
    moved = []
    for shift in (0.0, offset):
        grid = unit_grid(kind, 3)
        d = grid.geometry.dim
        grid.geometry.x[:, :d] += shift
        low = np.full(d, shift)
        points = mpm.fill(grid, mpm.Box(low, low + 1), 2, 1.0)
        V = mpm.Space(grid, "linear")
        g = fem.Constant(grid, (0.0,) * d)
        F = mpm.momentum(mpm.materials.Hencky(E=100.0, nu=0.3), points, V.increment, V.test)
        F -= ufl.inner(g, V.test) * points.dX
        problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom", "left", "right"))
        for load in (-1.0, -2.0):
            g.value[-1] = load
            problem.step()
        moved.append(points["x"] - points["x0"])
    np.testing.assert_allclose(moved[1], moved[0], atol=1e-5 * np.abs(moved[0]).max())


def test_bad_arguments():
    with pytest.raises(ParameterError, match="tolerance = 0"):
        column(4, tolerance=0)
    with pytest.raises(ParameterError, match="max_iterations = 0"):
        column(4, max_iterations=0)
