"""Self-weight compaction of an elastic column against the exact stress.

The errors are those of AMPLE run as published (Coombs & Augarde 2020, doi
10.1016/j.advengsoft.2019.102748).
"""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.special import lambertw

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD


def column(
    n, basis="gimp", dimension=2, per_cell=2, steps=40, E=10e3, nu=0.0, rho=80.0, g=10.0,
    ghost=None, cell=None, height=50.0, law=mpm.materials.Hencky,
):  # fmt: skip
    """Solve; returns (problem, error)."""
    h = height / n
    if dimension == 1:
        grid = mesh.create_interval(COMM, n, [0.0, height])
    elif dimension == 2:
        kind = cell or mesh.CellType.quadrilateral
        grid = mesh.create_rectangle(COMM, [(0, 0), (h, height)], (1, n), kind)
    else:
        kind = cell or mesh.CellType.hexahedron
        grid = mesh.create_box(COMM, [(0, 0, 0), (h, h, height)], (1, 1, n), kind)
    body = mpm.Box((0.0,) * dimension, (h,) * (dimension - 1) + (height,))
    points = mpm.fill(grid, body, per_cell=per_cell, density=rho)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    weight = fem.Constant(grid, (0.0,) * dimension)
    F = mpm.momentum(law(E=E, nu=nu), points, u, v)
    F -= ufl.inner(points.density * weight, v) * points.dX
    if ghost:
        F += mpm.ghost(points, u, v, gamma=E / 30, scaling=ghost)
    sides = {1: (), 2: ("left", "right"), 3: ("left", "right", "front", "back")}[dimension]
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, *sides) + mpm.fixed(V, "bottom"))
    for k in range(steps):
        weight.value[-1] = -g * (k + 1) / steps
        problem.step()
    Y, V0 = points["x0"][:, -1], points["V0"]
    up = dimension - 1
    deviation = np.abs(points["stress"][:, up, up] + rho * g * (height - Y))
    return problem, float(deviation @ V0 / (rho * g * height * V0.sum()))


@pytest.mark.parametrize(
    ("basis", "n", "published"),
    [
        ("gimp", 4, 4.133e-2),
        ("gimp", 16, 3.6589e-3),
        ("gimp", 64, 4.3572e-4),
        ("gimp", 256, 1.0291e-4),
        ("linear", 4, 6.325e-2),
        ("linear", 16, 8.670e-2),
        ("linear", 64, 8.289e-2),
        ("linear", 256, 8.946e-2),
    ],
)
def test_published_errors(basis, n, published):
    problem, error = column(n, basis)
    assert error == pytest.approx(published, rel=2e-4)
    if basis == "gimp":
        assert max(record.iterations for record in problem.history) <= 5
    assert not any(record.halvings for record in problem.history)


def test_one_and_three_dimensions_equal_two():
    errors = [column(16, dimension=d)[1] for d in (1, 2, 3)]
    np.testing.assert_allclose(errors, errors[0], rtol=1e-9)


def test_neo_hookean_points_carry_the_exact_stress_too():
    problem, error = column(16, law=mpm.materials.NeoHookean)
    assert error < 6e-3
    stress = problem.points["stress"]
    np.testing.assert_allclose(stress, np.swapaxes(stress, 1, 2), atol=1e-9)


@pytest.mark.parametrize(
    ("E", "nu", "rho", "g", "height"),
    [(1e6, 0.3, 2000.0, 9.81, 20.0), (5e3, 0.2, 40.0, 10.0, 50.0)],
)
def test_other_materials(E, nu, rho, g, height):
    _, error = column(32, E=E, nu=nu, rho=rho, g=g, height=height)
    assert error < 3e-3


def test_the_error_falls_with_refinement_and_with_points():
    errors = [column(n)[1] for n in (8, 16, 32)]
    assert errors[0] > 2 * errors[1] > 4 * errors[2]
    assert column(16, per_cell=4)[1] < column(16, per_cell=2)[1]


def test_height_is_the_exact_one():
    problem, _ = column(64)
    x, F, l0 = (problem.points[name] for name in ("x", "F", "l0"))
    top = np.max(x[:, 1] + F[:, 1, 1] * l0[:, 1])
    assert top == pytest.approx(24.0596, rel=2e-3)
    # every point, by Lambert's function
    s = 800 * (50 - problem.points["x0"][:, 1]) / 1e4
    w, w0 = np.real(lambertw(s)), np.real(lambertw(4.0))
    exact = 1e4 / 800 * (w0 + w0**2 / 2 - w - w**2 / 2)
    np.testing.assert_allclose(x[:, 1], exact, atol=0.04)


@pytest.mark.parametrize("scaling", ["scaled", "literal"])
@pytest.mark.parametrize("basis", ["gimp", "linear"])
def test_ghost_penalty_does_not_cost_accuracy(scaling, basis):
    for n in (16, 64):
        assert column(n, basis, ghost=scaling)[1] <= 1.05 * column(n, basis)[1]


def test_newton_converges_quadratically():
    problem, _ = column(16)
    orders = []
    for record in problem.history:
        r = [x for x in record.residuals if x > 1e-13]
        if len(r) >= 3:
            orders.append(np.log(r[-1] / r[-2]) / np.log(r[-2] / r[-3]))
    assert len(orders) > 20
    assert np.median(orders) > 1.8


@pytest.mark.parametrize("cell", [mesh.CellType.triangle, mesh.CellType.quadrilateral])
def test_standard_mpm_before_cells_are_crossed(cell):
    """While no point crosses a cell, stress is constant in it: a quarter of its weight off."""
    for n in (8, 16):
        _, error = column(n, "linear", E=1e7, steps=2, cell=cell)
        assert error == pytest.approx(1 / (4 * n), rel=0.03)


def test_standard_mpm_on_tetrahedra():
    problem, error = column(8, "linear", 3, E=1e6, steps=2, cell=mesh.CellType.tetrahedron)
    assert error == pytest.approx(1 / 32, rel=0.05)
    assert len(problem.points) == 8 * 6 * 8
