"""A bed of springs: one file that adds a kind of force."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import Linearised, unit_grid
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError

K, WEIGHT = 50.0, 3.0


def block(kind=mpm.QuasiStatic, basis="gimp", normal=(0, -1), **options):
    """A block that floats on springs at its lower face, under its weight."""
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0.25), (0.5, 0.75)), 2, 1.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    load = fem.Constant(grid, (0.0, -WEIGHT))
    face = mpm.Surface(points, lambda x: np.isclose(x[1], 0.25), normal, name="base")
    law = mpm.materials.Hencky(E=1e4, nu=0.0)
    F = mpm.momentum(law, points, u, v) - ufl.inner(load, v) * points.dX
    F += mpm.springs(face, u, v, stiffness=K)
    return kind(F, u, points, mpm.rollers(V, "left"), stabilisation="ghost", **options), face


@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2"])
def test_a_block_settles_by_its_weight(basis):
    problem, face = block(basis=basis)
    for _ in range(2):
        problem.step()
    # weight per area over k, and the force is that of the second step too
    # the springs follow the functions at the face, and the face follows its points
    way = problem.points["base_spring_way"][np.any(problem.points["base_area"] != 0, axis=1)]
    np.testing.assert_allclose(way, WEIGHT * 0.5 / K, rtol=1e-6)
    assert face.mean_displacement()[1] == pytest.approx(-WEIGHT * 0.5 / K, rel=1e-5)
    assert problem.history[-1].iterations <= 3


def test_the_tangent_is_the_derivative():
    problem, _ = block()
    problem.step()
    exact, numerical = Linearised(problem).both(1e-3, 1e-6)
    np.testing.assert_allclose(exact, numerical, atol=1e-5 * np.abs(exact).max())


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.Explicit])
def test_it_swings_as_a_mass_on_a_spring(kind):
    """A rigid block of the mass m = ρ h per area: ω² = k/m, and the energy stays."""
    problem, face = block(kind)
    omega = np.sqrt(K / 0.5)
    half = np.pi / omega
    for t in np.linspace(0, half, 101)[1:]:
        problem.step(t)
    # released from rest it is twice as deep after half a period
    assert face.mean_displacement()[1] == pytest.approx(-2 * WEIGHT * 0.5 / K, rel=5e-3)
    energies = problem.energies()
    assert energies.contact == pytest.approx(0.5 * K * 0.5 * (2 * WEIGHT * 0.5 / K) ** 2, rel=2e-2)
    assert abs(energies.losses["integrator"]) < 5e-3 * energies.external


def test_what_it_says_of_itself(tmp_path):
    problem, _ = block()
    assert "the springs at 'base', 50 Pa/m" in str(problem)
    problem.step()
    problem.save(tmp_path / "springs.npz")
    again, _ = block()
    again.load(tmp_path / "springs.npz")
    problem.step()
    again.step()
    np.testing.assert_array_equal(problem.points["x"], again.points["x"])


def test_what_it_refuses():
    problem, face = block()
    V = problem.fields[0].space
    with pytest.raises(ParameterError, match="stiffness = -1"):
        mpm.springs(face, V.increment, V.test, stiffness=-1.0)
    with pytest.raises(ParameterError, match="surface"):
        mpm.springs("base", V.increment, V.test, stiffness=1.0)
    F = problem.form.given - mpm.springs(face, V.increment, V.test, stiffness=1.0)
    with pytest.raises(FormError, match="scaled or subtracted"):
        mpm.QuasiStatic(F, V.increment, problem.points)


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation"])
def test_stress_is_uniform_on_springs_that_pass_cells(basis, stabilisation):
    """A column on springs, pressed down through two cells. The face's motion is exact, too."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [[0, 0.125, 0.25], np.linspace(-0.5, 1.25, 15)])
    points = mpm.fill(grid, mpm.Box((0, 0), (0.25, 1)), 2, 1.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    top, base = (mpm.Surface(points, lambda x, z=z: abs(x[1] - z) < 1e-9, (0, s), name=f"z{z}")
                 for z, s in ((1, 1), (0, -1)))  # fmt: skip
    p = fem.Constant(grid, 0.0)
    F = mpm.momentum(mpm.materials.NeoHookean(1e6, 0.0), points, u, v)
    F += top.pressure(p, u, v) + mpm.springs(base, u, v, stiffness=1e6)
    bcs = mpm.rollers(V, "left", "right")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation)
    for k in range(1, 6):
        p.value = 6e4 * k
        problem.step()
        assert np.abs(points["stress"][:, 1, 1] / p.value + 1).max() < 1e-8
    assert base.mean_displacement()[1] == pytest.approx(-0.3, rel=1e-6)
    np.testing.assert_allclose(points["z0_spring_way"][points["x0"][:, 1] < 0.05], 0.3, rtol=1e-8)


def test_springs_are_free_of_stress_when_they_are_made():
    problem, _ = block()
    problem.step()
    points = problem.points
    way = points["base_spring_way"].copy()
    V = problem.fields[0].space
    u, v = V.increment, V.test
    # a second bed on another surface at the same place takes nothing while nothing moves
    other = mpm.Surface(points, lambda x: np.isclose(x[1], 0.25), (0, -1), name="later")
    form = problem.form.given + mpm.springs(other, u, v, stiffness=K)
    again = mpm.QuasiStatic(form, u, points, mpm.rollers(V, "left"), stabilisation="ghost")
    again.step()
    np.testing.assert_allclose(points["base_spring_way"], way, atol=1e-6 * way.max())
    assert np.abs(points["later_spring_way"]).max() < 1e-6 * way.max()


def test_springs_know_what_moved_the_body_without_them():
    problem, face = block()
    points, V = problem.points, problem.fields[0].space
    u, v = V.increment, V.test
    held = mpm.prescribed(V, "left", 1, increment=-0.01) + mpm.rollers(V, "left")
    law = mpm.materials.Hencky(E=1e4, nu=0.0)
    mpm.QuasiStatic(mpm.momentum(law, points, u, v), u, points, held).step()
    assert face.mean_displacement()[1] == pytest.approx(-0.01, rel=1e-3)
    bed = next(term for term in problem.form.terms if term.kind == "springs")
    assert bed.energy()[0] == pytest.approx(0.5 * K * 0.5 * 0.01**2, rel=1e-3)


def test_a_face_that_leaves_the_grid_is_at_its_side():
    """It had been half as far outside as it was at points of a row whose domain was longer."""
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (0.75, 0.75)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    load = fem.Constant(grid, (0.0, 0.0))
    face = mpm.Surface(points, lambda x: x[1] < 0.1, (0, -1))
    F = mpm.momentum(mpm.materials.Hencky(E=100.0, nu=0.0), points, u, v)
    F += mpm.springs(face, u, v, stiffness=K) - ufl.inner(load, v) * points.dX
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left"), stabilisation="ghost")
    for load.value[1] in (-1.0, -2.0, -3.0):
        problem.step()
    assert face.mean_displacement()[1] < -0.04
    y = np.round(points["x0"][:, 1], 6)
    for row in np.unique(y):
        assert np.ptp(points["stress"][y == row, 1, 1]) < 5e-3 * WEIGHT
