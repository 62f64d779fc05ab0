"""Soil and water in time with inertia: tangents, refusals, restarts."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from test_poromechanics import LAW, block, check_tangent, held

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError


@pytest.mark.long
def test_the_tangent_has_the_acceleration_in_darcys_law():
    F, points, V, Q, _ = block(inertia=True, gravity=(1.0, -9.81))
    fields = [V.increment, Q.increment]
    problem = mpm.Newmark(F, fields, points, held(V), stabilisation=["ghost", "ghost"])
    points["velocity"] = 0.1 * points["x"]
    problem.step(0.7)
    assert points.inertia.value == pytest.approx(4 / 0.7**2)
    assert np.abs(points["start_acceleration"]).max() > 0.1
    check_tangent(problem)


@pytest.mark.parametrize("kind", [mpm.QuasiStatic, mpm.Transient])
def test_without_inertial_forces_there_is_no_acceleration(kind):
    F, points, V, Q, _ = block(inertia=True)
    with pytest.raises(FormError, match=rf"the acceleration of the body, and {kind.__name__} has"):
        kind(F, [V.increment, Q.increment], points, held(V))


def test_what_is_no_acceleration_is_refused():
    with pytest.raises(ParameterError, match="inertia = 1 must be True or False"):
        block(inertia=1)
    F, points, V, Q, _ = block()
    with pytest.raises(ParameterError, match="displacement"):
        mpm.acceleration(points, Q.increment)
    F = mpm.momentum(mpm.materials.Hencky(E=1e4, nu=0.3), points, V.increment, V.test)
    F += ufl.dot(mpm.acceleration(points, V.increment), V.test) * points.dX
    with pytest.raises(FormError, match="acceleration of the body, and Explicit has"):
        mpm.Explicit(F, V.increment, points, held(V))
    # n0/K_w = 0.4/4e3 by M = 1.35e4 is 1.35, and ρ/ρ_w - 1 is 1
    light = mpm.Fluid(bulk_modulus=4e3)
    with pytest.raises(ParameterError, match=r"is 2000 kg/m³ .* must be above 2346\.15, ρ_w"):
        block(inertia=True, fluid=light)
    block(fluid=light)
    with pytest.raises(ParameterError, match=r"is 900 kg/m³ .* must be above 1000"):
        block(inertia=True, density=900.0)


def time_stepping(rho_inf=None, **options):
    """A block that drains and falls onto its base, in time; its problem."""
    options = {"gravity": (0.0, -9.81), "inertia": True, "rho_inf": rho_inf, **options}
    F, points, V, Q, _ = block(fluid=mpm.Fluid(bulk_modulus=1e6), **options)
    rule = mpm.Newmark if rho_inf is None else mpm.GeneralisedAlpha
    of_rule = {} if rho_inf is None else {"rho_inf": rho_inf}
    stabilisations = ["ghost", "ghost"]
    fields = [V.increment, Q.increment]
    return rule(F, fields, points, held(V), stabilisation=stabilisations, **of_rule)


@pytest.mark.long
@pytest.mark.parametrize("rho_inf", [0.8, None])
def test_a_run_goes_on_from_a_file(rho_inf, tmp_path):
    whole, stopped, later = (time_stepping(rho_inf) for _ in range(3))
    times = (0.01, 0.03, 0.04, 0.06)
    for t in times:
        whole.step(t)
    for t in times[:2]:
        stopped.step(t)
    stopped.save(tmp_path / "soil.npz")
    later.load(tmp_path / "soil.npz")
    for t in times[2:]:
        later.step(t)
    names = {"x", "velocity", "pressure", "density", "porosity", "stress"}
    if rho_inf is not None:
        assert {"storage_rate", "gradient_rate"} <= set(whole.points.fields)
        assert np.abs(whole.points["storage_rate"]).max() > 0
    for field in names | (set(whole.points.fields) & {"storage_rate", "gradient_rate"}):
        np.testing.assert_array_equal(later.points[field], whole.points[field])


@pytest.mark.parametrize("rho_inf", [0.5, pytest.param(None, marks=pytest.mark.long)])
def test_soil_that_its_water_holds_stays_at_rest(rho_inf):
    """A pressure of 50 Pa under no load, by grains in tension: the first acceleration has both."""
    problem = time_stepping(rho_inf, gravity=None, permeability=0.0, drained=False)
    points = problem.points
    points["pressure"] = 50.0
    mpm.set_stress(LAW, points, (50.0 * np.eye(3)).tolist())
    for t in (0.01, 0.02, 0.05):
        problem.step(t)
    assert np.abs(problem.motion.nodes[0].A).max() < 1e-9
    np.testing.assert_allclose(points["pressure"], 50.0, rtol=1e-9)
    np.testing.assert_allclose(points["x"], points["x0"], atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("rho_inf", [None, 0.5, 1.0])
def test_what_a_step_cannot_resolve_is_damped(rho_inf):
    """A wave of a few cells in steps of a hundred radians loses 1 − ρ∞ a step; a twofold root of
    the rule takes it n/(n − 1) times longer at first."""
    problem = time_stepping(rho_inf, gravity=None, permeability=1e-9, drained=False)
    points, speed = problem.points, []
    points["velocity"][:, 1] = 1e-4 * np.sin(4 * np.pi * points["x"][:, 1] / 0.7)
    for k in range(7):
        problem.step(2.0 * (k + 1))
        # a node that is tied in one step and not in the next has no speed of its own
        speed.append(np.sqrt(problem.energies().kinetic))
    share = 1.0 if rho_inf is None else rho_inf
    assert 0.97 * share < speed[-1] / speed[-2] < 1.17 * share


@pytest.mark.long
def test_volumes_of_water_balance_at_the_level():
    """What leaves is what the mixture loses, and what the pores do."""
    problem = time_stepping(0.6, permeability=1e-2)
    points = problem.points
    start = float(points["density"] @ points["V0"])
    for t in (0.05, 0.1, 0.2):
        problem.step(t)
    J = np.linalg.det(points["F"])
    np.testing.assert_allclose(points["porosity"], 1 - 0.6 / J, atol=1e-12)
    lost = start - float(points["density"] @ points["V0"])
    assert lost == pytest.approx(1000.0 * float((1 - J) @ points["V0"]), rel=1e-9)
    assert lost > 0


def test_water_that_flows_is_no_load():
    """The flow at the start of a step is a source of the pressure's equation, and does no work."""
    problem = time_stepping(theta=0.5, gravity=None, permeability=1e-2, inertia=False)
    problem.points["velocity"][:, 1] = -0.1 * problem.points["x"][:, 1]
    first = problem.energies().kinetic
    for t in (0.01, 0.02, 0.03):
        problem.step(t)
    assert abs(problem.energies().external) < 1e-9 * first


