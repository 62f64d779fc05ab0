"""Pressures on nested grids, and pressures that are prescribed in parts of a step."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem, mesh
from mpi4py import MPI
from test_poromechanics import LAW, WATER, block, held, problem_of

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    ParameterError,
)


def nested(cut=0.3, basis="gimp", coarse="p", h=0.125, stabilisation="none", **options):
    """A column that ends within a cell, one field having cells of twice the size; its problem."""
    height = (5 + cut) * h
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (h, 7 * h)], (2, 14), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (h, height)), 2, 1.0, exact=True)
    V = mpm.Space(grid, basis, coarsen=2 if coarse == "u" else 1)
    Q = mpm.Space(grid, basis, shape=(), coarsen=2 if coarse == "p" else 1)
    top = mpm.Surface(points, lambda x: x[1] > height - 1e-12, (0, 1))
    F = mpm.poromechanics(
        mpm.materials.Hencky(E=1e6, nu=0.0), points, (V.increment, Q.increment),
        (V.test, Q.test), permeability=1e-3, porosity=0.4, fluid=WATER, drained=top, **options,
    )  # fmt: skip
    F += top.traction(fem.Constant(grid, (0.0, -1e3)), V.test)
    return problem_of(F, points, V, Q, stabilisation=stabilisation), h**2 * WATER.unit_weight / 1e3


@pytest.mark.parametrize(
    ("basis", "stabilisation", "theta"),
    [
        ("gimp", "ghost", 1.0),
        ("gimp", "aggregation", 0.5),
        ("bspline2", "aggregation", 1.0),
        pytest.param("bspline2", "ghost", 1.0, marks=pytest.mark.long),
        pytest.param("gimp", "none", 0.5, marks=pytest.mark.long),
        pytest.param("linear", "aggregation", 1.0, marks=pytest.mark.long),
    ],
)
def test_a_first_step_on_nested_grids_does_not_overshoot(basis, stabilisation, theta):
    """Nor where nodes are tied: an ill-filled cell and its root have one mean."""
    for cut, share in ((1e-6, 0.25), (0.3, 1e-8), (0.49, 0.1), (0.49, 0.5), (0.9, 0.25)):
        problem, time = nested(cut, basis, stabilisation=stabilisation, theta=theta)
        problem.step(share * time / 1e6)
        assert problem.points["pressure"].max() < 1.01e3


def test_cells_that_are_one_to_means():
    """Offsets from the middle of the root and the ill-filled cell beside it together."""
    problem, time = nested(0.4, stabilisation="aggregation")
    problem.step(1e-6 * time)
    points, h = problem.points, 0.125
    *offset, size = points["cell_offset"].T
    y = points["x0"][:, 1]
    above = y > 4 * h
    np.testing.assert_allclose(size, np.where(above, 1.4, 1.0) * h, rtol=1e-3)
    middle = np.where(above, (4 + 0.7) * h, (np.floor(y / h) + 0.5) * h)
    np.testing.assert_allclose(offset[1], y - middle, atol=1e-3 * h)
    np.testing.assert_allclose(offset[0], points["x0"][:, 0] - 0.5 * h, atol=1e-3 * h)


def test_a_field_is_carried_under_a_name_once():
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
    V = mpm.Space(grid, "linear")
    u, v = V.increment, V.test
    last = mpm.carried(points, "last", u, unit="m")
    F = mpm.momentum(LAW, points, u, v) + 5.0 * ufl.inner(u - 0.5 * last, v) * points.dX
    F -= ufl.inner(fem.Constant(grid, (0.0, -3.0)), v) * points.dX
    assert "last" not in points.fields
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    problem.step()
    before = points["x"] - points["x0"]
    np.testing.assert_allclose(points["last"], before, atol=1e-15)
    other = mpm.carried(points, "last", 2 * u, unit="m")
    with pytest.raises(Exception, match="two expressions are carried"):
        mpm.QuasiStatic(F + ufl.inner(other, v) * points.dX, u, points, mpm.fixed(V, "bottom"))
    with pytest.raises(ParameterError, match="identifier"):
        mpm.carried(points, "a b", u)
    with pytest.raises(ParameterError, match="UFL expression"):
        mpm.carried(points, "c", 3.0)


def test_a_pressure_that_is_held_is_so_in_parts_of_a_step():
    """A step that is halved, and two steps of half its length."""
    found = {}
    for parts in (1, 2):
        F, points, V, Q, _ = block(height=1.0, drained=False)
        bcs = held(V) + mpm.prescribed(Q, "right", 0, value=50.0)
        problem = problem_of(F, points, V, Q, bcs)
        if parts == 1:
            fail_first_part(problem)
        for t in np.arange(1, parts + 1) * 0.02 / parts:
            problem.step(t)
        assert problem.history[0].halvings == (parts == 1)
        found[parts] = points["pressure"].copy()
        assert 30 < found[parts].max() < 50
    np.testing.assert_array_equal(found[1], found[2])

    bcs = held(V) + mpm.prescribed(Q, "right", 0, increment=50.0)
    with pytest.raises(ParameterError, match=r"'right' prescribes an increment.*value="):
        problem_of(F, points, V, Q, bcs)


def fail_first_part(problem):
    """Let the first attempt at a step fail."""
    finish, attempts = problem.scheme.finish, []

    def first_not(*given):
        attempts.append(given)
        return "so that the step is halved" if len(attempts) == 1 else finish(*given)

    problem.scheme.finish = first_not
