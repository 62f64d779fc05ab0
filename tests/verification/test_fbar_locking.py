"""F-bar against volumetric locking: a nearly incompressible beam sags under its weight."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import ufl
from dolfinx import fem, geometry, mesh
from mpi4py import MPI
from test_cantilever import balance, hencky_energy

import dolfinmpm as mpm

# m, m, Pa, -, N/m³
LENGTH, DEPTH, E, NU, WEIGHT = 4.0, 1.0, 1000.0, 0.499, 2.0
BASES = ("linear", "gimp", "bspline2")


@functools.cache
def conforming(degree, cells, steps=5):
    """Vertical displacement (m) of the axis by conforming elements, total Lagrangian, by x (m)."""
    grid = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (LENGTH, DEPTH)], cells, mesh.CellType.quadrilateral
    )
    space = fem.functionspace(grid, ("Lagrange", degree, (2,)))
    u, v, du = fem.Function(space), ufl.TestFunction(space), ufl.TrialFunction(space)
    load = fem.Constant(grid, (0.0, 0.0))
    dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 2})
    energy = hencky_energy(ufl.Identity(2) + ufl.grad(u), E, NU) * dx - ufl.inner(load, u) * dx
    residual = ufl.derivative(energy, u, v)
    r, K = fem.form(residual), fem.form(ufl.derivative(residual, u, du))
    free = np.repeat(~np.isclose(space.tabulate_dof_coordinates()[:, 0], 0), 2)
    for k in range(1, steps + 1):
        load.value[1] = -WEIGHT * k / steps
        balance(r, K, u, free, 1e-9)

    def sag(x):
        at = np.array([[x, DEPTH / 2, 0.0]])
        found = geometry.compute_collisions_points(geometry.bb_tree(grid, 2), at)
        return u.eval(at, geometry.compute_colliding_cells(grid, found, at).links(0)[:1])[1]

    return sag


@functools.cache
def beam(basis, n, fbar):
    """Sag (m) of the two points nearest to the end of the axis, and the problem."""
    h = DEPTH / n
    grid = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, -2), (5, 2)], (5 * n, 4 * n), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (LENGTH, DEPTH)), 2, 1.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    load = fem.Constant(grid, (0.0, 0.0))
    law = mpm.materials.Hencky(E=E, nu=NU)
    F = mpm.momentum(law, points, u, v, fbar=fbar) - ufl.inner(load, v) * points.dX
    F += mpm.ghost(points, u, v, gamma=E / 300)
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "left"))
    for k in range(1, 6):
        load.value[1] = -WEIGHT * k / 5
        problem.step()
    end = np.hypot(points["x0"][:, 0] - LENGTH, points["x0"][:, 1] - DEPTH / 2) < 0.6 * h
    assert np.count_nonzero(end) == 2
    return (points["x"] - points["x0"])[end, 1].mean(), problem


def error(basis, n, fbar):
    """Relative difference from conforming elements, at the same place of the axis."""
    exact = conforming(3, (32, 8))(LENGTH - DEPTH / n / 4)
    return beam(basis, n, fbar)[0] / exact - 1


@pytest.mark.long
def test_conforming_elements_have_converged():
    """Cubic ones, where quadratic ones are still a little stiff."""
    fine = conforming(3, (32, 8))(LENGTH)
    assert conforming(3, (16, 4))(LENGTH) == pytest.approx(fine, rel=0.01)
    assert conforming(2, (64, 16))(LENGTH) == pytest.approx(fine, rel=0.005)


@pytest.mark.parametrize("basis", BASES)
def test_sag_converges_to_that_of_conforming_elements(basis):
    errors = {n: error(basis, n, True) for n in (2, 4, 8)}
    assert abs(errors[8]) < {"linear": 0.015, "gimp": 0.006, "bspline2": 0.02}[basis]
    assert abs(errors[8]) < 0.5 * abs(errors[4]) < 0.25 * abs(errors[2])


@pytest.mark.parametrize("basis", BASES)
def test_without_f_bar_it_locks(basis):
    for n in (2, 4, 8):
        assert error(basis, n, False) < error(basis, n, True)
    if basis != "bspline2":
        assert error(basis, 4, False) < -0.5
        assert error(basis, 8, False) < -0.25


@pytest.mark.parametrize("basis", BASES)
def test_pressure_does_not_swing(basis):
    """Of the points in a cell some would carry tension and some compression of many weights."""
    swing = {}
    for fbar in (False, True):
        points = beam(basis, 8, fbar)[1].points
        swing[fbar] = np.trace(points["stress"], axis1=1, axis2=2).std() / 3
    # bending makes ±3 (ρ g L²/2)/D² (half of it pressure) at the wall, less elsewhere
    assert swing[True] < WEIGHT * LENGTH**2 / DEPTH / 2
    assert swing[False] > 1.5 * swing[True]


@pytest.mark.parametrize("basis", BASES)
def test_volume_is_kept(basis):
    """K = 167 E keeps the mean volume; Newton's method needs few iterations."""
    problem = beam(basis, 4, True)[1]
    assert np.abs(problem.points["J_bar"] - 1).max() < 5e-3
    assert max(record.iterations for record in problem.history) <= 6
    assert sum(record.halvings for record in problem.history) == 0


@pytest.mark.parametrize("basis", BASES)
def test_a_tube_through_the_cells(basis):
    """Lamé's tube of almost incompressible clay, whose faces cut the cells, under pressure.

    The ghost penalty by default: in units of the P-wave modulus alone the inner face would move by
    a quarter too little, and stresses would be several times too large.
    """
    a, b, nu, pressure, h = 1.0, 2.0, 0.4999, 1e-6, 1 / 8
    angles = np.linspace(0.0, np.pi / 2, 101)
    arc = np.column_stack([np.cos(angles), np.sin(angles)])
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.arange(0.0, b + 3 * h, h)] * 2)
    points = mpm.fill(grid, mpm.Polygon([*b * arc, *a * arc[::-1]]), 3, 1.0, exact=True)
    outwards = -np.column_stack([np.cos(middle := angles[1:] - angles[1] / 2), np.sin(middle)])
    inner = mpm.Boundary(points, -a * outwards, a * angles[1] * outwards)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(1.0, nu), points, u, v, strain="small", fbar=True)
    bcs = mpm.rollers(V, "left", "bottom")
    F += inner.pressure(pressure, u, v)
    mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost").step()
    r = np.linalg.norm(points["x0"], axis=1)
    share = pressure * a**2 / (b**2 - a**2)
    moved = np.linalg.norm(points["x"] - points["x0"], axis=1)
    exact = (1 + nu) * share * ((1 - 2 * nu) * r + b**2 / r)
    assert np.abs(moved - exact).max() < 0.01 * exact.max()
    stress = np.linalg.eigvalsh(points["stress"][:, :2, :2])
    exact = share * (1 + np.array([-1, 1]) * (b / r[:, None]) ** 2)
    assert np.linalg.norm(stress - exact) < 0.2 * np.linalg.norm(exact)
