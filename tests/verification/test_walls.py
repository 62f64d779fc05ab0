"""Walls that push but do not pull, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh

import dolfinmpm as mpm


def pushed(basis="gimp", friction=0.3, nu=0.0, n=4):
    """A square block whose left face is moved, beside the right wall."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (2 * n, 2 * n),
                                 mesh.CellType.quadrilateral)  # fmt: skip
    points = mpm.fill(grid, mpm.Box((1, 0.5), (2, 1.5)), 2, 1.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=100.0, nu=nu)
    wall = mpm.Boundary.from_side(points, "right")
    face = mpm.Boundary.from_polygon(points, [(1.0, 1.5), (1.0, 0.5)], closed=False)
    way = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, u, v) + mpm.signorini(wall, u, v, law=law, friction=friction)
    F += mpm.dirichlet(face, u, v, way, law=law)
    problem = mpm.QuasiStatic(F, u, points, stabilisation="ghost")

    def to(x, y):
        way.value[:] = x, y
        record = problem.step()
        assert record.iterations <= 8
        assert record.parts == 1
        return wall.force()

    return to, points, face


@pytest.mark.parametrize("basis", ["linear", "gimp"])
def test_a_block_is_pressed_rubs_lifts_off_and_comes_back(basis):
    to, points, face = pushed(basis)
    to(0.01, 0.0)
    pressed = to(0.02, 0.0)
    # E ln λ / λ of a bar that is shortened by 2 %, less what the wall gives way
    assert pressed[0] == pytest.approx(100 * np.log(0.98) / 0.98, rel=0.01)
    assert abs(pressed[1]) < 1e-6
    sticks = to(0.02, 0.002)
    assert 0 > sticks[1] > 0.3 * sticks[0]
    np.testing.assert_allclose(face.force(), -sticks, atol=1e-7)
    slides = to(0.02, 0.04)
    assert slides[1] == pytest.approx(0.3 * slides[0], rel=0.02)
    back = to(0.02, -0.04)
    assert back[1] == pytest.approx(-0.3 * back[0], rel=0.02)
    to(-0.02, -0.04)
    np.testing.assert_array_equal(to(-0.1, -0.04), 0.0)
    assert points["x"][:, 0].max() < 1.9
    # the gap is remembered: contact begins again where it ended
    np.testing.assert_array_equal(to(-0.002, -0.04)[0] > -0.02, True)
    assert to(0.02, -0.04)[0] == pytest.approx(pressed[0], rel=0.01)


def test_a_smooth_wall_has_no_friction_and_a_rough_one_holds():
    forces = {}
    for friction in (0.0, 2.0):
        to, *_ = pushed(friction=friction)
        to(0.02, 0.0)
        forces[friction] = to(0.02, 0.01)
    assert abs(forces[0.0][1]) < 1e-8
    # sheared by 1 %, in bending and shear: stuck, the wall takes more than μ = 0.3 would
    assert -forces[2.0][1] > 0.25


