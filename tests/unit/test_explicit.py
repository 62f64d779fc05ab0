"""Explicit steps: critical steps, faces of the grid, filters of light nodes, errors, restarts."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform import errors
from dolfinmpm.dynamics import explicitcall

OFFSETS = (1e-6, 1e-4, 1e-3, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9, 0.999, 1 - 1e-6)


def bar(
    length=20.0, cells=80, basis="gimp", E=100.0, density=1.0, kind=mpm.Explicit, bcs=None, **o
):
    """A bar along its grid, with c = 10 m/s; `bcs` is a function of its space."""
    grid = mesh.create_interval(COMM, cells, [0, length])
    points = mpm.fill(grid, mpm.Box((0,), (length,)), 2, density)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=0.0), points, u, v)
    points.add_field("velocity", (1,), "m/s")
    return kind(F, u, points, bcs(V) if bcs else (), **o)


def disc(basis="gimp", law=None, **options):
    """A disc that turns, stretches and falls onto the bottom of its grid."""
    grid = mesh.create_rectangle(COMM, [(-1, -1), (1, 1)], (20, 20), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Disc((0.013, -0.021), 0.55), 2, 1000.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, -1.0))
    law = law or mpm.materials.Hencky(E=1e5, nu=0.3)
    F = mpm.momentum(law, points, u, v) - ufl.inner(points.density * g, v) * points.dX
    x = points["x"]
    velocity = np.stack([-x[:, 1] + 0.3 * x[:, 0], x[:, 0] + 0.2 * x[:, 1] ** 2], axis=1)
    points.add_field("velocity", (2,), "m/s")
    points["velocity"] = 0.5 * velocity
    return mpm.Explicit(F, u, points, mpm.fixed(V, "bottom"), **options)


@pytest.mark.parametrize(
    ("basis", "per_cell", "expected"),
    [("gimp", 2, 0.803), ("gimp", 3, 0.731), ("gimp", 4, 0.664)],
)
def test_lumped_critical_step_of_the_worst_cut(basis, per_cell, expected):
    """The eigenproblem at fourteen places in the grid; the estimate stays below it."""
    steps, guessed = [], []
    for offset in OFFSETS:
        grid = mesh.create_interval(COMM, 12, [0, 12])
        body = mpm.Box((3 + offset,), (7 + offset,))
        points = mpm.fill(grid, body, per_cell, 1.0, aligned="body")
        V = mpm.Space(grid, basis)
        F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
        problem = mpm.Explicit(F, V.increment, points)
        steps.append(problem.critical_step(exact=True))
        guessed.append(problem.critical_step())
    assert min(steps) == pytest.approx(expected, rel=0.01)
    assert max(guessed) < min(steps)


def test_consistent_mass_with_ghost_penalty_keeps_the_step_at_small_cuts():
    steps = []
    for offset in OFFSETS:
        grid = mesh.create_interval(COMM, 12, [0, 12])
        points = mpm.fill(grid, mpm.Box((3 + offset,), (7 + offset,)), 2, 1.0, aligned="body")
        V = mpm.Space(grid, "gimp")
        F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
        problem = mpm.Explicit(F, V.increment, points, mass="consistent")
        steps.append(problem.critical_step(exact=True))
    assert min(steps) == pytest.approx(0.575, rel=0.01)


@pytest.mark.parametrize("basis", ["linear", "gimp"])
def test_the_step_with_a_consistent_mass_is_stable_in_blocks(basis):
    """Blocks that fill the grid, or end at its bottom and are cut elsewhere."""
    for low, high in (((0, 0), (4, 4)), ((0, 0), (1, 1)), ((0.4, 0), (6.4, 4.4))):
        n = math.ceil(high[0])
        grid = mpm.create_lattice(COMM, [np.arange(n + 1.0)] * 2)
        points = mpm.fill(grid, mpm.Box(low, high), 2, 1.0)
        V = mpm.Space(grid, basis)
        for nu in (0.0, 0.3, 0.45):
            law = mpm.materials.Hencky(E=(1 + nu) * (1 - 2 * nu) / (1 - nu), nu=nu)
            F = mpm.momentum(law, points, V.increment, V.test)
            problem = mpm.Explicit(F, V.increment, points, mass="consistent")
            exact = problem.critical_step(exact=True)
            assert 0.5 * exact < problem.courant * problem.critical_step() < exact


TIED = [
    (basis, averaged, mass)
    for basis, averaged in (("gimp", True), *((f"bspline{q}", a) for q in (2, 3) for a in (1, 0)))
    for mass in ("consistent", "lumped")
]


@pytest.mark.parametrize(("basis", "averaged", "mass"), TIED)
def test_the_estimate_behind_ties_is_below_the_step_of_any_cut(basis, averaged, mass):
    """Bars, and discs, of which each place and size cuts the grid otherwise."""
    bars = [(4 + a, 4 + a + length) for a in OFFSETS for length in (4.0, 3.65, 5.3)]
    discs = [((5.2, 5.07), 2.79), ((5.39, 5.07), 2.785), ((5.26, 5.48), 2.587), ((5.2, 5.36), 2.07)]
    bodies = [*((1, mpm.Box((a,), (b,))) for a, b in bars), *((2, mpm.Disc(*a)) for a in discs)]
    steps = {1: [], 2: []}
    for d, body in bodies:
        if d == 1:
            grid = mesh.create_interval(COMM, 14, [0, 14])
        else:
            quadrilateral = mesh.CellType.quadrilateral
            grid = mesh.create_rectangle(COMM, [(0, 0), (11, 11)], (11, 11), quadrilateral)
        points = mpm.fill(grid, body, 2, 1.0, **({"aligned": "body"} if d == 1 else {}))
        V = mpm.Space(grid, basis, averaged=bool(averaged))
        nu = 0.45 if mass == "lumped" and d == 2 else 0.0
        law = mpm.materials.Hencky(E=(1 + nu) * (1 - 2 * nu) / (1 - nu), nu=nu)
        F = mpm.momentum(law, points, V.increment, V.test)
        problem = mpm.Explicit(F, V.increment, points, stabilisation="aggregation", mass=mass)
        steps[d].append(problem.critical_step(exact=True))
        assert problem.critical_step() < steps[d][-1]
    # nor is it so far below that steps are wasted
    assert problem.critical_step() > 0.5 * min(steps[1] + steps[2])


def test_velocities_are_of_steps_in_time():
    with pytest.raises(errors.ParameterError, match="prescribes a velocity, and QuasiStatic"):
        bar(kind=mpm.QuasiStatic, bcs=lambda V: mpm.moving(V, "left", 0, velocity=1.0))


@pytest.mark.parametrize("fused", [True, False])
def test_an_unstable_run_ends_with_a_named_error_and_a_whole_state(fused, monkeypatch):
    problem = disc(fused=fused, scheme="usl")
    points = problem.points
    problem.step(0.02)
    order = np.argsort(points["id"])
    before = {name: values[order].copy() for name, values in points.fields.items()}
    work = problem.energies().external
    monkeypatch.setattr(explicitcall, "checked_courant", float)
    problem.courant = 6.0
    with pytest.raises(errors.InstabilityError, match=r"The step is .* s, the critical one .* s;"):
        problem.step(3.0)
    # it ended before its hundredth step
    assert problem.time == 0.02
    assert problem.energies().external == work
    order = np.argsort(points["id"])
    for name, values in before.items():
        np.testing.assert_array_equal(points[name][order], values, err_msg=name)
    # and goes on from there as if nothing had been
    problem.courant, other = 0.8, disc(fused=fused, scheme="usl")
    for t in (0.02, 0.04):
        other.step(t)
    problem.step(0.04)
    one, two = (p.points["x"][np.argsort(p.points["id"])] for p in (problem, other))
    np.testing.assert_allclose(one, two, rtol=0, atol=1e-13)
    assert problem.energies().external == pytest.approx(other.energies().external, rel=1e-12)


@pytest.mark.parametrize("fused", [True, False])
def test_a_run_that_is_unstable_late_goes_back_a_hundred_steps_at_most(fused):
    """A squeeze sets in after 130 steps; the state is the one after a hundred."""
    dt = 0.4 * 0.25 / np.sqrt(1e5 * 0.7 / 0.52 / 1e3)

    def build():
        grid = mesh.create_rectangle(COMM, [(-1, -1), (1, 1)], (8, 8), mesh.CellType.quadrilateral)
        points = mpm.fill(grid, mpm.Box((-0.5, -0.5), (0.5, 0.5)), 2, 1000.0)
        V = mpm.Space(grid, "linear")
        law, t = mpm.materials.Hencky(E=1e5, nu=0.3), fem.Constant(grid, 0.0)
        a = ufl.conditional(ufl.gt(t, 130 * dt), 1e8, 1.0)
        F = mpm.momentum(law, points, V.increment, V.test)
        F += ufl.inner(points.density * a * points.x0, V.test) * points.dX
        options = {"time": t, "fused": fused, "scheme": "usl", "courant": 0.4 * np.sqrt(2)}
        return mpm.Explicit(F, V.increment, points, **options)

    problem, other = build(), build()
    assert (problem.unfused == "") == fused
    with pytest.raises(errors.InstabilityError, match=r"The state is that at t = 0\.\d+ s"):
        problem.step(1e3 * dt)
    assert 99 * dt < problem.time < 130 * dt
    points = problem.points
    assert all(np.isfinite(values).all() for values in points.fields.values())
    other.step(problem.time)
    order = [np.argsort(p.points["id"]) for p in (problem, other)]
    one, two = ((p.points["x"] - p.points["x0"])[o] for p, o in zip((problem, other), order))
    np.testing.assert_allclose(one, two, rtol=0, atol=1e-2 * np.abs(two).max())
    assert problem.energies().external == pytest.approx(other.energies().external, rel=1e-2)


def test_aggregation_keeps_the_energy_of_a_block_in_flight():
    """Half the critical step; the energy swings with the step, and comes from nowhere else."""
    E, nu, density, wide = 1e4, 0.3, 1e3, 6
    c = np.sqrt(E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / density)
    grid = mesh.create_rectangle(COMM, [(0, 0), (18, 18)], (18, 18), mesh.CellType.quadrilateral)
    low = np.full(2, 2.0 + 1e-3)
    points = mpm.fill(grid, mpm.Box(low, low + wide), 3, density, aligned="body")
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=nu), points, V.increment, V.test)
    problem = mpm.Explicit(F, V.increment, points, stabilisation="aggregation", courant=np.inf)
    flight = 0.3 * c * np.array([1.0, 0.7])
    X = (points["x"] - points["x"].mean(axis=0)) / wide
    points["velocity"] = flight + 0.01 * c * np.sin(np.pi * X)
    drift = 0.5 * density * wide**2 * flight @ flight
    first = problem.energies().kinetic - drift
    for t in 6 / flight[0] * np.arange(1, 42) / 41:
        problem.step(t)
        e = problem.energies()
        assert 0.8 < (e.kinetic - drift + e.strain + e.dissipated) / first < 1.25


def test_a_node_that_points_see_with_no_weight_is_not_accelerated():
    """A point on a grid line sees the far node of its cell with a slope and no weight."""
    found = []
    for fused in (True, False):
        grid = mesh.create_rectangle(COMM, [(0, 0), (8, 8)], (8, 8), mesh.CellType.quadrilateral)
        points = mpm.fill(grid, mpm.Box((2, 2), (5, 5)), 1, 1.0)
        points["x"] = points["x"] + 0.5
        points.locate()
        V = mpm.Space(grid, "linear")
        law = mpm.materials.Hencky(E=1.0, nu=0.3)
        mpm.set_stress(law, points, lambda x: np.tile(-1e-3 * np.eye(3), (x.shape[1], 1, 1)))
        F = mpm.momentum(law, points, V.increment, V.test)
        problem = mpm.Explicit(F, V.increment, points, fused=fused, courant=0.01, scheme="usl")
        assert (problem.unfused == "") == fused
        problem.step(next(mpm.times(5e-3)))
        order = np.argsort(points["id"])
        found.append([points[name][order] for name in ("x", "F", "velocity")])
    for one, other in zip(*found):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-15)
    # by the forces at nodes with mass alone
    dt = problem.time
    assert 0 < np.abs(found[0][1] - np.eye(2)).max() < 2e-3 * dt**2


def test_a_body_under_stress_is_not_taken_for_an_unstable_one():
    """What "musl" counts as strain and as motion of loads differ by a share of a large stress."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 6)], (4, 6), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 5)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.3), points, u, v)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 5.0), (0, 1))
    pressure = fem.Constant(grid, (0.0, 0.0))
    F += top.traction(pressure, v)
    bcs = mpm.rollers(V, "left", "right", "bottom")
    static = mpm.QuasiStatic(F, u, points, bcs, stabilisation="aggregation")
    for part in mpm.steps(10):
        pressure.value[1] = -2e5 * part
        static.step()
    problem = mpm.Explicit(F, u, points, bcs)
    stored = problem.energies().strain
    pressure.value[1] *= 1.0001
    for t in mpm.times(0.3, dt=0.01):
        problem.step(t)
    assert stored > 2e5
    assert problem.energies().strain == pytest.approx(stored, rel=0.05)
    assert problem.energies().kinetic < 0.01 * stored


