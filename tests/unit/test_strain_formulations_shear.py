"""Strain formulations in shear and in turning, and in problems."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from conftest import COMM, unit_grid
from dolfinx import fem, mesh
from test_strain_formulations import (
    KINDS,
    LAWS,
    bound,
    each_dimension,
    each_measure,
    ended,
    flux,
    some_points,
    with_history,
)

import dolfinmpm as mpm
from dolfinmpm.kinematics import (
    momentum,
)
from dolfinmpm.kinematics.strainformulation import symmetric
from dolfinmpm.materials.base import lame


def sheared_to(strain, law, gamma, steps):
    """Stress of a point after simple shear γ in equal steps, shape (3, 3)."""
    points = some_points(2, 1, 2)
    operator = bound(law, points, strain)
    H = np.zeros((len(points), 2, 2))
    H[:, 0, 1] = gamma / steps
    for _ in range(steps):
        for name, values in ended(operator, H.reshape(-1, 4)).items():
            points[name] = values
        points["F"] = (np.eye(2) + H) @ points["F"]
    return points["stress"][0]


def test_jaumann_shear_oscillates_as_in_closed_form():
    """σ12 = μ sin γ and σ11 = −σ22 = μ (1 − cos γ), reached with order 1 in the step."""
    mu = lame(1e6, 0.3)[1]
    for gamma in (0.5, 2.0, math.pi, 5.0):
        exact = math.sin(gamma) + 1j * (1 - math.cos(gamma))
        errors = []
        for steps in (100, 200):
            sigma = sheared_to("jaumann", LAWS["Hencky"], gamma, steps) / mu
            found = sigma[0, 1] + 1j * sigma[0, 0]
            # the algorithm itself in closed form: what there is turns by θ, tan(θ/2) = Δγ/4
            turn = np.exp(4j * math.atan(gamma / steps / 4))
            summed = gamma / steps * (turn**steps - 1) / (turn - 1)
            np.testing.assert_allclose(found, summed, rtol=1e-11)
            np.testing.assert_allclose(sigma[1, 1], -sigma[0, 0], atol=1e-12)
            errors.append(abs(found - exact))
        lag = 0.5 * gamma / 200 * abs(exact)  # of half a step's turn
        assert 0.95 * lag < errors[1] < 1.05 * lag
        assert 1.95 < errors[0] / errors[1] < 2.05


def test_shear_of_the_other_measures():
    """Small strain: σ12 = μ γ. Large strain: Hencky's closed form, 2 μ asinh(γ/2) turned."""
    mu = lame(1e6, 0.3)[1]
    gamma = 2.0
    sigma = sheared_to("small", LAWS["Hencky"], gamma, 50)
    np.testing.assert_allclose(sigma[0, 1], mu * gamma, rtol=1e-12)
    np.testing.assert_allclose(np.diagonal(sigma), 0.0, atol=1e-9 * mu)
    sigma = sheared_to("large", LAWS["Hencky"], gamma, 50)
    level = 2 * mu * math.asinh(gamma / 2)
    side = math.sqrt(gamma**2 + 4)
    np.testing.assert_allclose(sigma[0, 1], level * 2 / side, rtol=1e-10)
    np.testing.assert_allclose(sigma[0, 0], level * gamma / side, rtol=1e-10)


def test_jaumann_leaves_stress_after_a_closed_cycle_that_large_strain_does_not():
    """The drift that the documentation warns of: shear, stretch, shear back, unstretch."""
    left = {}
    for strain in ("large", "jaumann"):
        points = some_points(2, 1, 2)
        operator = bound(LAWS["Hencky"], points, strain)
        F = np.eye(2)
        targets = [F + np.array([[0, g], [0, 0]]) for g in np.linspace(0.02, 0.4, 20)]
        targets += [np.diag([1.0, s]) @ targets[-1] for s in np.linspace(1.02, 1.4, 20)]
        turn = targets[-1]
        targets += [turn + s * (np.eye(2) - turn) for s in np.linspace(0.02, 1, 50)]
        for target in targets:
            H = np.broadcast_to(target @ np.linalg.inv(F) - np.eye(2), (len(points), 2, 2))
            for name, values in ended(operator, np.ascontiguousarray(H).reshape(-1, 4)).items():
                points[name] = values
            F = target
            points["F"] = F
        left[strain] = np.abs(points["stress"]).max() / 1e6
    assert left["large"] < 1e-12
    assert 1e-4 < left["jaumann"] < 0.1


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("strain", ["large", "jaumann"])
def test_a_rotation_of_any_angle_turns_the_stress_exactly(strain, d):
    points = some_points(d, 1, 2)
    operator = bound(LAWS["Hencky"], points, strain)
    with_history(operator)
    points["F"] = np.eye(d)
    n = len(points)
    before = ended(operator, np.zeros((n, d * d)))["stress"]
    for angle in (1e-3, 0.5, 2.0, -3.0):
        c, s = math.cos(angle), math.sin(angle)
        R = np.eye(3)
        R[:2, :2] = [[c, -s], [s, c]]
        if d == 3:
            tilt = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
            R = tilt @ R @ tilt.T
        H = np.broadcast_to(R[:d, :d] - np.eye(d), (n, d, d))
        after = ended(operator, np.ascontiguousarray(H).reshape(n, d * d))
        scale = np.abs(before).max()
        np.testing.assert_allclose(after["stress"], R @ before @ R.T, atol=1e-11 * scale)
        S = flux(operator, np.ascontiguousarray(H))
        piola = (after["stress"] @ R)[:, :d, :d].reshape(n, d * d)
        np.testing.assert_allclose(S, piola, atol=1e-11 * scale)


