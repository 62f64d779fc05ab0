"""Increments that are lost in the rounding of positions end Newton's method."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


def column(E, basis="gimp", weight=1e5, **options):
    """A column of 4 m whose strain is weight / E, without lateral strain of its own."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(2), range(6)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), 2, 2000.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, -weight / 8000.0))
    F = mpm.momentum(mpm.materials.Hencky(E, 0.0), points, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    return mpm.QuasiStatic(F, u, points, bcs, **options)


@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2"])
@pytest.mark.parametrize(("E", "error"), [(1e11, 1e-9), (1e13, 1e-7), (1e16, 1e-4)])
def test_tiny_strains(E, error, basis):
    """Strains of 1e-6 to 1e-11: F = 1 + strain has 16 digits, strain has fewer."""
    problem = column(E, basis)
    problem.step()
    record = problem.history[-1]
    assert record.iterations <= 3
    assert record.halvings == 0
    points = problem.points
    stress = points["stress"][:, 1, 1]
    mean = points["V0"] @ stress / points["V0"].sum()
    # the mean of the stress under its own weight is half of the largest
    assert mean == pytest.approx(-0.5e5, rel=error)


def test_the_record_tells_what_is_out_of_balance():
    problem = column(1e16)
    problem.step()
    assert 1e-9 < problem.history[-1].residuals[-1] < 1e-2


def test_larger_increments_need_balance():
    """Increments far above rounding come to the tolerance, in several iterations."""
    problem = column(1e6)
    problem.step()
    assert problem.history[-1].residuals[-1] <= 1e-9
    assert problem.history[-1].iterations >= 3


@pytest.mark.parametrize("load", [1e4, 1.0, 1e-4])
def test_soil_with_water_under_a_tiny_load(load):
    """Strains of 1e-5 to 1e-13. Pressures are in balance to all digits."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(2), range(4)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 2.5)), 2, 1800.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    top = mpm.Surface(points, lambda x: x[1] > 2.4, (0, 1))
    clay, fluid = mpm.materials.Hencky(1e9, 0.3), mpm.Fluid(bulk_modulus=2.2e9)
    F = mpm.poromechanics(
        clay, points, (u, p), (v, q), permeability=1e-12, porosity=0.4, fluid=fluid
    )
    F += top.traction(fem.Constant(grid, (0.0, -load)), v)
    bcs = mpm.rollers(V, "left", "right", "bottom")
    problem = mpm.Transient(F, [u, p], points, bcs, stabilisation=["ghost", "ghost"])
    record = problem.step(1.0)
    assert record.iterations <= 3
    assert record.halvings == 0
    # soil and water share the load as their stiffnesses
    M, water = 1e9 * 0.7 / (1.3 * 0.4), 2.2e9 / 0.4
    assert points["pressure"] == pytest.approx(load * water / (M + water), rel=1e-3)


def test_ground_before_the_wave_arrives():
    """Velocities of 1e-13 m/s at the start of a smooth pulse take no more iterations than later."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(8), range(6)])
    points = mpm.fill(grid, mpm.Box((3, 0), (4, 5)), 2, 1800.0)
    V = mpm.Space(grid, "bspline2")
    F = mpm.momentum(mpm.materials.Hencky(1e8, 0.25), points, V.increment, V.test)
    t = np.linspace(0.0, 0.2, 201)
    wave = mpm.InputMotion(t, velocity=1e-3 * np.exp(-(((t - 0.1) / 0.02) ** 2)))
    rock = {"density": 2200.0, "p_speed": 1400.0, "s_speed": 800.0}
    bcs = mpm.absorbing(V, "bottom", **rock, incoming=(wave, None))
    tied = mpm.tied(V, period=1.0)
    problem = mpm.Newmark(
        F, V.increment, points, bcs, mass="consistent", prolongation=tied, ghost_mass=0.0
    )
    for time in np.arange(1, 101) * 2e-3:
        problem.step(float(time))
    assert max(record.iterations for record in problem.history) <= 3
    assert sum(record.halvings for record in problem.history) == 0


@pytest.mark.parametrize("tolerance", [1e-9, 1e-10, 1e-12])
def test_a_body_in_free_flight_is_balanced_to_rounding(tolerance):
    """No force acts, so that inertial forces are the rounding of their terms."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 5, 11)] * 2)
    V = mpm.Space(grid, "gimp")
    points = mpm.fill(grid, mpm.Box((3.5, 1.5), (4.5, 3.0)), 2, 1e3)
    body = mpm.RigidBody(mpm.Ball((1.0, 2.5), 0.45), mass=400.0, inertia=40.0, velocity=(0.2, 0.02))
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), points, V.increment, V.test)
    F += mpm.contact(body, points, V.increment, V.test)
    problem = mpm.GeneralisedAlpha(F, V.increment, points, tolerance=tolerance, rho_inf=0.8)
    for t in mpm.times(0.06, dt=0.01):
        problem.step(t)
    assert body.position == pytest.approx([1.012, 2.5012], rel=1e-12)


def test_a_rigid_body_beside_a_body_at_rest():
    """Forces of rounding end Newton's method as long as the rigid body does not touch.

    Functions of refined splines sum up to 1 to rounding, so that a body at rest has such forces
    with F-bar. They had been iterated hundreds of times.
    """
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(-2.0, 3.0), np.arange(0.0, 5.0)])

    def size(x):
        return np.maximum(0.25, 0.5 * abs(x[0] - 0.3))

    V = mpm.Space(grid, "bspline3", refine=size, levels=2)
    points = mpm.fill(grid, mpm.Box((-2, 0), (2, 2)), 2, 1800.0, refine=V)
    u, v = V.increment, V.test
    ball = mpm.RigidBody(mpm.Ball((0, 3.0), 0.7), velocity=(0, -1.8))
    F = mpm.momentum(mpm.materials.Hencky(2e6, 0.4), points, u, v, fbar=True)
    F += mpm.contact(ball, points, u, v)
    problem = mpm.Newmark(F, u, points, mpm.fixed(V, "bottom"), stabilisation="ghost")
    for t in (0.025, 0.05):
        problem.step(t)
        assert problem.history[-1].iterations < 50
    assert np.abs(points["x"] - points["x0"]).max() < 1e-14