def test_mass_cut_off_stops_light_nodes_and_redistribution_keeps_their_forces():
    """Both bound the accelerations of nodes that a corner of a domain just reaches."""

    def largest(**options):
        grid = mesh.create_interval(COMM, 8, [0, 8])
        points = mpm.fill(grid, mpm.Box((2 - 1e-5,), (4 - 1e-5,)), 2, 1.0, aligned="body")
        V = mpm.Space(grid, "linear")
        u, v = V.increment, V.test
        F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, u, v)
        points.add_field("velocity", (1,), "m/s", lambda x: 0.1 * np.sin(x).T)
        problem = mpm.Explicit(F, u, points, fused=False, **options)
        for _ in range(20):
            problem.step(problem.time + 0.05)
        return np.abs(points["acceleration"]).max(), problem.momentum()[0]

    plain, first = largest()
    redistributed, momentum = largest(redistribution=0.1)
    assert momentum == pytest.approx(first, abs=1e-12)
    cut, _ = largest(mass_cutoff=1e-3)
    assert max(redistributed, cut) <= plain * 1.001


def test_bulk_viscosity_takes_energy_from_a_shock_only():
    def lost(viscosity):
        problem = bar(bcs=lambda V: mpm.fixed(V, "left"), bulk_viscosity=viscosity)
        problem.points["velocity"][:, 0] = -0.5
        first = problem.energies().kinetic
        problem.step(1.0)
        energies = problem.energies()
        return 1 - (energies.kinetic + energies.strain) / first

    assert lost((0.0, 0.0)) < lost((0.06, 1.2)) < 0.1


