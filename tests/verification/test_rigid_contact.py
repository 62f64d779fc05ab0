"""Contact with rigid bodies against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.optimize import brentq

import dolfinmpm as mpm

G = 9.81


def plate(kappa, d=2, basis="gimp", steps=4, marked=True, **options):
    """A plate on a cube of 0.8 m, E = 1 MPa, pressed by 0.2 m; its height and the plate."""
    make = mesh.create_rectangle if d == 2 else mesh.create_box
    cells = mesh.CellType.quadrilateral if d == 2 else mesh.CellType.hexahedron
    side = (0.8,) * (d - 1)
    grid = make(MPI.COMM_WORLD, [(0,) * d, (*side, 1.2)], (2,) * (d - 1) + (3,), cells)
    points = mpm.fill(grid, mpm.Box((0,) * d, (*side, 0.8)), 2, 1000.0)
    V = mpm.Space(grid, basis)
    zero = (0.0,) * (d - 1)
    body = mpm.RigidBody(mpm.Plane((*zero, 0.8), (*zero, -1)), increment=(*zero, -0.2 / steps))
    top = mpm.Surface(points, lambda x: np.isclose(x[-1], 0.8), (*zero, 1)) if marked else None
    F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.0), points, V.increment, V.test)
    F += mpm.contact(
        body, points, V.increment, V.test, stiffness_per_area=kappa, surface=top, **options
    )
    sides = ("left", "right", "bottom") + (("front", "back") if d == 3 else ())
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.rollers(V, *sides), tolerance=1e-10)
    for _ in range(steps):
        problem.step()
    if "penetration" not in options:
        assert max(record.iterations for record in problem.history) <= 8
    return points["V"].sum() / 0.8 ** (d - 1), body, problem


@pytest.mark.parametrize(
    ("ratio", "height", "stress"),
    [
        (10, 0.630268478, -0.302684779),
        (30, 0.611699456, -0.350983672),
        (300, 0.601266542, -0.379962463),
        (1000, 0.600382483, -0.382482585),
    ],
)
@pytest.mark.parametrize("d", [2, 3])
def test_a_plate_on_a_cube(d, ratio, height, stress):
    found, body, _ = plate(ratio * 1e6, d, marked=ratio != 1000)
    assert found == pytest.approx(height, abs=1e-9)
    assert -body.force[-1] / 0.8 ** (d - 1) == pytest.approx(stress * 1e6, rel=1e-8)
    np.testing.assert_allclose(body.force[:-1], 0, atol=1e-6)


def test_a_soft_plate_gets_deep_into_marked_faces_only():
    balance = lambda s: math.log(s) / s + (s * 0.8 - 0.6)  # noqa: E731
    found, _, _ = plate(1e6)
    assert found == pytest.approx(0.8 * brentq(balance, 0.5, 1), rel=1e-10)


def test_multipliers_bound_the_penetration():
    found, body, problem = plate(2e6, steps=2, penetration=1e-7)
    assert found == pytest.approx(0.6, abs=1.1e-7)
    assert -body.force[1] / 0.8 == pytest.approx(math.log(0.75) / 0.75 * 1e6, rel=1e-6)
    # the pressure that the points carry is the multiplier of the next step
    pressure = problem.points["contact1_normal_force"]
    assert pressure.sum() == pytest.approx(body.force[1], rel=1e-12)


def block(degrees, friction, integrator, dt=0.01, duration=0.5, basis="gimp"):
    """A block that friction holds on a slope as far as it goes, and that is then let go."""
    angle, L, H, h, rho, k = math.radians(degrees), 1.0, 0.5, 0.25, 1000.0, 1e8
    down, along = G * math.cos(angle), G * math.sin(angle)
    driven = along - friction * down
    far = L + max(0.5 * driven * duration**2, 0.0) + 0.5
    n = math.ceil(far / h)
    ends = [(-h, -h), ((n - 1) * h, 3 * h)]
    grid = mesh.create_rectangle(MPI.COMM_WORLD, ends, (n, 4), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (L, H)), 2, rho)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    # as deep in the block as its weight will have it
    slope = mpm.RigidBody(mpm.Plane((0, rho * down * H / k), (0, 1)), name="slope")
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.0), points, u, v)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    term = mpm.contact(slope, points, u, v, stiffness_per_area=k, friction=friction)
    contact = term.integrals()[0].metadata()["term"]
    F += term
    held = min(along, 0.95 * friction * down)
    if friction:
        static = mpm.QuasiStatic(F, u, points, stabilisation="ghost")
        for part in (0.5, 1.0):
            gravity.value[:] = held * part, -down * part
            assert static.step().iterations <= 8
        np.testing.assert_allclose(slope.force, rho * L * H * np.array([held, -down]), rtol=1e-6)
    gravity.value[:] = along, -down
    first = points["x"].copy()
    options = {} if integrator is mpm.Explicit else {"stabilisation": "ghost"}
    problem = integrator(F, u, points, (), **options)
    taken = contact.dissipated
    for t in mpm.times(duration, dt=dt):
        problem.step(t)
    moved = (points["x"] - first).mean(axis=0)
    normal = rho * L * H * down
    return moved, 0.5 * driven * duration**2, contact.dissipated - taken, normal, problem


@pytest.mark.parametrize("integrator", [mpm.Newmark, mpm.GeneralisedAlpha, mpm.Explicit])
def test_a_block_slides_down_a_slope(integrator):
    moved, exact, dissipated, normal, problem = block(45, 0.3, integrator)
    assert moved[0] == pytest.approx(exact, rel=0.01)
    assert dissipated == pytest.approx(0.3 * normal * exact, rel=0.02)
    if integrator is not mpm.Explicit:
        assert max(record.iterations for record in problem.history) <= 8
        assert not sum(record.halvings for record in problem.history)


def test_a_block_slides_without_friction():
    moved, exact, dissipated, _, _ = block(30, 0.0, mpm.Newmark)
    assert moved[0] == pytest.approx(exact, rel=1e-6)
    assert dissipated == 0.0


def test_a_block_that_friction_holds_does_not_creep():
    moved, _, _, _, problem = block(45, 1.2, mpm.Newmark, dt=0.02)
    assert abs(moved[0]) < 1e-3
    # that the first step in time sees other functions lets it vibrate, which nothing damps
    _, _, _, _, problem = block(45, 1.2, mpm.Newmark, dt=0.02, basis="linear")
    places = []
    for t in mpm.times(1.5, dt=0.02):
        if t > problem.time:
            problem.step(t)
            places.append(problem.points["x"][:, 0].mean())
    first, second = np.mean(np.reshape(places, (2, -1)), axis=1)
    assert abs(second - first) < 2e-5
    # what is lost is known by name
    assert problem.energies()["integrator"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("friction", "rolls"), [(0.5, True), (0.1, False)])
def test_a_free_disc_on_a_slope(friction, rolls):
    """It rolls where tan 30° < 3μ, else it slips; a stiff slope of points is under it."""
    angle, R, m, h, duration = math.radians(30), 1.0, 1e4, 0.125, 0.5
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(-1, -0.5), (1.5, h)], (20, 5), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((-1, -0.5), (1.5, 0)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    down, along = G * math.cos(angle), G * math.sin(angle)
    disc = mpm.RigidBody(
        mpm.Disc((0, R), R), mass=m, inertia=0.5 * m * R**2, gravity=(along, -down), name="disc"
    )
    F = mpm.momentum(mpm.materials.Hencky(E=1e9, nu=0.0), points, V.increment, V.test)
    F += mpm.contact(disc, points, V.increment, V.test, friction=friction, stiffness_per_area=1e9)
    problem = mpm.Newmark(
        F,
        V.increment,
        points,
        mpm.fixed(V, "left", "right", "bottom"),
        beta=0.3025,
        gamma=0.6,
        mass="lumped",
    )
    for t in mpm.times(duration, dt=0.01):
        problem.step(t)
    acceleration = along * 2 / 3 if rolls else along - friction * down
    spin = acceleration / R if rolls else 2 * friction * down / R
    assert disc.position[0] == pytest.approx(0.5 * acceleration * duration**2, rel=0.02)
    assert -np.radians(disc.angle[0]) == pytest.approx(0.5 * spin * duration**2, rel=0.05)
    assert max(record.iterations for record in problem.history) <= 8
