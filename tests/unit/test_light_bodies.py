"""Free rigid bodies that are lighter than the soil of a cell, in explicit contact."""

import pytest
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

H, STIFF, PENALTY = 0.1, 1e6, 5.0


def block_and_disc(mass, basis="gimp", **motion):
    """A block with 20 kg/m per cell, and a disc just above it."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(-0.6, -H), (0.6, 0.6)], (12, 7), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((-0.4, 0.0), (0.4, 0.5)), per_cell=3, density=2000.0)
    V = mpm.Space(grid, basis)
    given = {"mass": mass, "inertia": 0.125 * mass, "free": (True,) * 3} if mass else {}
    shape = mpm.Disc((0.0, 1.0 + 1e-3), 0.5)
    disc = mpm.RigidBody(shape, velocity=(0.0, -1.0), angular_velocity=0.0, name="disc", **given)
    F = mpm.momentum(mpm.materials.Hencky(STIFF, 0.2), points, V.increment, V.test)
    F += mpm.contact(disc, points, V.increment, V.test, penalty=PENALTY)
    bcs = mpm.fixed(V, lambda x: x[1] < 1e-9)
    return mpm.Explicit(F, V.increment, points, bcs, **motion)


@pytest.mark.parametrize(
    ("mass", "motion"),
    [
        (40.0, {}), (13.0, {"basis": "bspline2"}), (5.0, {}), (5.0, {"fused": False}),
        (5.0, {"basis": "linear"}), (1.3, {"basis": "bspline2"}),
    ],
)  # fmt: skip
def test_an_impact_makes_no_energy(mass, motion):
    """Steps for the soil's mass alone made up to 18 %, or ended with an InstabilityError."""
    problem = block_and_disc(mass, **motion)
    first, largest = 0.5 * mass, 0.0
    for _ in range(400):
        problem.step(problem.time + 0.5 * problem.critical_step())
        now = problem.energies()
        largest = max(largest, now.kinetic + now.bodies + now.strain + now.contact)
        if problem.time > 0.1:
            break
    assert 0.99 * first < largest < 1.01 * first


def test_the_critical_step_is_that_of_both_masses():
    """1/Δt² grows by a quarter of κ A (1/M + r²/J) with A = 2 r = 1 m and J = M r²/2."""
    rate = {mass: block_and_disc(mass).critical_step() ** -2 for mass in (None, 5.0, 1e12)}
    assert rate[1e12] == pytest.approx(rate[None], rel=1e-6)
    added = 0.25 * PENALTY * STIFF / H * (1 + 2) / 5.0
    assert rate[5.0] - rate[None] == pytest.approx(added, rel=1e-3)


def test_a_scaled_mass_is_that_of_the_soil():
    """Steps grow by the root of the factor for the soil, and not for the rigid body."""
    rate = {
        (mass, factor): block_and_disc(mass, mass_scaling=factor).critical_step() ** -2
        for mass in (None, 5.0)
        for factor in (1.0, 100.0)
    }
    assert rate[None, 1.0] == pytest.approx(100.0 * rate[None, 100.0], rel=1e-9)
    body = [rate[5.0, factor] - rate[None, factor] for factor in (1.0, 100.0)]
    assert body[0] == pytest.approx(body[1], rel=1e-9)
