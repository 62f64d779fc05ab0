"""Bodies with fields of their own on each other: patch test, friction, in two and three dimensions.

Stacked blocks under a pressure q without lateral strain have E ln λ/λ = −q each, nominal stress
over stretch, and the gap between them is −q/κ.
"""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import two_blocks
from scipy.optimize import brentq

import dolfinmpm as mpm


def pressed(nu, moduli=(1e3, 4e3), steps=3):
    """Stacked blocks of one width under a pressure that follows their top, free to widen."""
    points, (low, up), F, boundaries = two_blocks(upper=(0.0, 3.0), nu=nu, moduli=moduli)
    q = fem.Constant(points.grid, 0.0)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 2.45), (0, 1))
    F += top.pressure(q, up.increment, up.test)
    bcs = mpm.rollers(low, "bottom", "left") + mpm.rollers(up, "left")
    increments = [low.increment, up.increment]
    problem = mpm.QuasiStatic(F, increments, points, bcs, stabilisation="ghost", tolerance=1e-12)
    for k in range(steps):
        q.value = 50.0 * (k + 1)
        problem.step()
    return problem, boundaries, q.value


def test_pressure_goes_through_the_interface_unchanged():
    """Off the grid's lines, with other sizes of points, moduli, and without lateral strain."""
    problem, (upper, lower), q = pressed(0.0)
    points = problem.points
    np.testing.assert_allclose(points["stress"][:, 1, 1], -q, rtol=1e-10)
    for tag, E in enumerate((1e3, 4e3), 1):
        # without lateral strain areas are what they were
        stretch = brentq(lambda t, E=E: E * np.log(t) / t + q, 0.5, 1.0, xtol=1e-15)
        found = points["F"][points["tag"] == tag][:, 1, 1]
        np.testing.assert_allclose(found, stretch, rtol=1e-9)
    (contact,) = problem.form.parts.terms
    gap = upper.markers["x"][:, 1].mean() - lower.markers["x"][:, 1].mean()
    assert gap == pytest.approx(-q / contact.stiffness, rel=1e-9)
    assert contact.stiffness == pytest.approx(5.0 * 1600.0 / 0.5)


@pytest.mark.long
def test_the_interface_may_widen_past_the_lines():
    """Bodies of one law that widen alike: the segments are cut where the lines come to be."""
    problem, _, q = pressed(0.3, (1e3, 1e3))
    points = problem.points
    np.testing.assert_allclose(points["stress"][:, 1, 1], -q, rtol=1e-10)
    np.testing.assert_allclose(points["stress"][:, 0, 0], 0.0, atol=1e-9 * q)
    # by a third of a cell at the outer edge
    assert points["F"][:, 0, 0].min() > 1.05


@pytest.mark.long
@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_pressure_goes_through_the_interface_in_3d(friction):
    grid = mesh.create_box(
        MPI.COMM_WORLD, [(0, 0, 0), (3, 3, 3)], (3, 3, 4), mesh.CellType.hexahedron
    )
    level, height = 1.4, 2.6
    low = mpm.fill(grid, mpm.Box((0, 0, 0), (3, 3, level)), 2, 1.0, tag=1, aligned="body")
    up = mpm.fill(grid, mpm.Box((0, 0, level), (3, 3, height)), 2, 1.0, tag=2, aligned="body")
    points = low + up
    spaces = [mpm.Space(grid, "gimp", tag=k) for k in (1, 2)]
    u, v = [V.increment for V in spaces], [V.test for V in spaces]
    F = 0
    for k in (0, 1):
        law = mpm.materials.Hencky(E=1e3 * (1 + k), nu=0.3)
        F += mpm.momentum(law, points, u[k], v[k], tag=k + 1)

    def square(z, turned=False):
        corners = [(0, 0, z), (3, 0, z), (3, 3, z), (0, 3, z)]
        triangles = np.array([(0, 1, 2), (0, 2, 3)])
        if turned:
            triangles = triangles[:, ::-1]
        return mpm.Boundary.from_triangles(points, corners, triangles)

    F += mpm.contact_between(
        (square(level, True), square(level)), u[::-1], v[::-1], friction=friction
    )
    q = fem.Constant(grid, 0.0)
    F += square(height).pressure(q, u[1], v[1])
    sides = "left", "right", "front", "back"
    bcs = mpm.rollers(spaces[0], "bottom", *sides) + mpm.rollers(spaces[1], *sides)
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-12)
    for k in range(3):
        q.value = 40.0 * (k + 1)
        record = problem.step()
    np.testing.assert_allclose(points["stress"][:, 2, 2], -120.0, rtol=1e-10)
    (contact,) = problem.form.parts.terms
    np.testing.assert_allclose(record.bodies[contact.name]["force"], [0, 0, 1080], atol=1e-8)


