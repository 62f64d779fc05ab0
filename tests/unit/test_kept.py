"""What laws answered for a residual serves the tangent and the end of the step."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.kinematics import StrainFormulation, strain_formulation
from dolfinmpm.solve.initialguess import InitialGuess

LAWS = {
    "Hencky": mpm.materials.Hencky(1e6, 0.3),
    "VonMises": mpm.materials.VonMises(1e6, 0.3, radius=2e4, hardening=1e5),
    "MohrCoulomb": mpm.materials.MohrCoulomb(1e6, 0.3, 5e3, 25.0, dilation_angle=0.0),
    "CamClay": mpm.materials.CamClay(
        swelling=0.018,
        compression=0.13,
        M=1.05,
        mu0=5.4e6,
        alpha=0.0,
        reference_pressure=2e4,
        preconsolidation=4e4,
    ),
}
KINDS = {1: "interval", 2: "quadrilateral", 3: "hexahedron"}


def problem_of(law, d=2, strain="large", fbar=False, tag=None, **options):
    grid = unit_grid(KINDS[d], 3)
    points = mpm.fill(grid, mpm.Box((0.0,) * d, (1.0,) * d), 2, 1.0)
    points["tag"][:] = points["x"][:, 0] > 0.5
    V = mpm.Space(grid, "linear")
    u, v = V.increment, V.test
    load = fem.Constant(grid, (0.0,) * d)
    F = (
        mpm.momentum(law, points, u, v, strain=strain, fbar=fbar, tag=tag)
        - ufl.inner(load, v) * points.dX
    )
    if tag is not None:
        F += mpm.momentum(LAWS["Hencky"], points, u, v, strain=strain, tag=1 - tag)
        # a law's stress over all points: it is asked at some of a chunk
        F += (
            0.1
            * ufl.inner(mpm.stress(law, points, u, strain=strain, tag=tag), ufl.grad(v))
            * points.dX
        )
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "left"), **options)
    return problem, load


class Asked:
    """Points at which laws are asked, and at which their former answers are read."""

    def __init__(self, monkeypatch):
        self.anew = self.read = 0
        run = StrainFormulation.evaluate

        def counted(law, operand, value, tangent, rows, kept=None, end=None):
            if kept is not None and kept.known:
                self.read += len(rows)
            else:
                self.anew += len(rows)
            return run(law, operand, value, tangent, rows, kept, end)

        monkeypatch.setattr(StrainFormulation, "evaluate", counted)


def increments(operator, seed=1):
    """Increments by which many points yield."""
    return np.random.default_rng(seed).uniform(-0.01, 0.01, operator.here.unknowns.owned)


def tangent(operator):
    matrix = Matrix(operator.here.pattern, operator.here.unknowns)
    operator.tangent(matrix)
    return matrix.data.copy()


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("strain", ["large", "small", "jaumann"])
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
def test_the_same_to_the_last_bit(law, strain, d):
    """Residual, tangent and state at its end, asked anew and read."""
    same(problem_of(law, d, strain)[0])


@pytest.mark.parametrize("strain", ["large", "small"])
def test_the_same_with_means_over_cells(strain):
    same(problem_of(LAWS["MohrCoulomb"], strain=strain, fbar=True)[0])


@pytest.mark.parametrize("tag", [0, 1])
def test_the_same_where_laws_have_points_of_their_own(tag):
    same(problem_of(LAWS["VonMises"], tag=tag)[0])


def same(problem):
    operator = problem.operator()
    x = increments(operator)
    force = operator.residual(x).values.copy()
    operator.move(x)
    first = tangent(operator)  # asks the law; who comes after it reads
    operator.move(x)
    state = operator.points.end_state()
    operator.residual(x)
    np.testing.assert_array_equal(tangent(operator), first)
    assert np.abs(first).max() > 0
    # a force from what is kept, as that of the linear step is
    push = [values.copy() for values in operator.forces()]
    operator.move(x)
    for values, expected in zip(operator.forces(), push):
        np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(operator.residual(x).values, force)
    found = operator.points.end_state()
    assert found.keys() == state.keys()
    for name, values in state.items():
        np.testing.assert_array_equal(found[name], values)


@pytest.mark.parametrize("fbar", [False, True])
def test_a_law_is_asked_once_for_each_residual(fbar, monkeypatch):
    # with a tangent in each iteration
    options = {"tolerance": 1e-10, "petsc_options": {"snes_lag_jacobian": 1}}
    problem, load = problem_of(LAWS["VonMises"], fbar=fbar, **options)
    load.value[0] = -1e3
    problem.step()  # the first residual precedes the first tangent: it keeps nothing
    problem.newton.guess = InitialGuess()  # a guess has residuals of its own
    asked = Asked(monkeypatch)
    load.value[0] = -4e4
    record = problem.step()
    n = len(problem.points)
    assert record.parts == 1
    assert problem.points["plastic_strain"].max() > 0
    assert asked.anew == (record.iterations + 1) * n
    # each tangent, and the end of the step
    assert asked.read == (record.iterations + 1) * n


def test_prescribed_increments_predict_without_asking_twice(monkeypatch):
    grid = unit_grid("quadrilateral", 3)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)
    V = mpm.Space(grid, "linear")
    F = mpm.momentum(LAWS["Hencky"], points, V.increment, V.test)
    bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, "top", 1, increment=-1e-3)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    problem.step()
    problem.newton.guess = InitialGuess()  # it would replace the prediction
    asked = Asked(monkeypatch)
    record = problem.step()
    # at rest, then at each residual, one of which comes before the iterations that follow
    assert asked.anew == (1 + record.iterations) * len(points)


def test_what_is_not_of_these_increments_is_not_read(monkeypatch):
    problem, _ = problem_of(LAWS["VonMises"])
    operator, n = problem.operator(), len(problem.points)
    x, y = increments(operator), increments(operator, 2)
    operator.move(x)
    first = tangent(operator)
    asked = Asked(monkeypatch)

    def anew(act):
        before = asked.anew
        act()
        return (asked.anew - before) // n

    assert anew(lambda: tangent(operator)) == 0
    assert anew(lambda: operator.residual(y)) == 1
    other = tangent(operator)
    assert np.abs(other - first).max() > 0.01 * np.abs(first).max()
    # the same numbers again are new increments all the same
    assert anew(lambda: operator.move(x)) == 0
    assert anew(lambda: tangent(operator)) == 1
    operator.residual(y)
    operator.move_to_zero()
    assert anew(lambda: tangent(operator)) == 1
    # constants of the form may stand in what laws are a function of
    operator.update_external()
    assert anew(lambda: tangent(operator)) == 1
    # the state may be another after the end of a step
    assert anew(operator.points.end_state) == 0
    problem.points["be"] *= 1.01
    assert anew(lambda: tangent(operator)) == 1


def test_a_residual_that_fails_leaves_nothing_to_read(monkeypatch):
    problem, _ = problem_of(LAWS["VonMises"])
    operator, n = problem.operator(), len(problem.points)
    x = increments(operator)
    operator.move(x)
    tangent(operator)
    assert not np.isfinite(operator.residual(1e4 * x).norm)
    assert operator.points.failure is not None
    operator.move(x)
    expected = tangent(operator)
    asked = Asked(monkeypatch)
    operator.residual(x)
    assert asked.anew == n
    np.testing.assert_array_equal(tangent(operator), expected)


def test_explicit_steps_keep_nothing(monkeypatch):
    """Who never asks for a tangent needs no room for one."""
    problem, _ = problem_of(LAWS["VonMises"])
    operator = problem.operator()
    asked = Asked(monkeypatch)
    operator.residual(increments(operator))
    assert asked.anew == len(problem.points)
    assert not any(region._kept for region in operator.points.regions)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
def test_a_few_numbers_a_point(law):
    grid = unit_grid("hexahedron", 2)
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 1)), 1, 1.0)
    assert 8 * strain_formulation(law, points, "large").keeps <= 300
