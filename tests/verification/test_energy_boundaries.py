"""Energies of bodies that boundaries push: prescribed motions, pressures and walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm._platform.errors import InstabilityError

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
    ("kind", "options"),
    [(mpm.Newmark, {}), (mpm.GeneralisedAlpha, {}), (mpm.GeneralisedAlpha, {"rho_inf": 0.0})],
)
def test_a_stiff_wall_that_multiplies_energy_is_refused(kind, options):
    """The energy of an impact had grown four times, without a message."""
    h = 0.125
    grid = mpm.create_lattice(COMM, [np.arange(25) * h, np.arange(9) * h])
    points = mpm.fill(grid, mpm.Box((1.0, 0.03), (1.5, 0.53)), 2, RHO)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(LAW, points, V.increment, V.test)
    F += mpm.signorini(mpm.Boundary.from_side(points, "bottom"), V.increment, V.test, law=LAW)
    points.add_field("velocity", (2,), "m/s", (0.3, -1.0))
    problem = kind(F, V.increment, points, **IMPLICIT, **options)

    def run():
        for k in range(80):
            problem.step((k + 1) * 1e-3)

    if not options:
        with pytest.raises(InstabilityError, match=r"walls .* at rest have given .* rho_inf = 0"):
            run()
    else:
        run()
    e = problem.energies()
    assert e.kinetic + e.strain + e.contact < 2.0 * e.initial


def test_a_refused_step_adds_no_work_of_walls(monkeypatch):
    """A later check may refuse a step that the check of walls has let pass."""
    problem, _ = bar(mpm.Newmark, "wall", 0.0, (0.0, -1.0), **IMPLICIT)
    motion = problem.scheme.motion
    while not problem.energies().contact > 0.0:
        problem.step(problem.time + 2e-3)
    done, own = motion.walls.done, type(motion).to_points
    assert done < 0.0
    refused = []

    def refuse(self, *args):
        reason = own(self, *args) if refused else "refused once"
        if not refused:
            refused.append(self.walls.done)
        return reason

    monkeypatch.setattr(type(motion), "to_points", refuse)
    record = problem.step(problem.time + 2e-3)
    assert record.halvings == 1
    assert refused == [done]


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
