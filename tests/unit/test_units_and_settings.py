"""Numbers in another unit, and settings that nothing reads, end in an error and not in numbers."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import ParameterError

COMM = MPI.COMM_WORLD
SOIL = mpm.materials.Hencky(190e6, 0.3)
ROCK = {"density": 2200.0, "p_speed": 1500.0, "s_speed": 800.0}
TIMES = np.linspace(0, 1, 101)
WAVE = mpm.InputMotion(TIMES, velocity=0.1 * np.sin(np.pi * TIMES) ** 2)


def shaken(tied=True, waves=True, **rock):
    """A column of ground on rock, through which a wave comes in."""
    grid = mpm.create_lattice(COMM, [np.arange(5.0), np.arange(8.0)])
    points = mpm.fill(grid, mpm.Box((1, 0), (2, 6)), 2, 1800.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    sides = mpm.absorbing(V, "bottom", **{**ROCK, **rock}, incoming=(WAVE, None) if waves else None)
    options = {"prolongation": mpm.tied(V, period=1.0)} if tied else {}
    return mpm.Newmark(F, V.increment, points, sides, ghost_mass=1e-3, **options)


def test_a_unit_weight_for_the_density_of_the_rock():
    with pytest.raises(
        ParameterError, match=r"less than a twentieth of the 1800 kg/m³ of the body"
    ):
        shaken(density=22.0)


@pytest.mark.parametrize(
    ("speeds", "told"),
    [
        ({"p_speed": 1.5, "s_speed": 0.8}, r"p_speed = 1\.5 m/s .* 'bottom' .* of the 377 m/s"),
        ({"s_speed": 0.8}, r"s_speed = 0\.8 m/s .*less than a twentieth of the 201\.5 m/s"),
    ],
)
def test_speeds_of_the_rock_in_kilometres_per_second(speeds, told):
    with pytest.raises(ParameterError, match=told):
        shaken(**speeds)
    # 1/16 of those of the body, and no dashpots along the side
    shaken(p_speed=24.0, s_speed=13.0)
    shaken(p_speed=24.0, s_speed=0.0, waves=False)


def test_a_column_of_ground_with_free_sides():
    mpm.GroundColumn(shaken(), 0.2, dt=0.02)
    with pytest.raises(ParameterError, match=r"tied sides, prolongation=mpm\.tied"):
        mpm.GroundColumn(shaken(tied=False), 0.2, dt=0.02)


@pytest.mark.parametrize("density", [9.81, 9.8, 9810.0])
def test_a_unit_weight_for_the_density_of_water(density):
    with pytest.raises(ParameterError, match="the number of water's unit weight"):
        mpm.Fluid(density)
    assert mpm.Fluid(density, gravity=1.0).unit_weight == density


def test_what_a_problem_sets_itself():
    grid = mpm.create_lattice(COMM, [np.arange(3.0), np.arange(4.0)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1800.0)
    V = mpm.Space(grid, "gimp")
    gravity = fem.Constant(grid, (0.0, -9.81))
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    F -= ufl.inner(points.density * gravity, V.test) * points.dX
    given = F, V.increment, points, mpm.fixed(V, "bottom")
    with pytest.raises(ParameterError, match="scheme = 'static' must be a Scheme"):
        mpm.QuasiStatic(*given, scheme="static")
    problem = mpm.QuasiStatic(*given, stabilisation="ghost")
    with pytest.raises(ParameterError, match=r"sets solver itself.*petsc_options="):
        problem.solver = "mumps"
    for name in ("bodies", "here", "essential_conditions"):
        with pytest.raises(ParameterError, match=f"sets {name} itself"):
            setattr(problem, name, None)
    problem.tolerance, problem.share = 1e-8, 0.5
    problem.step()
    assert problem.tolerance == 1e-8
    assert problem.history[-1].parts == 2


def test_what_nothing_reads():
    ground = mpm.Deposit(5.0, [mpm.Layer(0.0, 18e3, K0=0.5)], water_table=3.0)
    field = study.RandomField((0, 0), (9, 9), 3.0, mean=1e4, coefficient=0.3, modes=2)
    column = mpm.GroundColumn(shaken(), 0.04, dt=0.02)
    for thing in (ground, field, column, WAVE):
        with pytest.raises(ParameterError, match="watertable is no attribute of it"):
            thing.watertable = 4.0
    with pytest.raises(ParameterError, match=r"read once. Make a new GroundColumn"):
        column.time = TIMES