def test_automatic_steps_end_at_the_end():
    problem = disc()
    times = []
    for t in mpm.times(0.02):
        problem.step(t)
        times.append(problem.time)
    assert times[-1] == 0.02
    assert np.all(np.diff(times) <= problem.courant * problem.critical_step() * 1.05)


@pytest.mark.parametrize("fused", [True, False])
def test_a_run_goes_on_from_its_file(tmp_path, fused):
    whole, halved = disc(fused=fused), disc(fused=fused)
    for problem in (whole, halved):
        for t in (0.02, 0.04):
            problem.step(t)
    halved.save(tmp_path / "half.npz")
    again = disc(fused=fused)
    again.load(tmp_path / "half.npz")
    for problem in (whole, again):
        problem.step(0.06)
    assert again.time == whole.time == 0.06
    order = [np.argsort(problem.points["id"]) for problem in (whole, again)]
    for name in ("x", "velocity", "F", "stress"):
        a, b = (p.points[name][o] for p, o in zip((whole, again), order))
        assert np.abs(a - b).max() <= 1e-12 * np.abs(a).max(), name


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scheme": "euler"}, "scheme"),
        ({"mapping": "accel"}, "of implicit steps"),
        ({"courant": -1.0}, "courant"),
        ({"courant": 2.0}, "courant = 2 is a share of the critical step and must be at most 1"),
        ({"courant": "1"}, "courant = '1' must be a number"),
        ({"damping": 2.0}, "damping"),
        ({"mass": "diagonal"}, "mass"),
        ({"ghost_mass": 0.25}, "lumping takes away"),
        ({"bulk_viscosity": 0.1}, "bulk_viscosity"),
        ({"mass_cutoff": -1e-3}, "mass_cutoff"),
    ],
)
def test_bad_arguments(options, message):
    with pytest.raises(errors.ParameterError, match=message):
        bar(**options)


