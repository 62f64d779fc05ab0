"""First guess of the increments, and the tangents that Newton's method does without."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.assembly import region
from dolfinmpm.solve.initialguess import InitialGuess
from dolfinmpm.solve.operator import Operator


def block(**options):
    """A soft block under its weight, which compacts by 1 % per step."""
    ends = [(0.0, 0.0), (2.0, 2.0)]
    grid = mesh.create_rectangle(MPI.COMM_WORLD, ends, (8, 8), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1.1, 1.6)), 2, 100.0)
    V, g = mpm.Space(grid, "gimp"), fem.Constant(grid, (0.0, 0.0))
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=1e4, nu=0.3), points, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    return mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", **options), g


def run(loads, forget=False):
    """Iterations of steps with these loads, and the problem."""
    problem, g = block()
    for load in loads:
        if forget:
            problem.newton.guess = InitialGuess()
        g.value[1] = -load
        problem.step()
    return [record.iterations for record in problem.history], problem


def test_even_loads_need_fewer_iterations_from_the_last_increments():
    loads = 0.5 * np.arange(1, 9)
    guessed, problem = run(loads)
    plain, same = run(loads, forget=True)
    assert guessed[0] == plain[0]
    assert sum(guessed[1:]) <= sum(plain[1:]) - 7
    moved = np.abs(same.points["x"] - same.points["x0"]).max()
    np.testing.assert_allclose(problem.points["x"], same.points["x"], rtol=0, atol=1e-8 * moved)
    # the forces out of balance are measured as from zero increments
    assert all(record.residuals[-1] <= problem.tolerance for record in problem.history)


def test_increments_that_change_evenly_go_on():
    """Increments grow by the same amount in each step: their change is the guess of the next."""
    residuals = []
    for goes_on in (True, False):
        with pytest.MonkeyPatch.context() as patch:
            if not goes_on:
                patch.setattr(InitialGuess, "_ahead", lambda self, rates: [None] * len(rates))
            _, problem = run(1e-4 * np.arange(1, 9) ** 2)
        guesses = [record.residuals[0] for record in problem.history[3:]]
        residuals.append(max(guesses))
    assert residuals[0] < 0.01 * residuals[1]


def test_the_rate_of_a_step_is_that_in_its_middle():
    """Steps of unequal lengths, rates that grow linearly with time."""
    ends = np.array([0.0, 0.3, 0.5, 1.2])
    middles, lengths = 0.5 * (ends[1:] + ends[:-1]), np.diff(ends)
    nodes = np.arange(3, dtype=np.int32)
    rates = [np.outer(np.ones(3), [2.0 + t, 5.0 * t]) for t in middles]
    guess, other = InitialGuess(), {"guess trials": np.array([0, 1, 2])}
    for when, k in (("last", 1), ("former", 0)):
        other |= {f"guess {when} 0 nodes": nodes, f"guess {when} 0": rates[k]}
    other |= {"guess lengths": lengths[1::-1], "guess ahead": np.array([True])}
    guess.set_state(other, None)
    guess.length = lengths[2]
    (change,) = guess._ahead([True])
    np.testing.assert_allclose(rates[1] + change, rates[2], rtol=1e-14)
    (change,) = guess._ahead([False])
    np.testing.assert_allclose(change, (rates[1] - rates[0]) * lengths[2] / lengths[1])
    np.testing.assert_equal(guess.state(), other)


def test_a_guess_without_use_is_left_out_for_longer_and_longer():
    loads = [1.0, 0.5, 1.0, 0.5, 1.0, 0.5, 1.0]
    tried = []
    on = InitialGuess.on

    def counted(self, operator):
        found = on(self, operator)
        tried.append(found is not None)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(InitialGuess, "on", counted)
        _, problem = run(loads)
    # in the second step, after one step without, and after two more
    assert tried == [False, True, True, True][: len(tried)]
    assert len(tried) <= 4
    _, same = run(loads, forget=True)
    moved = np.abs(same.points["x"] - same.points["x0"]).max()
    np.testing.assert_allclose(problem.points["x"], same.points["x"], rtol=0, atol=1e-8 * moved)
    again = InitialGuess()
    again.set_state(problem.newton.guess.state(), problem.points.partition)
    np.testing.assert_equal(again.state(), problem.newton.guess.state())


def test_the_last_iteration_has_a_former_tangent():
    assembled = []
    tangent = Operator.tangent

    def counted(self, matrix):
        assembled.append(1)
        tangent(self, matrix)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Operator, "tangent", counted)
        problem, g = block(tolerance=1e-7)
        g.value[1] = -0.5
        first = problem.step()
        # one more, of a sample of the points, tells whether it is symmetric
        assert len(assembled) <= first.iterations + 1
        del assembled[:]
        g.value[1] = -1.0
        second = problem.step()
        assert len(assembled) < second.iterations
    assert second.residuals[-1] <= problem.tolerance


@pytest.mark.parametrize("skew", [0.0, 0.3])
def test_a_sample_of_the_points_tells_whether_the_tangent_is_symmetric(skew):
    ends = [(0.0, 0.0), (1.0, 1.0)]
    grid = mesh.create_rectangle(MPI.COMM_WORLD, ends, (40, 40), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 100.0)
    V = mpm.Space(grid, "linear")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=1e4, nu=0.3), points, u, v)
    turned = 1e3 * ufl.as_matrix([[1.0, skew], [-skew, 1.0]])
    F += ufl.inner(ufl.dot(turned, ufl.grad(u)), ufl.grad(v)) * points.dC
    F -= ufl.inner(ufl.as_vector([0.0, -1.0]), v) * points.dx
    counts = []
    run = region.Region.run

    def counted(self, programs, tangent):
        found = list(run(self, programs, tangent))
        if self.sampled:
            counts.append(len(found))
        return iter(found)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(region, "_CHUNK", 64)
        patch.setattr(region.Region, "run", counted)
        problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
        problem.step()
    # of 100
    assert counts
    assert max(counts) <= 16
    assert problem.newton.linear.choice.tangent.symmetric == (skew == 0.0)
    assert problem.history[-1].residuals[-1] <= problem.tolerance


def two_blocks():
    """Two blocks under their weight, the first of them on leaves; the problem, and its load."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, 9)] * 2)
    A = mpm.Space(grid, "gimp", tag=1, refine=lambda x: np.where(x[1] < 0.6, 0.25, 0.5), levels=1)
    B = mpm.Space(grid, "gimp", tag=2)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1.3)), 2, 100.0, tag=1, refine=A)
    points += mpm.fill(grid, mpm.Box((2, 0), (3, 1.7)), 2, 100.0, tag=2)
    g, F = fem.Constant(grid, 0.0), 0.0
    for tag, V in ((1, A), (2, B)):
        F += mpm.momentum(mpm.materials.Hencky(1e4, 0.3), points, V.increment, V.test, tag=tag)
        F += points.density * g * V.test[1] * points.dX(tag)
    bcs = mpm.fixed(A, "bottom") + mpm.fixed(B, "bottom")
    return mpm.QuasiStatic(F, [A.increment, B.increment], points, bcs, stabilisation="ghost"), g


def test_a_restart_keeps_the_guess_of_fields_without_leaves(tmp_path):
    problem, g = two_blocks()
    for k in range(3):
        g.value = 0.5 * (k + 1)
        problem.step()
    problem.save(tmp_path / "run.npz")
    other, h = two_blocks()
    other.load(tmp_path / "run.npz")
    for name in ("_last", "_former"):
        (leaves, plain), (_, same) = (getattr(p.newton.guess, name) for p in (other, problem))
        assert leaves.nodes.size == 0
        assert same.nodes.size > 0
        np.testing.assert_array_equal(plain.nodes, same.nodes)
        np.testing.assert_array_equal(plain.values, same.values)
    g.value = h.value = 2.0
    for _ in range(2):
        for one in (problem, other):
            one.step()
            # a second checkpoint, with what the first had left out
            one.save(tmp_path / "again.npz")
    moved = np.abs(problem.points["x"] - problem.points["x0"]).max()
    assert other.points["x"] == pytest.approx(problem.points["x"], abs=1e-7 * moved)
