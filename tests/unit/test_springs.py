"""A bed of springs: one file that adds a kind of force."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import Linearised, unit_grid
from dolfinx import fem

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
    assert face.mean_displacement()[1] == pytest.approx(-WEIGHT * 0.5 / K, rel=1e-6)
    assert problem.history[-1].iterations <= 3


def test_the_tangent_is_the_derivative():
    problem, _ = block()
    problem.step()
    linearised = Linearised(problem)
    rng = np.random.default_rng(1)
    x, way, t = rng.uniform(-1e-3, 1e-3, linearised.size), rng.uniform(-1, 1, linearised.size), 1e-6
    linearised.tangent(x)
    exact, residual = linearised.product(way), linearised.residual
    numerical = (residual(x + t * way) - residual(x - t * way)) / (2 * t)
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
