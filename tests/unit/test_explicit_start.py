"""The start of explicit steps, and motions prescribed in them: of the second order in time."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from scenes import vibrating_bar

import dolfinmpm as mpm

LOOPS = [("musl", True), ("musl", False), ("usl", True), ("usf", True), ("usf", False)]


def block(scheme, fused, conditions=lambda V: (), bottom=0.25, gravity=0.0):
    """A block of 0.5 m × 0.5 m in cells of an eighth."""
    grid = unit_grid("quadrilateral", 8)
    points = mpm.fill(grid, mpm.Box((0.25, bottom), (0.75, bottom + 0.5)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(1e6, nu=0.0), points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, gravity)), V.test) * points.dX
    return mpm.Explicit(F, V.increment, points, conditions(V), scheme=scheme, fused=fused)


@pytest.mark.parametrize(("scheme", "fused"), LOOPS)
def test_a_throw_is_exact(scheme, fused):
    """Velocities are those at the start: forces act on them for half of the first step."""
    problem = block(scheme, fused, gravity=-2.0)
    points = problem.points
    points["velocity"] = (0.0, 0.4)
    # steps of two lengths
    for t in (0.11, 0.4):
        dt = problem.step(t).dt
        np.testing.assert_allclose((points["x"] - points["x0"])[:, 1], 0.4 * t - t**2, atol=1e-12)
        np.testing.assert_allclose(points["velocity"][:, 1], 0.4 - 2.0 * (t - 0.5 * dt), atol=1e-11)
        now = points["velocity"] + 0.5 * dt * points["acceleration"]
        np.testing.assert_allclose(now[:, 1], 0.4 - 2.0 * t, atol=1e-11)
    assert abs(problem.energies()["integrator"]) < 1e-3 * problem.energies().initial


@pytest.mark.parametrize(("scheme", "fused"), LOOPS)
def test_a_first_velocity_strains_nothing_before_the_body_moves(scheme, fused):
    """A column swings about its place also in "usf", in steps of several lengths."""
    problem = block(scheme, fused, lambda V: mpm.rollers(V, "bottom"), bottom=0.0)
    points, rate = problem.points, np.pi
    omega, c = rate * np.sqrt(1e3), 0.01
    points["velocity"][:, 1] = c * np.sin(rate * points["x0"][:, 1])
    for k in (1, 3, 4, 8):
        t = k / 8 * 2 * np.pi / omega
        problem.step(t)
        exact = c / omega * np.sin(rate * points["x0"][:, 1]) * np.sin(omega * t)
        assert np.abs((points["x"] - points["x0"])[:, 1] - exact).max() < 0.15 * c / omega


@pytest.mark.parametrize(("scheme", "fused"), LOOPS)
def test_driven_nodes_go_as_far_as_their_velocity_tells(scheme, fused):
    """The velocity of a step is that in its middle; the velocity at its end leads by half of it."""

    def driven(V):
        return mpm.moving(V, lambda x: x[0] > -1.0, 0, velocity=lambda t: 2.0 * t)

    problem = block(scheme, fused, driven)
    points = problem.points
    for t in (0.11, 0.3):
        dt = problem.step(t).dt
        np.testing.assert_allclose((points["x"] - points["x0"])[:, 0], t**2, atol=1e-12)
        np.testing.assert_allclose(points["velocity"][:, 0], 2.0 * (t - 0.5 * dt), atol=1e-12)


def test_another_order_of_the_points_is_no_change_of_their_velocities():
    """A restart on other ranks adds up the energy in another order, with other last digits."""
    problem = vibrating_bar(mpm.Explicit)
    problem.step(0.3)
    points, before = problem.points, problem.energies()
    alone = problem.ledger.kinetic()
    random = np.random.default_rng(1)
    while problem.ledger.kinetic() == alone:
        order = random.permutation(len(points))
        points.fields.update({name: values[order] for name, values in points.fields.items()})
        points.recount()
    found = problem.energies()
    assert abs(found.kinetic - alone) > 1e-6 * alone
    assert found.kinetic == pytest.approx(before.kinetic, rel=1e-12)
    problem.step(0.6)
    assert problem.energies().initial == pytest.approx(before.initial, rel=1e-12)
