"""Energies of bodies that boundaries push: prescribed motions, pressures and walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem

import dolfinmpm as mpm

RHO, E = 1000.0, 1e6
C = math.sqrt(E / RHO)
LAW = mpm.materials.Hencky(E=E, nu=0.0)


def bar(kind, load, friction=None, velocity=(0.0, 0.0), low=(1.03, 0.03), length=0.5, **options):
    """A bar off the lines of the grid, with a load on its left face, or above a wall."""
    h = 0.125
    grid = mpm.create_lattice(COMM, [np.arange(25) * h, np.arange(9) * h])
    high = (low[0] + length, low[1] + 0.5)
    points = mpm.fill(grid, mpm.Box(low, high), 2, RHO, aligned="body")
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(LAW, points, u, v)
    t = fem.Constant(grid, 0.0)
    if load == "wall":
        face = mpm.Boundary.from_side(points, "bottom")
        F += mpm.signorini(face, u, v, law=LAW, friction=friction, penalty=10.0)
    else:
        face = mpm.Boundary.from_polygon(points, [(low[0], high[1]), low], closed=False)
        if load == "pressure":
            F += face.pressure(1e3, u, v)
        else:
            factor = {"penalty": 10.0} if load == "penalty" else {}
            value = ufl.as_vector((t, 0.0))
            F += mpm.dirichlet(face, u, v, value, law=LAW, method=load, **factor)
    points.add_field("velocity", (2,), "m/s", velocity)
    return kind(F, u, points, (), time=t, **options), face


IMPLICIT = {"stabilisation": "ghost"}


@pytest.mark.parametrize(
    ("kind", "load", "options"),
    [
        (mpm.Newmark, "penalty", IMPLICIT),
        (mpm.Newmark, "nitsche", IMPLICIT),
        (mpm.Newmark, "pressure", IMPLICIT),
        (mpm.GeneralisedAlpha, "penalty", {**IMPLICIT, "rho_inf": 1.0}),
        (mpm.Explicit, "penalty", {"courant": 0.2}),
        (mpm.Explicit, "nitsche", {"courant": 0.2, "stabilisation": "aggregation"}),
        (mpm.Explicit, "pressure", {"courant": 0.2}),
    ],
)
def test_what_pushes_a_face_does_work(kind, load, options):
    """A wave runs into a bar from a face with the velocity v: stress ρ c v, work ρ c v² A t.

    The face begins to move at once, and cells behind the front of the wave swing.
    """
    problem, _ = bar(kind, load, length=1.0, **options)
    v = 1e3 / (RHO * C) if load == "pressure" else 1.0
    end = 0.8 / C
    for k in range(24):
        problem.step((k + 1) * end / 24)
    e = problem.energies()
    assert e.external == pytest.approx(RHO * C * v**2 * 0.5 * end, rel=0.2)
    assert e.kinetic + e.strain == pytest.approx(e.external, rel=0.05)
    assert abs(e["integrator"]) < 0.02 * e.external


@pytest.mark.parametrize(
    ("kind", "options"),
    [(mpm.Explicit, {"courant": 0.2}), (mpm.Newmark, {**IMPLICIT, "mass": "lumped"})],
)
def test_a_wall_at_rest_does_no_work(kind, options):
    """A block bounces aslant: friction takes the impulse times the slip, and the wall nothing."""
    mu = 0.1
    problem, _ = bar(kind, "wall", mu, (2.0, -1.0), **options)
    first = problem.momentum()
    stored = 0.0
    for k in range(60):
        problem.step((k + 1) * 2e-3)
        e = problem.energies()
        stored = max(stored, e.contact)
    push = problem.momentum() - first
    assert push[1] > 1.5 * 250.0
    assert push[0] == pytest.approx(-mu * push[1], rel=0.01)
    assert abs(e.external) < 1e-9 * e.initial
    assert stored > 0.1
    assert e.contact == 0.0
    # the slip is the velocity of the bottom, about that of the body
    between = 2.0 + 0.5 * push[0] / 250.0
    assert e["friction"] == pytest.approx(mu * push[1] * between, rel=0.1)
    assert abs(e["integrator"]) < 0.04 * e.initial


@pytest.mark.parametrize(
    ("kind", "options", "lost"),
    [
        (mpm.Newmark, {}, 2e-4),
        (mpm.GeneralisedAlpha, {"rho_inf": 1.0}, 2e-4),
        (mpm.GeneralisedAlpha, {}, 5e-3),
        (mpm.GeneralisedAlpha, {"rho_inf": 0.0}, 0.2),
    ],
)
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_an_impact_on_a_stiff_wall_keeps_its_energy(kind, options, lost, friction):
    """The energy had grown four times in steps that do not resolve the penalty."""
    h = 0.125
    grid = mpm.create_lattice(COMM, [np.arange(25) * h, np.arange(9) * h])
    points = mpm.fill(grid, mpm.Box((1.0, 0.03), (1.5, 0.53)), 2, RHO)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(LAW, points, V.increment, V.test)
    wall = mpm.Boundary.from_side(points, "bottom")
    F += mpm.signorini(wall, V.increment, V.test, law=LAW, friction=friction)
    points.add_field("velocity", (2,), "m/s", (2.0 if friction else 0.3, -1.0))
    problem = kind(F, V.increment, points, **IMPLICIT, **options)
    first = problem.momentum()
    for k in range(80):
        problem.step((k + 1) * 1e-3)
    e, push = problem.energies(), problem.momentum() - first
    assert push[1] > 1.5 * 250.0
    assert push[0] == pytest.approx(-friction * push[1], abs=1e-9 * push[1])
    assert -1e-4 * e.initial < e["integrator"] < lost * e.initial
    assert e.external == pytest.approx(0.0, abs=1e-9 * e.initial)
    assert e["friction"] == pytest.approx(friction * push[1] * 1.0, rel=0.1, abs=1e-9)


@pytest.mark.parametrize(
    ("kind", "dt", "options"),
    [
        (mpm.Newmark, 0.02, IMPLICIT),
        (mpm.Newmark, 0.002, IMPLICIT),
        (mpm.GeneralisedAlpha, 0.02, IMPLICIT),
        (mpm.Explicit, 0.02, {}),
    ],
)
def test_a_block_slides_down_a_wall(kind, dt, options):
    """½ g t² (sin θ − μ cos θ). It had hopped, up to 55 % too far, and made half of its energy."""
    mu, g = 0.3, 10.0 * np.array([0.5, -math.sqrt(0.75)])
    grid = mpm.create_lattice(COMM, [np.arange(13) * 0.25, np.arange(7) * 0.25])
    points = mpm.fill(grid, mpm.Box((0.5, 0.0), (1.5, 0.5)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    law = mpm.materials.Hencky(E=1e7, nu=0.3)
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * fem.Constant(grid, g), V.test) * points.dX
    wall = mpm.Boundary.from_side(points, "bottom")
    F += mpm.signorini(wall, V.increment, V.test, law=law, friction=mu)
    problem = kind(F, V.increment, points, **options)
    for k in range(round(0.4 / dt)):
        problem.step((k + 1) * dt)
    way, e = (points["x"] - points["x0"]).mean(axis=0), problem.energies()
    assert way[0] == pytest.approx(0.08 * (g[0] + mu * g[1]), rel=0.015)
    assert abs(way[1]) < 1e-3
    assert abs(e["integrator"]) < (0.02 if kind is mpm.Explicit else 5e-3) * e.external
    assert e["friction"] == pytest.approx(-mu * 1000.0 * g[1] * way[0], rel=0.15)


def test_infinite_friction_of_a_wall_ends_with_the_contact():
    """The wall had held the body after it had lifted off."""
    problem, wall = bar(mpm.Explicit, "wall", math.inf, (2.0, -1.0))
    for k in range(60):
        problem.step((k + 1) * 2e-3)
    np.testing.assert_array_equal(wall.force(), 0.0)
    before = problem.momentum()
    problem.step(problem.time + 5e-3)
    np.testing.assert_allclose(problem.momentum(), before, rtol=1e-9)
    assert before[0] < 450.0


def standing(basis, stabilisation, direction, method, follows):
    """A block of 8 × 8 cells off the lines of the grid on a boundary; its form, and its gravity."""
    h, x0, y0 = 0.125, 0.013, 0.046
    grid = mpm.create_lattice(COMM, [np.arange(-2, 12) * h, np.arange(-1, 11) * h])
    points = mpm.fill(grid, mpm.Box((x0, y0), (1 + x0, 1 + y0)), 3, RHO, aligned="body")
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0))
    law = mpm.materials.Hencky(2e6, 0.3)
    base = mpm.Boundary.from_polygon(
        points, [(x0, y0), (1 + x0, y0)], closed=False, follows=follows
    )
    F = mpm.momentum(law, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
    F += mpm.dirichlet(base, u, v, 0.0, law=law, direction=direction, method=method)
    return F, u, points, {"stabilisation": stabilisation}, gravity, base


@pytest.mark.parametrize(
    ("basis", "stabilisation", "direction", "method", "follows"),
    [
        ("gimp", "ghost", "normal", "nitsche", True),
        ("gimp", "aggregation", "normal", "nitsche", False),
        ("gimp", "ghost", None, "skew", True),
        ("bspline2", "ghost", None, "nitsche", True),
    ],
)
def test_a_held_face_makes_no_energy(basis, stabilisation, direction, method, follows):
    """A block swings in its weight, which comes at once; Poisson's ratio couples directions."""
    F, u, points, options, gravity, _ = standing(basis, stabilisation, direction, method, follows)
    problem = mpm.Newmark(F, u, points, **options)
    gravity.value[1] = -10.0
    first = points["x"][:, 1] @ points["V0"]
    for k in range(100):
        problem.step((k + 1) * 6e-3)
        e = problem.energies()
        work = RHO * 10.0 * (first - points["x"][:, 1] @ points["V0"])
        # the static sag has 12 J or less; the ghost penalty and the mapping take some of the rest
        assert e.kinetic + e.strain == pytest.approx(work, rel=0.03, abs=0.3)


def test_a_face_held_in_statics_stays_at_rest_in_time():
    """The penalty is another one in time; its force goes on."""
    F, u, points, options, gravity, base = standing("gimp", "ghost", None, "nitsche", True)
    static = mpm.QuasiStatic(F, u, points, **options)
    gravity.value[1] = -10.0
    static.step()
    sagged, force = points["x"].copy(), base.force()
    np.testing.assert_allclose(force, (0.0, 10.0 * RHO), atol=1e-4 * RHO)
    problem = mpm.Newmark(F, u, points, **options)
    for k in range(20):
        problem.step((k + 1) * 5e-3)
        np.testing.assert_allclose(base.force(), force, atol=0.04 * force[1])
        moved = np.abs(points["x"] - sagged).max()
        assert moved < 0.04 * np.abs(sagged - points["x0"]).max()