def drawn(friction=0.3):
    """A block that lies on another and is drawn along it by springs; a function draws it on."""
    points, (low, up), F, _ = two_blocks(friction, upper=(0.4, 2.2), moduli=(1e4, 1e4))
    weight, place = fem.Constant(points.grid, (0.0, 0.0)), fem.Constant(points.grid, 0.0)
    u, v = up.increment, up.test
    way = u[0] + (points.x - points.x0)[0] - place
    F += (1e3 * way * v[0] - ufl.dot(weight, v)) * points.dX(2)
    bcs, increments = mpm.fixed(low, "bottom"), [low.increment, u]
    problem = mpm.QuasiStatic(F, increments, points, bcs, stabilisation="ghost")

    def step(x):
        weight.value[1], place.value = -20.0, x
        (force,) = problem.step().bodies.values()
        return force["force"]

    return problem, step


@pytest.mark.long
def test_a_block_slides_at_mu_times_its_weight():
    problem, step = drawn()
    weight = 20.0 * 1.8 * 1.15
    sideways, normal = step(0.0)
    assert normal == pytest.approx(weight, rel=1e-9)
    assert abs(sideways) < 0.02 * weight
    (contact,) = problem.form.parts.terms
    # springs of 1e3 N/m³ draw with less than what friction holds
    points = problem.points
    own = points["tag"] == 2
    first = points["x"][own, 0].mean()
    sideways, _ = step(0.004)
    assert 0.1 * weight < -sideways < 0.2 * weight
    # it moves as both blocks shear, and hardly slips anywhere
    assert contact.dissipated < 1e-6
    assert points["x"][own, 0].mean() - first < 0.002
    for k in range(8):
        before, done = points["x"][own, 0].mean(), contact.dissipated
        sideways, normal = step(0.02 + 0.03 * k)
        assert sideways == pytest.approx(-0.3 * weight, rel=0.01) or k == 0
        if k > 1:
            slip = points["x"][own, 0].mean() - before
            assert contact.dissipated - done == pytest.approx(0.3 * weight * slip, rel=0.01)
    assert max(record.iterations for record in problem.history) <= 8


@pytest.mark.long
def test_two_rods_collide():
    """Each stops the other as a rigid wall would: ρ c v for 2L/c, and then all the speed back."""
    speed, wave = 0.1, 10.0
    h, apart, width = 1 / 40, 0.3 / 40, 2 / 40
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(-1.3, 0), (1.3, width)], (104, 2), mesh.CellType.quadrilateral
    )
    ends = 0.13 * h + np.array([-0.5, 0.5]) * apart
    rods = [
        mpm.fill(grid, mpm.Box((min(x, x + way), 0), (max(x, x + way), width)), 2, 1.0, tag=k,
                 aligned="body")
        for k, x, way in ((1, ends[0], -1.0), (2, ends[1], 1.0))
    ]  # fmt: skip
    points = rods[0] + rods[1]
    spaces = [mpm.Space(grid, "gimp", tag=k) for k in (1, 2)]
    u, v = [V.increment for V in spaces], [V.test for V in spaces]
    law = mpm.materials.Hencky(E=wave**2, nu=0.0)
    F = sum(mpm.momentum(law, points, u[k], v[k]) for k in (0, 1))
    faces = [[(ends[0], 0), (ends[0], width)], [(ends[1], width), (ends[1], 0)]]
    F += mpm.contact_between(
        [mpm.Boundary.from_polygon(points, face, closed=False, rule=1) for face in faces], u, v
    )
    bcs = [condition for V in spaces for condition in mpm.rollers(V, "bottom", "top")]
    points.add_field("velocity", (2,), "m/s")
    first = points["tag"] == 1
    points["velocity"] = np.where(first[:, None], 1.0, -1.0) * [speed, 0.0]
    problem = mpm.Newmark(F, u, points, bcs, mapping="flip", stabilisation="ghost")
    (contact,) = problem.form.parts.terms
    touch, dt = 0.5 * apart / speed, 0.5 * h / wave
    problem.step(touch - 2 * dt)
    rows = []
    while problem.time < touch + 0.21:
        record = problem.step(problem.time + dt)
        force = record.bodies[contact.name]["force"]
        rows.append((problem.time - touch, -force[0] / width))
    t, p = np.array(rows).T
    pressed = t[p > 1e-6]
    assert pressed.min() == pytest.approx(0.0, abs=1.5 * dt)
    assert pressed.max() == pytest.approx(2.0 / wave, abs=3 * dt)
    assert p[(t > 0.05) & (t < 0.15)].mean() == pytest.approx(wave * speed, rel=0.02)
    assert points["velocity"][first, 0].mean() == pytest.approx(-speed, rel=0.02)
    np.testing.assert_allclose(problem.momentum(), 0.0, atol=1e-13 * width * speed)
