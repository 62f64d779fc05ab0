"""Explicit steps at absorbing, frictional and driven sides."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh
from test_explicit import bar

import dolfinmpm as mpm
from dolfinmpm._platform import errors


@pytest.mark.parametrize(
    "kind",
    [
        mpm.Explicit,
        pytest.param(mpm.Newmark, marks=pytest.mark.long),
        pytest.param(mpm.GeneralisedAlpha, marks=pytest.mark.long),
    ],
)
def test_absorbing_faces_let_a_pulse_out(kind):
    def faces(V):
        return mpm.absorbing(V, "left", "right", density=1.0, p_speed=10.0)

    options = {} if kind is mpm.Explicit else {"stabilisation": "ghost"}
    problem = bar(kind=kind, bcs=faces, **options)
    x = problem.points["x"][:, 0]
    problem.points["velocity"][:, 0] = -1e-3 * np.exp(-((x - 8.0) ** 2))
    first = problem.energies().kinetic
    for t in mpm.times(4.0, dt=0.02):
        problem.step(t)
    energies = problem.energies()
    assert (energies.kinetic + energies.strain) / first < 1e-3


def test_absorbing_needs_a_rectangular_grid():
    grid = mesh.create_unit_square(COMM, 3, 3, mesh.CellType.triangle)
    with pytest.raises(errors.UnsupportedGridError):
        mpm.absorbing(mpm.Space(grid), "left", density=1.0, p_speed=1.0)


def test_sides_with_dashpots_refuse_refined_spaces():
    grid = mpm.create_lattice(COMM, [range(5), range(5)])
    V = mpm.Space(grid, "gimp", refine=lambda x: np.full(x.shape[1], 0.5), levels=1)
    with pytest.raises(errors.UnsupportedGridError, match=r"absorbing sides .* levels = 1"):
        mpm.absorbing(V, "bottom", density=1e3, p_speed=30.0)
    with pytest.raises(errors.UnsupportedGridError, match=r"free-field sides .* levels = 1"):
        mpm.free_field(V, "left", "right", column=None)


@pytest.mark.parametrize("kind", [mpm.Explicit, mpm.Newmark])
def test_what_a_condition_holds_no_face_acts_on(kind):
    waves = {"density": 1.0, "p_speed": 10.0}
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 2)], (8, 4), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 1)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=100.0, nu=0.0), points, V.increment, V.test)

    def made(bcs):
        return kind(F, V.increment, points, bcs)

    right = mpm.absorbing(V, "right", **waves)
    whole = mpm.prescribed(V, lambda x: x[0] > 1.9, 0, increment=0.0)
    for held, where in ((mpm.fixed(V, "right"), "'right'"), (whole, "'nodes from")):
        words = rf"absorbing face at 'right' .* direction 0, .* the condition at {where}"
        with pytest.raises(errors.ParameterError, match=words):
            made(right + held)
    with pytest.raises(errors.ParameterError, match="absorbing face at 'right' is there twice"):
        made(right + right)
    # what is held at its ends, or in the direction that waves do not come in, still acts
    made(right + mpm.rollers(V, "bottom", "top") + mpm.prescribed(V, "right", 1))
    both = mpm.absorbing(V, "right", s_speed=1.0, **waves)
    with pytest.raises(errors.ParameterError, match="direction 1"):
        made(both + mpm.prescribed(V, "right", 1))


def settle(points, height, weight):
    """Vertical stress of points under their weight (N/m³), without lateral strain."""

    def stress(x):
        found = np.zeros((x.shape[1], 3, 3))
        found[:, 1, 1] = -weight * (height - x[1])
        return found

    mpm.set_stress(mpm.materials.Hencky(E=1e6, nu=0.0), points, stress)


@pytest.mark.parametrize("mu", [0.0, 0.2])
def test_a_block_slides_on_a_frictional_face(mu):
    grid = mesh.create_rectangle(COMM, [(0, 0), (8, 2)], (32, 8), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0.5, 0), (1.5, 1)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, -10.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.0), points, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    points.add_field("velocity", (2,), "m/s", (3.0, 0.0))
    problem = mpm.Explicit(F, u, points, mpm.frictional(V, "bottom", friction=mu))
    # under a sudden weight it would bounce, and rub by more or less than its weight
    settle(points, 1.0, 1e4)
    pushed = 0.8 - 0.5 * problem.step(0.8).dt  # velocities are half a step behind
    mean, up = problem.momentum() / 1000.0
    assert mean == pytest.approx(3.0 - mu * (10.0 * pushed + up), abs=1e-3)
    assert mean == pytest.approx(3.0 - mu * 10.0 * 0.8, abs=0.02)
    moved = points["x"][:, 0].mean() - 1.0
    assert moved == pytest.approx(3.0 * 0.8 - 0.5 * mu * 10.0 * 0.64, rel=0.01)


def on_side(mu, angle=0.0, v0=0.0, levels=0, height=0.5, **options):
    """A block on a side that is inclined by an angle, in cells of a quarter."""
    size = 0.25 * 2**levels
    lines = [np.arange(0.0, 6.0 + size, size), np.arange(0.0, 1.0 + size, size)]
    grid = mpm.create_lattice(COMM, lines)
    refined = {"refine": lambda x: np.full(x.shape[1], 0.25), "levels": levels} if levels else {}
    V = mpm.Space(grid, "gimp", **refined)
    box = mpm.Box((0.5, 0.0), (1.5, height))
    points = mpm.fill(grid, box, 2, 1000.0, **({"refine": V} if levels else {}))
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.0), points, V.increment, V.test)
    g = 10.0 * np.array([np.sin(angle), -np.cos(angle)])
    F -= ufl.inner(points.density * ufl.as_vector(tuple(g)), V.test) * points.dX
    points.add_field("velocity", (2,), "m/s", (v0, 0.0))
    sides = mpm.frictional(V, "bottom", friction=mu)
    return mpm.Explicit(F, V.increment, points, sides, **options)


WAYS = [
    ("musl", {}), ("musl", {"fused": False}), ("usl", {}), ("usf", {}), ("musl", {"levels": 1})
]  # fmt: skip


@pytest.mark.parametrize(("scheme", "options"), WAYS)
@pytest.mark.parametrize("mu", [0.2, 0.6])
def test_a_block_on_an_incline_follows_coulomb(mu, scheme, options):
    """It slides with g (sin − μ cos) and what it bounces; or it stays."""
    angle, end = 0.4, 0.2
    v0 = 1.0 if mu == 0.2 else 0.0
    problem = on_side(mu, angle, v0, scheme=scheme, **options)
    assert bool(problem.unfused) == (scheme == "usf" or bool(options))
    settle(problem.points, 0.5, 1e4 * np.cos(angle))
    pushed = end - 0.5 * problem.step(end).dt  # velocities are half a step behind
    along, up = problem.momentum() / 500.0
    found = problem.energies()
    if v0:
        exact = v0 + 10.0 * (np.sin(angle) - mu * np.cos(angle)) * pushed - mu * up
        assert along == pytest.approx(exact, abs=1e-3)
        assert along == pytest.approx(v0 + 10.0 * (np.sin(angle) - mu * np.cos(angle)) * end, 0.01)
    else:
        # it sways by its shear
        assert (problem.points["x"] - problem.points["x0"])[:, 0].mean() < 0.005
    whole = found.initial + found.external
    assert -0.01 * whole < found["integrator"] < (0.01 if v0 else 0.15) * whole


@pytest.mark.parametrize(("scheme", "options"), WAYS)
@pytest.mark.parametrize("mu", [0.0, 0.6])
def test_a_sudden_weight_on_a_frictional_face_makes_no_energy(mu, scheme, options):
    """What the block stores and swings with is at most the work of its weight.

    With stopped nodes that moved in the mapped velocities, more than the half came from nowhere.
    """
    problem = on_side(mu, height=1.0, scheme=scheme, **options)
    # ρ g² of a bar: the work of its weight down to the static shortening
    work = (1e4) ** 2 / (3.0 * 1e6)
    for t in np.linspace(0.0, 0.5, 11)[1:]:
        problem.step(float(t))
        found = problem.energies()
        assert found["integrator"] > -0.02 * work
        assert abs(found["friction"]) < 0.01 * work
    assert found["integrator"] < 0.3 * work
    # it never rises above where it was put
    assert (problem.points["x"] - problem.points["x0"])[:, 1].max() < 1e-3


@pytest.mark.parametrize("fused", [False, True])
def test_friction_takes_the_work_of_its_force(fused):
    """On a stiff block μ N times the way; the weight on the side takes nothing."""

    def rubbed(mu):
        grid = mpm.create_lattice(COMM, [np.linspace(0, 4, 17)] * 2)
        points = mpm.fill(grid, mpm.Box((0.5, 0), (1.5, 0.5)), 2, 1000.0)
        V = mpm.Space(grid, "gimp")
        F = mpm.momentum(mpm.materials.Hencky(1e6, 0.0), points, V.increment, V.test)
        F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), V.test) * points.dX
        sides = mpm.frictional(V, "bottom", friction=mu)
        points.add_field("velocity", (2,), "m/s", (1.5, 0.0))
        options = {"fused": fused, "mapping": "flip", "scheme": "usl"}
        problem = mpm.Explicit(F, V.increment, points, sides, **options)
        problem.step(0.3)
        found = problem.energies()
        assert abs(found["integrator"]) < 0.02 * found.initial
        return found["friction"], (points["x"] - points["x0"])[:, 0].mean()

    work, way = rubbed(0.3)
    assert work == pytest.approx(0.3 * 5000.0 * way, rel=0.02)
    assert rubbed(0.0)[0] == pytest.approx(0.0, abs=1e-9)


def test_a_side_counts_the_energy_that_it_absorbs():
    grid = mpm.create_lattice(COMM, [np.linspace(0, 2, 41), np.linspace(0, 0.1, 3)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 0.1)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.0), points, V.increment, V.test)
    law = {"density": 1000.0, "p_speed": np.sqrt(1e3), "s_speed": 20.0}
    sides = [*mpm.absorbing(V, "right", **law), *mpm.rollers(V, "bottom"), *mpm.rollers(V, "top")]
    x = points["x"][:, 0]
    problem = mpm.Explicit(F, V.increment, points, sides, fused=True, mapping="flip")
    points["velocity"] = np.outer(0.1 * np.sin(np.pi * np.maximum(x - 1, 0)) ** 2, (1.0, 0.0))
    problem.step(0.06)
    found = problem.energies()
    assert found["damping"] == pytest.approx(0.5 * found.initial, rel=0.02)
    assert abs(found["integrator"]) < 0.01 * found.initial


@pytest.mark.parametrize("options", [{"mass": "consistent"}, {"stabilisation": "aggregation"}])
def test_dashpots_are_of_second_order_in_the_step(options):
    """They resist the mean of the velocities before and after; by those after, the first order."""
    moved = []
    for count in (20, 40, 80):
        grid = mpm.create_lattice(COMM, [np.linspace(0, 2, 9), [0.0, 0.25]])
        points = mpm.fill(grid, mpm.Box((0, 0), (1.9, 0.25)), 2, 1.0)
        V = mpm.Space(grid, "linear")
        F = mpm.momentum(mpm.materials.Hencky(1.0, 0.0), points, V.increment, V.test)
        sides = mpm.absorbing(V, "left", density=1.0, p_speed=1.0)
        problem = mpm.Explicit(F, V.increment, points, sides, courant=np.inf, **options)
        x = points["x"][:, 0]
        points["velocity"] = np.outer(-1e-5 * np.exp(-(((x - 0.8) / 0.4) ** 2)), (1.0, 0.0))
        for t in np.linspace(0.0, 1.0, count + 1)[1:]:
            problem.step(t)
        moved.append((points["x"] - points["x0"])[np.argsort(points["id"]), 0])
    first, second = (np.linalg.norm(a - b) for a, b in pairwise(moved))
    assert first / second > 3.4


@pytest.mark.parametrize(("scheme", "most"), [("musl", 0.005), ("usf", 0.1)])
@pytest.mark.parametrize("fused", [False, True])
def test_long_steps_count_what_a_side_absorbs(fused, scheme, most):
    """By the velocities at the end of the dashpots' impulses, a fifth too much had counted."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 4, 17), [0.0, 0.25]])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 0.25)), 2, 1.0)
    V = mpm.Space(grid, "linear")
    F = mpm.momentum(mpm.materials.Hencky(1.0, 0.0), points, V.increment, V.test)
    sides = mpm.absorbing(V, "left", "right", density=1.0, p_speed=1.0)
    problem = mpm.Explicit(F, V.increment, points, sides, fused=fused, scheme=scheme)
    x = points["x"][:, 0]
    points["velocity"] = np.outer(1e-5 * np.exp(-(((x - 2.0) / 0.6) ** 2)), (1.0, 0.0))
    problem.step(6.0)
    found = problem.energies()
    assert found.kinetic + found.strain < 0.05 * found.initial
    assert abs(found["integrator"]) < most * found.initial


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.GeneralisedAlpha])
def test_dashpots_take_nothing_where_a_side_moves(kind):
    """A side moves along an absorbing side: the dashpot of the corner does not act."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 1, 5)] * 2)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.0), points, V.increment, V.test)
    sides = mpm.moving(V, "left", 0, velocity=lambda t: 0.1 * t)
    sides += mpm.absorbing(V, "bottom", density=1000.0, p_speed=10.0, s_speed=7.0)
    problem = kind(F, V.increment, points, sides)
    for t in (0.1, 0.2, 0.3, 0.4):
        problem.step(t)
    found = problem.energies()
    assert abs(found["integrator"]) < 0.01 * found.external


def test_friction_is_of_explicit_steps():
    with pytest.raises(errors.ParameterError, match="frictional face at 'left'"):
        bar(kind=mpm.Newmark, bcs=lambda V: mpm.frictional(V, "left", friction=0.1))


@pytest.mark.parametrize("kind", [mpm.Explicit, mpm.Newmark])
def test_a_driven_end_sends_a_wave(kind):
    """v(t) at one end arrives at x as v(t − x/c), and its work is the energy of the wave."""

    def pulse(t):
        return 1e-3 * np.sin(2 * np.pi * t) ** 2 if 0 < t < 0.5 else 0.0

    def conditions(V):
        return mpm.moving(V, "left", 0, velocity=pulse) + mpm.fixed(V, "right")

    options = {} if kind is mpm.Explicit else {"stabilisation": "ghost"}
    problem = bar(kind=kind, bcs=conditions, **options)
    for t in mpm.times(1.0, dt=0.01):
        problem.step(t)
    x, velocity = problem.points["x"][:, 0], problem.points["velocity"][:, 0]
    # explicit velocities are half a step behind
    end = 1.0 - (0.5 * problem.history[-1].dt if kind is mpm.Explicit else 0.0)
    exact = np.array([pulse(end - s / 10.0) for s in x])
    assert np.abs(velocity - exact).max() < 0.1 * 1e-3
    energies = problem.energies()
    stored = energies.kinetic + energies.strain
    assert energies.external == pytest.approx(stored, rel=0.01)
    # ρ c ∫ v² dt
    assert stored == pytest.approx(10.0 * 1e-6 * 0.5 * 3 / 8, rel=0.02)