def test_small_strain_does_not_turn():
    points = some_points(2, 1, 2)
    operator = bound(LAWS["Hencky"], points, "small")
    with_history(operator)
    before = ended(operator, np.zeros((len(points), 4)))["stress"]
    spin = np.broadcast_to([0.0, -1e-2, 1e-2, 0.0], (len(points), 4))
    after = ended(operator, np.ascontiguousarray(spin))["stress"]
    np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-9)


@each_dimension
def test_small_strain_patch_is_linear_elasticity(d):
    """A linear motion of the edge, in one Newton iteration, with Hooke's stress."""
    grid = unit_grid(KINDS[d], 3)
    points = mpm.fill(grid, mpm.Box((0.0,) * d, (1.0,) * d), 2, 1.0)
    V = mpm.Space(grid, "linear")
    A = 0.05 * np.array([[-1.0, 0.4, 0.2], [0.3, -0.8, 0.5], [0.1, 0.6, -0.9]])[:d, :d]

    def outer(x):
        return np.any((x[:d] < 1e-9) | (x[:d] > 1 - 1e-9), axis=0)

    bcs = [
        c
        for i in range(d)
        for c in mpm.prescribed(V, outer, i, increment=lambda x, i=i: A[i] @ x[:d])
    ]
    F = mpm.momentum(LAWS["Hencky"], points, V.increment, V.test, strain="small")
    record = mpm.QuasiStatic(F, V.increment, points, bcs).step()
    lmbda, mu = lame(1e6, 0.3)
    strain = np.zeros((3, 3))
    strain[:d, :d] = 0.5 * (A + A.T)
    hooke = lmbda * np.trace(strain) * np.eye(3) + 2 * mu * strain
    np.testing.assert_allclose(points["stress"], np.broadcast_to(hooke, points["stress"].shape),
                               atol=1e-9 * np.abs(hooke).max())  # fmt: skip
    np.testing.assert_allclose(
        symmetric(points["elastic_strain"]), np.broadcast_to(strain, (len(points), 3, 3)),
        atol=1e-12,
    )  # fmt: skip
    assert record.iterations <= 1


def compacted(strain, load, basis="gimp", E=1e6, nu=0.3):
    """A block under its weight, leaned on by a shear load."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 3)], (4, 6), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0.5, 0), (1.5, 2)), 2, 1000.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    F = momentum(mpm.materials.Hencky(E, nu), points, u, v, strain=strain)
    F -= ufl.inner(points.density * g, v) * points.dX
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    g.value[:] = 0.3 * load, -load
    record = problem.step()
    return points, record


@each_measure
def test_measures_agree_in_a_problem_at_tiny_loads(strain):
    small, record = compacted("small", 1e-3)
    assert record.iterations == 1
    other, _ = compacted(strain, 1e-3)
    move, exact = other["x"] - other["x0"], small["x"] - small["x0"]
    np.testing.assert_allclose(move, exact, atol=1e-4 * np.abs(exact).max())
    scale = np.abs(small["stress"]).max()
    np.testing.assert_allclose(other["stress"], small["stress"], atol=1e-4 * scale)


@pytest.mark.parametrize("strain", ["large", "jaumann"])
def test_newton_is_quadratic(strain):
    """Large loads in one step: the last ratios of residuals show the consistent tangent."""
    _, record = compacted(strain, 30.0)
    r = np.array(record.residuals)
    assert record.parts == 1
    assert record.iterations <= 7
    assert r[-1] < 1e-9
    assert r[-2] < 1e-3
    assert r[-1] < 20 * r[-2] ** 1.8