def test_a_wall_takes_no_part_until_the_body_is_there():
    """A gap from the start is closed before anything pushes."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 1)], (8, 4), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0.5, 0.0), (1.375, 1.0)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=100.0, nu=0.0)
    wall = mpm.Boundary.from_side(points, "right")
    face = mpm.Boundary.from_polygon(points, [(0.5, 1.0), (0.5, 0.0)], closed=False)
    way = fem.Constant(grid, 0.0)
    F = mpm.momentum(law, points, u, v) + mpm.signorini(wall, u, v, law=law, friction=0.5)
    F += mpm.dirichlet(face, u, v, way, law=law, direction=(1, 0))
    bcs = mpm.rollers(V, "bottom", "top")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")
    # the block is 0.625 m from the wall
    for x, pressed in ((0.3, False), (0.6, False), (0.624, False), (0.635, True), (0.645, True)):
        way.value = x
        problem.step()
        stretch = 1 - (x - 0.625) / 0.875
        exact = 100 * np.log(stretch) / stretch if pressed else 0.0
        assert wall.force()[0] == pytest.approx(exact, rel=0.02, abs=1e-9)


@pytest.mark.parametrize("kind", ["lumped", "alpha"])
def test_a_rod_hits_a_wall(kind):
    """It stays there for 2L/c, under the stress ρ c v, and leaves as fast as it came."""
    L, E, rho, v0, n = 10.0, 1e4, 1.0, 1.0, 20
    c, h = np.sqrt(E / rho), 10.0 / n
    grid = mesh.create_rectangle(COMM, [(0, 0), (12, h)], (24, 1), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((1.5, 0), (11.5, h)), 2, rho)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=E, nu=0.0)
    wall = mpm.Boundary.from_side(points, "right")
    F = mpm.momentum(law, points, u, v) + mpm.signorini(wall, u, v, law=law)
    points.add_field("velocity", (2,), "m/s")
    points["velocity"] = [v0, 0.0]
    bcs = mpm.rollers(V, "bottom", "top")
    if kind == "lumped":
        problem = mpm.Newmark(F, u, points, bcs, mass="lumped")
    else:
        problem = mpm.GeneralisedAlpha(F, u, points, bcs, rho_inf=0.6)
    touch, dt, force = 0.5 / v0, h / c, []
    for t in mpm.times(touch + 2 * L / c + 4 * dt, dt=dt):
        problem.step(t)
        force.append((t, wall.force()[0] / h))
    found = np.array(force)
    on = found[found[:, 1] < -0.2 * rho * c * v0]
    assert on[0, 0] == pytest.approx(touch, abs=2 * dt)
    assert on[-1, 0] - on[0, 0] == pytest.approx(2 * L / c, abs=4 * dt)
    assert np.mean(on[2:-2, 1]) == pytest.approx(-rho * c * v0, rel=0.05)
    assert found[:, 1].sum() * dt == pytest.approx(-2 * rho * L * v0, rel=0.06)
    assert points["velocity"][:, 0].mean() == pytest.approx(-v0, rel=0.1)


def test_walls_in_space():
    """A column under its weight between four smooth walls: K0 = ν/(1 − ν) on each."""
    grid = mesh.create_box(COMM, [(0, 0, 0), (1, 1, 2)], (2, 2, 4), mesh.CellType.hexahedron)
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 1.5)), 2, 1.0)
    V = mpm.Space(grid, "linear")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=1e4, nu=0.25)
    walls = {s: mpm.Boundary.from_side(points, s) for s in ("left", "right", "front", "back")}
    F = mpm.momentum(law, points, u, v)
    F += ufl.inner(ufl.as_vector((0.0, 0.0, 10.0)), v) * points.dX
    for wall in walls.values():
        F += mpm.signorini(wall, u, v, law=law, friction=0.0)
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "bottom"), stabilisation="ghost")
    record = problem.step()
    assert record.iterations <= 8
    exact = 0.25 / 0.75 * 10.0 * 1.5**2 / 2
    for (side, wall), n in zip(walls.items(), [(1, 0), (-1, 0), (0, 1), (0, -1)]):
        np.testing.assert_allclose(wall.force()[:2], exact * np.array(n), rtol=0.06, atol=1e-6,
                                   err_msg=side)  # fmt: skip


@pytest.mark.parametrize("friction", [0.0, 0.3, 0.8])
def test_a_slab_on_an_incline(friction):
    """Gravity grows, then stays: it slides as the point mass does, or is stuck and stays so."""
    angle, g0, grows, until = np.radians(30.0), 9.81, 0.15, 0.3
    down = np.array([np.cos(angle), -np.sin(angle)])
    into = np.array([-np.sin(angle), -np.cos(angle)])
    grid = mesh.create_rectangle(COMM, [(0, 0), (2.4, 2.0)], (24, 20), mesh.CellType.quadrilateral)
    start = np.array([0.6, 1.5])
    a = np.arange(0.025, 0.5, 0.05)
    x = np.array([start + p * down - q * into for p in a for q in a[:3]])
    points = mpm.MaterialPoints.from_arrays(grid, x, 0.05**2, 1000.0, half_length=0.025)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=1e6, nu=0.2)
    ends = [start - 0.4 * down, start + 1.6 * down]
    slope = mpm.Boundary.from_polygon(points, ends, closed=False, follows=False, name="slope")
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, u, v) + mpm.signorini(slope, u, v, law=law, friction=friction)
    F -= ufl.inner(points.density * g, v) * points.dX
    problem = mpm.GeneralisedAlpha(F, u, points, rho_inf=0.5, stabilisation="ghost")
    ways = []
    for t in mpm.times(until, dt=0.01):
        g.value[1] = -g0 * min(t / grows, 1.0)
        problem.step(t)
        ways.append(np.mean((points["x"] - points["x0"]) @ down))
    weight = 1000.0 * g0 * 0.5 * 0.15
    assert slope.force() @ -into == pytest.approx(weight * np.cos(angle), rel=0.05)
    slides = np.sin(angle) - friction * np.cos(angle)
    rest = until - grows
    exact = g0 * max(slides, 0.0) * (grows**2 / 6 + grows / 2 * rest + rest**2 / 2)
    if slides > 0:
        assert ways[-1] == pytest.approx(exact, rel=0.01)
        friction_force = friction * weight * np.cos(angle)
        assert slope.force() @ -down == pytest.approx(friction_force, abs=0.05 * weight)
    else:
        # elastic slip alone, of which none accumulates
        assert 0 < ways[-1] < 5e-4
        assert abs(ways[-1] - ways[-6]) < 1e-4
    assert np.abs((points["x"] - points["x0"]) @ into).max() < 1e-3
