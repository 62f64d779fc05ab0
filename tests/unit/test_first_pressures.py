"""Pressures of water that the points have before the first step, and their gradient."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm._platform.errors import UnstablePairWarning
from dolfinmpm.cut.firstgradients import _moments, _shifted

G, WATER, DENSITY = 9.81, 9810.0, 1900.0


def told(projection):
    """The warning of an unstable pair without a projection."""
    unstable = projection == "none"
    return pytest.warns(UnstablePairWarning) if unstable else contextlib.nullcontext()


def column(top=4.0, per_cell=2, basis="gimp", pressure=None, **more):
    """A drained column of saturated soil under its effective stress at rest, and its problem."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 1, 3), np.linspace(0, 5, 11)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1, top)), per_cell, DENSITY)
    V, Q = mpm.Space(grid, basis), mpm.Space(grid, basis, shape=())
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    soil = mpm.materials.Hencky(20e6, 0.3)
    mpm.set_stress(soil, points, mpm.geostatic_stress(top, DENSITY * G - WATER, 0.6))
    points.add_field("pressure", (), "Pa")
    points["pressure"] = pressure(points["x"]) if pressure else WATER * (top - points["x"][:, 1])
    F = mpm.poromechanics(
        soil, points, (u, p), (v, q), permeability=1e-6, porosity=0.4, gravity=(0.0, -G),
        drained=mpm.Surface(points, lambda x: np.isclose(x[1], top), (0, 1)), **more,
    )  # fmt: skip
    bcs = mpm.rollers(V, "left", "right", "bottom")
    return points, mpm.Transient(F, [u, p], points, bcs, stabilisation=["ghost", "ghost"])


@pytest.mark.parametrize("theta", [0.5, 1.0])
@pytest.mark.parametrize(("top", "per_cell"), [(4.0, 2), (3.8, 2), (4.0, 1)])
def test_saturated_soil_at_rest_stays_at_rest(top, per_cell, theta):
    """The first step had taken the gradient before it for zero: pressures were off by 2 kPa."""
    points, problem = column(top, per_cell, theta=theta)
    pressure, stress = points["pressure"].copy(), points["stress"].copy()
    for t in (1.0, 100.0):
        problem.step(t)
        assert points["pressure"] == pytest.approx(pressure, abs=1e-5)
        assert np.abs(points["stress"] - stress).max() < 1e-5
    assert np.abs(points["x"] - points["x0"]).max() < 1e-12


def test_gradients_follow_from_pressures_set_late_and_are_kept():
    points, problem = column()
    points["pressure"] = 1e3 + points["x0"] @ [300.0, -200.0]
    problem.operator()
    slope = points["pressure_gradient"]
    assert slope == pytest.approx(np.broadcast_to([300.0, -200.0], slope.shape))
    # a gradient that is known already stays
    points, problem = column()
    points.add_field("pressure_gradient", (2,), "Pa/m")
    points["pressure_gradient"] = [1.0, 2.0]
    problem.operator()
    assert (points["pressure_gradient"] == [1.0, 2.0]).all()
    # and an even pressure has none
    points, problem = column(pressure=lambda x: np.full(len(x), 5e3))
    problem.operator()
    assert np.abs(points["pressure_gradient"]).max() < 1e-7


@pytest.mark.parametrize("projection", ["auto", "none"])
def test_crank_and_nicolson_begin_with_the_flow_of_given_pressures(projection):
    """A half wave of pressure that drains: the first step had begun without flow, 1.2 % off."""
    H, k, M, first, T, n = 1.0, 1e-8, 1e7, 1e4, 0.2, 20
    grid = mpm.create_lattice(COMM, [np.array([0.0, 0.05]), np.linspace(0, 1, 21)])
    points = mpm.fill(grid, mpm.Box((0, 0), (0.05, H)), 2, 2000.0)
    V, Q = mpm.Space(grid, "linear"), mpm.Space(grid, "linear", shape=())
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    soil = mpm.materials.Hencky(M, 0.0)

    def wave(y):
        return first * np.cos(np.pi * y / 2 / H)

    points.add_field("pressure", (), "Pa")
    points["pressure"] = wave(points["x"][:, 1])
    mpm.set_stress(
        soil, points, lambda x: wave(x[1])[:, None, None] * np.diag([0.0, 1.0, 0.0]), strain="small"
    )
    with told(projection):
        F = mpm.poromechanics(
            soil, points, (u, p), (v, q), permeability=k, porosity=0.4, theta=0.5, strain="small",
            drained=mpm.Surface(points, lambda x: np.isclose(x[1], H), (0, 1)),
            projection=projection,
        )  # fmt: skip
    bcs = mpm.rollers(V, "left", "right", "bottom")
    problem = mpm.Transient(F, [u, p], points, bcs)
    for t in np.linspace(0, T * H**2 / (k * M / 9810.0), n + 1)[1:]:
        problem.step(t)
    exact = wave(points["x0"][:, 1]) * np.exp(-((np.pi / 2) ** 2) * T)
    assert np.abs(points["pressure"] - exact).max() < 3e-3 * exact.max()


@pytest.mark.parametrize("d", [1, 2, 3])
def test_a_rank_without_points_has_moments_of_none(d):
    """A body of a few points in a grid of many cells leaves ranks without points."""
    none = _moments(np.zeros((0, d)), np.zeros(0))
    assert none.shape == (0, 2 + 2 * d + d * d)
    assert _shifted(none, np.zeros((0, d))).shape == none.shape
