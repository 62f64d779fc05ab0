"""Ground at rest in one call: stress by K0, layers and water, in balance with the weight."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
import ufl
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError, DoubtfulInputWarning, ParameterError

G = 9.81


def hillside(surface):
    """Ground below a surface on 8 m, 1800 kg/m³, between rollers, and its problem."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 8, 17), np.linspace(0, 5, 11)])
    points = mpm.fill(grid, surface.ground(0.0), per_cell=2, density=1800.0, exact=True)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    soil = mpm.materials.MohrCoulomb(20e6, 0.3, cohesion=20e3, friction_angle=35.0)
    F = mpm.momentum(soil, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -G)), v) * points.dX
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    return points, mpm.QuasiStatic(F, u, points, bcs, stabilisation="aggregation")


def deposit(surface):
    layers = [mpm.Layer(2.0, 1800 * G, K0=0.5), mpm.Layer(0.0, 1800 * G, K0=0.7)]
    return mpm.Deposit(surface, layers)


def test_level_layers_are_in_balance_at_once():
    flat = mpm.Terrain(([0, 8],), [4.0, 4.0])
    points, problem = hillside(flat)
    assert mpm.start_at_rest(problem, deposit(flat)) == 0
    stress, y = points["stress"], points["x"][:, 1]
    vertical = -1800 * G * (4.0 - y)
    assert stress[:, 1, 1] == pytest.approx(vertical, rel=1e-9)
    K0 = np.where(y > 2.0, 0.5, 0.7)
    assert stress[:, 0, 0] == pytest.approx(K0 * vertical, rel=1e-6)
    assert np.array_equal(points["x"], points["x0"])


def test_a_hillside_is_in_balance_and_stays():
    hill = mpm.Terrain(([0, 3, 5, 8],), [4.0, 4.0, 2.5, 2.5])
    points, problem = hillside(hill)
    steps = mpm.start_at_rest(problem, deposit(hill))
    assert steps > 1
    assert np.array_equal(points["x"], points["x0"])
    # whole weight of the body on the bottom: the mean vertical stress of a level cut
    low = points["x"][:, 1] < 0.5
    carried = (points["stress"][:, 1, 1] * points["V"])[low].sum() / 0.5
    above = (points["V"] * (points["x"][:, 1] > 0.5)).sum() + 0.5 * points["V"][low].sum()
    assert carried == pytest.approx(-1800 * G * above, rel=2e-2)
    problem.step()
    moved = np.abs(points["x"] - points["x0"]).max()
    assert moved < 1e-9