@pytest.mark.parametrize("rho_inf", [0.8, 1.0])
def test_a_pressure_at_a_side_goes_evenly_over_each_step(rho_inf):
    """At the level of the step it has gone a share of its way, and back to zero, too."""
    found = []
    for rho in (None, rho_inf):
        theta = {} if rho is not None else {"theta": 0.5}
        F, points, V, Q, _ = block(
            fluid=mpm.Fluid(bulk_modulus=1e6), drained=False, rho_inf=rho, permeability=0.1, **theta
        )
        p = fem.Constant(points.grid, 0.0)
        bcs = held(V) + mpm.prescribed(Q, "bottom", 0, value=p)
        rule = mpm.Newmark if rho is None else mpm.GeneralisedAlpha
        options = {} if rho is None else {"rho_inf": rho}
        fields = [V.increment, Q.increment]
        problem = rule(F, fields, points, bcs, stabilisation=["ghost"] * 2, **options)
        pressures = []
        for k in range(40):
            p.value = 0.0 if k == 39 else np.sin((k + 1) * np.pi / 40)
            problem.step(0.02 * (k + 1))
            pressures.append(points["pressure"].mean())
        found.append(np.array(pressures))
    np.testing.assert_allclose(found[1], found[0], atol=0.02 * found[0].max())


def test_wet_soil_slides_on_a_plane_in_whole_steps():
    """Its weight is a load. Its work had counted as energy that steps make: all were halved."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(13) * 0.25, np.arange(7) * 0.25])
    points = mpm.fill(grid, mpm.Box((1.0, 0.0), (2.5, 0.75)), 2, 1900.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    mu, b = 0.1, (-4.9, -8.5)
    F = mpm.poromechanics(
        mpm.materials.Hencky(2e7, 0.3), points, (u, p), (v, q), permeability=1e-5, porosity=0.4,
        gravity=fem.Constant(grid, b),
    )  # fmt: skip
    plane = mpm.RigidBody(mpm.Plane((0, 0), (0, 1)), name="plane")
    F += mpm.contact(plane, points, u, v, friction=mu, penalty=20.0)
    problem = mpm.Newmark(F, [u, p], points, stabilisation=["ghost"] * 2, tolerance=1e-6)
    for t in mpm.times(0.3, dt=0.01):
        problem.step(t)
    assert sum(record.parts for record in problem.history) == 30
    moved = grid.comm.allreduce((points["x"] - points["x0"])[:, 0].sum()) / points.total
    assert moved == pytest.approx(0.045 * (b[0] - mu * b[1]), rel=0.01)
    weight = 1900.0 * 1.5 * 0.75
    e = problem.energies()
    assert e.external == pytest.approx(weight * moved * b[0], rel=0.01)
    assert abs(e["integrator"]) < 0.01 * e.external