def test_a_mass_cut_off_that_may_stop_a_body_is_told():
    told = r"mass_cutoff = 0\.1 is above 0\.01: .*redistribution=0\.1"
    with pytest.warns(errors.LostMomentumWarning, match=told):
        bar(mass_cutoff=0.1)


def test_time_goes_forward():
    problem = bar()
    problem.step(0.1)
    with pytest.raises(errors.ParameterError, match="later than the time of the state"):
        problem.step(0.1)


@pytest.mark.parametrize("what", ["pressure", "energy"])
def test_strain_before_forces_keeps_all_internal_forces(what):
    """Those of a pressure that follows its surface, and of an energy in UFL: as without."""
    found = []
    for scheme in ("usl", "usf"):
        grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (8, 8), mesh.CellType.quadrilateral)
        points = mpm.fill(grid, mpm.Box((0.5, 0), (1.5, 1)), 2, 1000.0)
        V = mpm.Space(grid, "gimp")
        u, v = V.increment, V.test
        points.add_field("velocity", (2,), "m/s")
        if what == "pressure":
            top = mpm.Surface(points, lambda x: np.isclose(x[1], 1.0), (0, 1))
            F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.3), points, u, v)
            F += top.pressure(fem.Constant(grid, 1e3), u, v)
        else:
            points["velocity"][:, 1] = -points["x"][:, 1]
            Fdef = (ufl.Identity(2) + ufl.grad(u)) * points.F
            psi = 5e4 * (ufl.tr(Fdef.T * Fdef) - 2 - 2 * ufl.ln(ufl.det(Fdef)))
            F = ufl.derivative(psi * points.dX, u, v)
        # the speed of waves in an energy is not known
        courant = 0.1 if what == "pressure" else 0.0125
        bcs = mpm.rollers(V, "bottom")
        problem = mpm.Explicit(F, u, points, bcs, scheme=scheme, courant=courant)
        problem.step(0.02)
        found.append(problem.momentum()[1])
    assert abs(found[0]) > 1.0
    assert found[1] == pytest.approx(found[0], rel=0.03)
