"""The work of pressures that follow the faces of points is the work of a load."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

COMM, DENSITY, DRAUGHT = MPI.COMM_WORLD, 600.0, 0.3


def floating(kind, **options):
    """A block of 1 m by 0.5 m in water, with a first velocity; 60 steps of 20 ms."""
    grid = mpm.create_lattice(COMM, [np.arange(9) * 0.25 - 1.0, np.arange(13) * 0.125 - 0.75])
    points = mpm.fill(grid, mpm.Box((-0.5, -DRAUGHT), (0.5, 0.5 - DRAUGHT)), 2, DENSITY)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F -= ufl.inner(points.density * fem.Constant(grid, (0.0, -9.81)), v) * points.dX
    for axis, sign in ((1, -1), (0, -1), (0, 1)):
        at = (-0.5 if sign < 0 else 0.5) if axis == 0 else -DRAUGHT
        normal = sign * np.eye(2)[axis]
        face = mpm.Surface(points, lambda x, c=axis, at=at: np.isclose(x[c], at), normal)
        F += face.pressure(9810 * ufl.max_value(-face.position(u)[1], 0.0), u, v)
    problem = kind(F, u, points, **options)
    points["velocity"] = (0.0, -0.2)
    heights = []
    for t in mpm.times(1.2, dt=0.02):
        problem.step(t)
        heights.append(COMM.allreduce(points["x"][:, 1].sum()) / points.total)
    return np.array(heights), problem.energies()


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (mpm.Newmark, {}),
        (mpm.GeneralisedAlpha, {"rho_inf": 1.0}),
        (mpm.Explicit, {}),
        (mpm.Explicit, {"scheme": "usf"}),
    ],
)
def test_a_block_floats(kind, options):
    """It swings with √(ρ_w g/(ρ H)). Explicit steps had taken its energy for instability."""
    heights, e = floating(kind, **options)
    found = heights - (0.25 - DRAUGHT)
    k = np.flatnonzero(found[:-1] * found[1:] < 0)
    zeros = 0.02 * (k + 1 + found[k] / (found[k] - found[k + 1]))
    period = 2 * np.pi * np.sqrt(DENSITY * 0.5 / 9810)
    assert 2 * np.diff(zeros).mean() == pytest.approx(period, rel=0.02)
    assert abs(e["integrator"]) < 0.01 * e.initial


def test_a_pressed_block_on_a_plane_does_not_halve_steps():
    """The work of the pressure had counted as energy that steps make."""
    grid = mpm.create_lattice(COMM, [np.arange(5) * 0.25, np.arange(9) * 0.25 - 0.5])
    points = mpm.fill(grid, mpm.Box((0.0, 0.0), (1.0, 1.0)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    plane = mpm.RigidBody(mpm.Plane((0, 0), (0, 1)), name="plane")
    F = mpm.momentum(mpm.materials.Hencky(1e7, 0.3), points, u, v)
    F += mpm.contact(plane, points, u, v)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1.0), (0, 1))
    F += top.pressure(fem.Constant(grid, 1e4), u, v)
    problem = mpm.Newmark(F, u, points, mpm.rollers(V, "left", "right"))
    for t in mpm.times(0.2, dt=0.002):
        problem.step(t)
    assert max(record.parts for record in problem.history) == 1
    e = problem.energies()
    assert abs(e["integrator"]) < 0.01 * e.external


@pytest.mark.parametrize("on", ["surface", "boundary"])
def test_a_pressure_on_a_body_at_rest_is_no_instability_in_usf(on):
    """Work counts a step late in "usf", and there was no other energy yet."""
    grid = mpm.create_lattice(COMM, [np.arange(13) * 0.0625 + 0.75, [0.0, 0.0625, 0.125]])
    points = mpm.fill(grid, mpm.Box((1.0, 0.0), (1.25, 0.125)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(1e7, 0.0), points, u, v)
    if on == "surface":
        face = mpm.Surface(points, lambda x: np.isclose(x[0], 1.0), (-1, 0))
    else:
        face = mpm.Boundary.from_polygon(points, [(1.0, 0.125), (1.0, 0.0)], closed=False)
    F += face.pressure(fem.Constant(grid, 1e4), u, v)
    problem = mpm.Explicit(F, u, points, mpm.rollers(V, "bottom", "top"), scheme="usf")
    for t in mpm.times(0.01, dt=0.0005):
        problem.step(t)
    e = problem.energies()
    assert e.kinetic == pytest.approx(0.5 * (1e4 * 0.125 * 0.01) ** 2 / (1000 * 0.03125), rel=0.05)
    assert abs(e["integrator"]) < 0.02 * e.external
