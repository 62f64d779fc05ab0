"""Blocks on soft springs and rigid bodies in all orders of explicit steps, and a hammer."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

K, SPEED, DENSITY = 1e5, 0.3, 1000.0  # Pa/m, m/s, kg/m³
PERIOD = 2 * np.pi / np.sqrt(K / DENSITY)  # of a rigid block 1 m high
ORDERS = [("musl", True), ("musl", False), ("usl", True), ("usf", True), ("usf", False)]


def block(under, velocity, scheme, fused=True):
    """A stiff block with a velocity, and what is under it."""
    corners, cells = [(0, -1), (2, 3)], mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, (4, 8), cells)
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), per_cell=2, density=DENSITY)
    points.add_field("velocity", (2,), "m/s", lambda x: np.outer(np.ones(len(x.T)), (0, velocity)))
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=1e7, nu=0.0), points, V.increment, V.test)
    F += under(points, V.increment, V.test)
    bcs = mpm.rollers(V, "left", "right")
    return mpm.Explicit(F, V.increment, points, bcs, scheme=scheme, fused=fused)


def stored(problem):
    """What is left of the energy, at the time of the positions."""
    now = problem.energies()
    return (now.kinetic + now.bodies + now.strain + now.contact) / now.initial


# the softness is meant
@pytest.mark.filterwarnings("ignore:penalty = 0.005 is in units of E/h")
@pytest.mark.parametrize(("scheme", "fused"), ORDERS)
def test_a_block_bounces_on_a_soft_plane(scheme, fused):
    """For half a period; the force is that of the penetration, and the energy stays."""
    plane = mpm.RigidBody(mpm.Plane((0, 0), (0, 1)))

    def under(points, u, v):
        # in units of E/h: a stiffness_per_area so small is taken for one in kPa/m
        return mpm.contact(plane, points, u, v, penalty=K * 0.5 / 1e7)

    problem = block(under, -SPEED, scheme, fused)
    assert bool(problem.unfused) != fused
    impulse, left = 0.0, []
    for t in mpm.times(0.6 * PERIOD, dt=PERIOD / 240):
        start = problem.time
        problem.step(t)
        impulse -= plane.force[1] * (problem.time - start)
        left.append(stored(problem))
    assert impulse == pytest.approx(2 * DENSITY * 2 * SPEED, rel=0.005)
    assert problem.points["velocity"][:, 1].mean() == pytest.approx(SPEED, rel=1e-3)
    np.testing.assert_allclose(left, 1.0, atol=2e-3)


@pytest.mark.parametrize("scheme", ["musl", "usl", "usf"])
def test_a_block_swings_on_springs(scheme):
    def under(points, u, v):
        face = mpm.Surface(points, lambda x: x[1] < 0.1, normal=(0, -1), name="face")
        return mpm.springs(face, u, v, stiffness=K)

    problem, left = block(under, SPEED, scheme), []
    for t in mpm.times(0.5 * PERIOD, dt=PERIOD / 20):
        problem.step(t)
        left.append(stored(problem))
    np.testing.assert_allclose(left, 1.0, atol=2e-3)
    # the block is not quite rigid
    lag = 0.5 * PERIOD * (np.sqrt(1 + K / 3e7) - 1)
    way = (problem.points["x"] - problem.points["x0"])[:, 1].mean()
    assert way == pytest.approx(SPEED * lag, abs=0.01 * SPEED * PERIOD / (2 * np.pi))


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_a_hammer_hits_a_bar_with_a_consistent_mass(basis):
    """v = v₀ exp(−ρ c t / m) while the wave runs; quadratic splines move less mass at a face."""
    E, h, L, v0, mass = 1e6, 0.1, 2.0, 0.02, 200.0
    c, corners = np.sqrt(E / DENSITY), [(0, -0.3), (2 * h, L + 0.3)]
    quads = mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, (2, 26), quads)
    points = mpm.fill(grid, mpm.Box((0, 0), (2 * h, L)), per_cell=2, density=DENSITY)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    free = (False, True, False)
    hammer = mpm.RigidBody(
        mpm.Box((-1, L), (1, L + 1)), mass=mass, free=free, velocity=(0, -v0), name="hammer"
    )
    F = mpm.momentum(mpm.materials.Hencky(E, nu=0.0), points, u, v)
    F += mpm.contact(hammer, points, u, v, penalty=20)
    problem = mpm.Explicit(F, u, points, mpm.rollers(V, "left", "right"), mass="consistent")
    for t in mpm.times(L / c, dt=0.05 * L / c):
        problem.step(t)
    assert stored(problem) == pytest.approx(1.0, abs=0.04)
    exact = np.exp(-DENSITY * c * 2 * h / mass * problem.time)
    assert -hammer.freedom.velocity[1] / v0 == pytest.approx(exact, abs=0.03)