def test_a_law_of_fill_that_comes_later():
    """The form may have a law for points that come later: they have no stress yet."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 4, 5), np.linspace(0, 4, 5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=1800.0, tag=1)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    soil, bank = mpm.materials.Hencky(20e6, 0.3), mpm.materials.Hencky(10e6, 0.3)
    F = mpm.momentum(soil, points, u, v, tag=1) + mpm.momentum(bank, points, u, v, tag=2)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -G)), v) * points.dX
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    problem = mpm.QuasiStatic(F, u, points, bcs)
    mpm.start_at_rest(problem, mpm.Deposit(2.0, mpm.Layer(0.0, 1800 * G, K0=0.5)))
    points.add(mpm.fill(grid, mpm.Box((0, 2), (4, 3)), per_cell=2, density=1800.0, tag=2))
    problem.step()
    vertical = points["stress"][points["tag"] == 1][:, 1, 1]
    assert vertical.mean() == pytest.approx(-1800 * G * 2.0, rel=1e-2)


def test_a_larger_tolerance_of_the_problem_is_no_obstacle():
    hill = mpm.Terrain(([0, 3, 5, 8],), [4.0, 4.0, 2.5, 2.5])
    stress = []
    for tolerance in (1e-9, 1e-5):
        points, problem = hillside(hill)
        problem.tolerance = tolerance
        mpm.start_at_rest(problem, deposit(hill))
        assert problem.tolerance == tolerance
        stress.append(points["stress"])
    np.testing.assert_allclose(stress[1], stress[0], atol=1e-3)


def test_two_laws_get_their_own_layers():
    flat = mpm.Terrain(([0, 8],), [4.0, 4.0])
    grid = mpm.create_lattice(COMM, [np.linspace(0, 8, 9), np.linspace(0, 5, 6)])
    points = mpm.fill(grid, mpm.Box((0, 2), (8, 4)), 2, 1800.0)
    points += mpm.fill(grid, mpm.Box((0, 0), (8, 2)), 2, 1800.0, tag=1)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(5e6, 0.2), points, u, v, tag=0)
    F += mpm.momentum(mpm.materials.Hencky(50e6, 0.3), points, u, v, tag=1)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -G)), v) * points.dX
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")
    assert mpm.start_at_rest(problem, deposit(flat)) == 0
    ratio = points["stress"][:, 0, 0] / points["stress"][:, 1, 1]
    assert ratio == pytest.approx(np.where(points["tag"] == 1, 0.7, 0.5), rel=1e-6)


def test_what_cannot_start_at_rest():
    flat = mpm.Terrain(([0, 8],), [4.0, 4.0])
    _, problem = hillside(flat)
    with pytest.raises(ParameterError, match=r"ground = 1.0 must be .*mpm.Deposit"):
        mpm.start_at_rest(problem, 1.0)
    with pytest.raises(ParameterError, match="QuasiStatic"):
        mpm.start_at_rest(None, deposit(flat))
    problem.step()
    with pytest.raises(
        ParameterError, match=r"deformed, by .*; start the ground before its first step"
    ):
        mpm.start_at_rest(problem, deposit(flat))


@pytest.mark.parametrize("saturated", [None, 2000 * G])
def test_the_loads_must_be_the_effective_weight(saturated):
    """The whole weight under a water table: K0 had been that of the buoyant weight, in silence."""
    flat = mpm.Terrain(([0, 8],), [4.0, 4.0])
    layer = mpm.Layer(0.0, 1800 * G, K0=0.5, saturated_unit_weight=saturated)
    ground = mpm.Deposit(flat, layer, water_table=3.0)
    points, problem = hillside(flat)
    with pytest.raises(ParameterError, match=r"-35316 Pa, .* effective: .*body_force"):
        mpm.start_at_rest(problem, ground)
    points, problem = hillside(flat)
    V = problem.form.spaces[0]
    soil = mpm.materials.Hencky(20e6, 0.3)
    F = mpm.momentum(soil, points, V.increment, V.test)
    F -= ufl.inner(ground.body_force(points), V.test) * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, problem.bcs)
    assert mpm.start_at_rest(problem, ground) == 0
    ratio = points["stress"][:, 0, 0] / points["stress"][:, 1, 1]
    assert ratio == pytest.approx(0.5, rel=1e-9)


@pytest.mark.parametrize("weight", [18.0, 18e6])
def test_the_weights_must_have_one_unit(weight):
    flat = mpm.Terrain(([0, 8],), [4.0, 4.0])
    points, problem = hillside(flat)
    V = problem.form.spaces[0]
    F = mpm.momentum(mpm.materials.Hencky(20e9, 0.3), points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -G)), V.test) * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, problem.bcs)
    far = pytest.warns(DoubtfulInputWarning) if weight < 1e3 else contextlib.nullcontext()
    with far, pytest.raises(ParameterError, match=r"-35316 Pa, .* unit weights in N/m³"):
        mpm.start_at_rest(problem, mpm.Deposit(flat, mpm.Layer(0.0, weight, K0=0.5)))


@pytest.mark.parametrize(("per_cell", "bound"), [(2, 0.06), (4, 0.017)])
def test_splines_change_the_stress_of_level_ground_by_what_the_sums_miss(per_cell, bound):
    """Sums over points are not exact at base and surface; the error falls with their number."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 2, 5), np.linspace(0, 5, 11)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 4)), per_cell, density=1800.0)
    V = mpm.Space(grid, "bspline2")
    soil = mpm.materials.CamClay(
        swelling=0.01, compression=0.1, M=1.2, mu0=2e6, alpha=0.0, reference_pressure=1e3,
        preconsolidation=100e3,
    )  # fmt: skip
    F = mpm.momentum(soil, points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -G)), V.test) * points.dX
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    mpm.start_at_rest(problem, mpm.Deposit(4.0, mpm.Layer(0.0, 1800 * G, K0=0.6)))
    off = points["stress"][:, 1, 1] + 1800 * G * (4.0 - points["x"][:, 1])
    assert np.abs(off).max() < bound * 1800 * G * 0.5
    assert abs(off.mean()) < 1e-9 * 1800 * G


def retained(**options):
    """Level ground of 2 m behind a rigid wall, and its problem."""
    grid = mpm.create_lattice(COMM, [np.linspace(-1, 3, 9), np.linspace(0, 3, 7)])
    points = mpm.fill(grid, mpm.Box((0, 0), (3, 2)), per_cell=2, density=1800.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    soil = mpm.materials.MohrCoulomb(20e6, 0.3, cohesion=5e3, friction_angle=35.0)
    wall = mpm.RigidBody(mpm.Plane((0, 0), (1, 0)), name="wall")
    F = mpm.momentum(soil, points, u, v) + mpm.contact(wall, points, u, v, **options)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -G)), v) * points.dX
    bcs = mpm.rollers(V, "bottom", "right")
    return points, wall, mpm.QuasiStatic(F, u, points, bcs, stabilisation="aggregation")


def test_ground_behind_a_rigid_wall_rests_with_a_bound_of_the_penetration():
    """The thrust at rest is K0 γ H²/2; a penalty alone keeps none, and the message says so."""
    ground = mpm.Deposit(2.0, mpm.Layer(0.0, 1800 * G, K0=0.5))
    points, wall, problem = retained(penetration=1e-7)
    mpm.start_at_rest(problem, ground)
    problem.step()
    assert np.abs(points["x"] - points["x0"]).max() < 1e-7
    assert -wall.force[0] == pytest.approx(0.25 * 1800 * G * 2.0**2, rel=1e-3)

    _, _, problem = retained()
    with pytest.raises(ConvergenceError, match=r"contact with 'wall' .* penetration=1e-6"):
        mpm.start_at_rest(problem, ground, most=4)
