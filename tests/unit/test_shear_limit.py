"""Contact whose shear stress has a limit, as that of clay, besides Coulomb's friction."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from conftest import Linearised
from dolfinx import fem
from mpi4py import MPI
from onesided import around_kink, check_at_kink

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm.dynamics.kinks import AT_LIMIT, CORNERS

LIMIT = 12e3


def sheared(kind=mpm.QuasiStatic, friction=1.0, limit=LIMIT, basis="gimp", **motion):
    """A block on a fixed bottom; a plate presses it, and then slides along it."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(-1, 4.1, 0.5), np.arange(0, 1.6, 0.5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (3, 1)), 2, 1800.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    plate = mpm.RigidBody(mpm.Plane((0, 1), (0, -1)), name="plate", **motion)
    F = mpm.momentum(mpm.materials.Hencky(E=10e6, nu=0.0), points, u, v)
    F += mpm.contact(plate, points, u, v, friction=friction, shear_limit=limit, penalty=50.0)
    bcs = mpm.fixed(V, "bottom")
    return kind(F, u, points, bcs, stabilisation="ghost"), plate


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
@pytest.mark.parametrize(
    ("friction", "limit", "stress"),
    [(1.0, LIMIT, LIMIT), (1.0, 24e3, 24e3), (0.05, LIMIT, None), (0.05, None, None)],
)
def test_a_plate_that_slides(basis, friction, limit, stress):
    """The shear stress is the limit; where μ p is smaller it is that."""

    def way(t):
        return (0.05 * max(0.0, t - 1.0), -0.01 * min(t, 1.0))

    problem, plate = sheared(friction=friction, limit=limit, basis=basis, displacement=way)
    for _ in range(4):
        problem.step()
    along, normal = plate.force
    # the plate is longer than the top of the block, of some 3 m
    x, half = problem.points["x"], problem.points["l"]
    top = x[:, 1] > 0.75
    length = (x + half)[top, 0].max() - (x - half)[top, 0].min()
    assert length == pytest.approx(3.0, abs=0.01)
    expected = friction * abs(normal) if stress is None else length * stress
    # the corners share the top as it was a step before
    assert abs(along) == pytest.approx(expected, rel=1e-6 if stress is None else 1e-4)
    assert abs(normal) > 3.0 * 60e3


def test_the_tangent_is_the_derivative():
    problem, _ = sheared(increment=(0.002, -0.004))
    problem.step()
    exact, numerical = Linearised(problem).both(1e-5, 1e-8)
    np.testing.assert_allclose(exact, numerical, atol=1e-4 * np.abs(exact).max())


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.Explicit])
def test_a_block_that_slides_in_time(kind):
    """On a plane under its weight τ A slows it down, not μ N."""
    grid = mpm.create_lattice(
        MPI.COMM_WORLD, [np.arange(0, 4.1, 0.25), np.arange(-0.25, 1.1, 0.25)]
    )
    points = mpm.fill(grid, mpm.Box((0.5, 0), (1.5, 0.5)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=2e6, nu=0.0), points, u, v)
    F += 10.0 * points.density * v[1] * points.dX
    plane = mpm.RigidBody(mpm.Plane((0, 0), (0, 1)))
    F += mpm.contact(plane, points, u, v, friction=1.0, shear_limit=2e3, penalty=20.0)
    problem = kind(F, u, points)
    points["velocity"] = (2.0, 0.0)
    for t in mpm.times(0.4, dt=0.01):
        problem.step(t)
    # a = τ A/m = 2 m/s², and with μ = 1 it would be 10 m/s². As the block bounces μ N is less than
    # τ A at times: that takes up to 14 % of the force
    lost = 2.0 - points["velocity"][:, 0].mean()
    assert 0.9 * 2.0 * 0.4 < lost <= 2.0 * 0.4
    energies = problem.energies()
    assert energies.losses["friction"] == pytest.approx(2e3 * (2.0 * 0.4 - 0.16), rel=0.05)


def test_what_is_refused():
    with pytest.raises(mpm.errors.ParameterError, match="it bounds friction: give friction="):
        sheared(friction=0.0, increment=(0.0, -0.01))
    with pytest.raises(mpm.errors.ParameterError, match="shear_limit = -1"):
        sheared(limit=-1.0, increment=(0.0, -0.01))


def pushed(kind, limit):
    """A plate slides along a block and presses it."""

    def way(t):
        return (6.0 * t, -1.2 * t)

    return sheared(kind, 0.05, limit, displacement=way)


@pytest.mark.parametrize("side", [0, 1])
def test_derivatives_tell_where_the_limit_is_reached(side):
    """Corners slip at μ p on one side of a value of the limit, and at τ A on the other."""

    def scene(m):
        problem, plate = pushed(mpm.Transient, m["limit"])
        steps = [partial(problem.step, t) for t in (4e-3, 8e-3)]
        return study.Run(problem, steps, {"force": lambda: plate.force})

    def at_friction(limit):
        run = scene({"limit": limit})
        for step in run.steps:
            step()
        points = run.problem.points
        along = np.linalg.norm(points["contact1_tangential_force"], axis=2)
        slack = 0.05 * points["contact1_normal_force"] - along
        return np.count_nonzero(slack > 1e-14 * along.max())

    ends = around_kink(at_friction, (3e3, 8e3), 30)
    # forces of 3e5 N balance to 1e-9
    check_at_kink(scene, "limit", ends, side, AT_LIMIT, share=1e-3)


def test_explicit_steps_tell_where_the_limit_is_reached():
    for limit in (10.0, 1e6):
        problem, _ = pushed(mpm.Explicit, limit)
        watch = problem.watch_kinks()
        problem.step(2e-3)
        assert any(len(corners) for corners in watch.sets[CORNERS])
        assert any(len(corners) for corners in watch.sets[AT_LIMIT]) == (limit < 1e3)


@pytest.mark.parametrize("cells", [2, 4])
def test_a_pile_that_is_drawn_out_has_the_area_of_its_shaft(cells):
    """Its force was that on the radius of the points beside it: 12 and 6 % too large."""
    R, L, p, h = 0.5, 1.0, 200e3, 0.5 / cells
    lines = [np.arange(0.0, a + 0.5 * h, h) for a in (2.0, 1.5)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    ring = mpm.Box((R, 0), (2.0, L))
    points = mpm.fill(grid, ring, 2, 1800.0, axisymmetric=True)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    soil = mpm.materials.Hencky(E=20e6, nu=0.3)
    mpm.set_stress(soil, points, -p * np.eye(3))
    pile = mpm.RigidBody(mpm.Box((-R, -1.0), (R, L + 1.0)), increment=(0, 0.002))
    top = mpm.Surface(points, lambda x: np.isclose(x[1], L), (0, 1))
    F = mpm.momentum(soil, points, u, v)
    F += mpm.contact(pile, points, u, v, friction=1.0, shear_limit=LIMIT)
    F += top.traction(fem.Constant(grid, (0.0, -p)), v)
    bcs = mpm.fixed(V, "right") + mpm.rollers(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="aggregation", tolerance=1e-6)
    for _ in range(3):
        problem.step()
    assert -pile.force[1] == pytest.approx(LIMIT * 2 * np.pi * R * L, rel=0.01)
