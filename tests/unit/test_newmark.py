"""Implicit steps in time: what is exact, orders, energies, restarts, and what may go wrong."""

from __future__ import annotations

import itertools
import math
import warnings

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh
from scenes import disc

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError, ParameterError
from dolfinmpm.dynamics.inertia import NewmarkRule

QUADRILATERAL = mesh.CellType.quadrilateral
RULES = [
    (mpm.Newmark, {}),
    (mpm.GeneralisedAlpha, {}),
    (mpm.GeneralisedAlpha, {"rho_inf": 1.0}),
    (mpm.GeneralisedAlpha, {"rho_inf": 0.0}),
]


def block(problem=mpm.Newmark, basis="gimp", law=None, load=(0.0, 0.0), held=True, **options):
    """A block on the ground, or a free one, under a load per mass; returns it and the load."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (5, 6)], (5, 6), QUADRILATERAL)
    low = 0.0 if held else 2.3
    points = mpm.fill(grid, mpm.Box((1.1, low), (3.53, low + 2.6)), 2, 1000.0)
    V = mpm.Space(grid, basis)
    g = fem.Constant(grid, load)
    F = mpm.momentum(law or mpm.materials.Hencky(E=1e5, nu=0.3), points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.fixed(V, "bottom") if held else ()
    options = {"stabilisation": "ghost", **options}
    return problem(F, V.increment, points, bcs, **options), g


# -- free fall ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mass", "mapping"),
    [
        *(("lumped", m) for m in ("pic", "flip", "accel", "apic", "tpic", "xpic", "fmpm")),
        *(("consistent", m) for m in ("pic", "flip", "accel")),
    ],
)
@pytest.mark.parametrize(("rule", "options"), RULES)
def test_free_fall_is_exact_from_the_first_step(rule, options, mass, mapping):
    """With steps of any length, and when gravity jumps on the way."""
    problem, g = block(rule, held=False, mass=mass, mapping=mapping, **options)
    points = problem.points
    v, x, positions = np.zeros(2), np.zeros(2), points["x0"]
    for k in range(10):
        a, dt = np.array((0.5, -10.0) if k < 5 else (-3.0, 7.0)), 0.05 + 0.01 * (k % 3)
        g.value[:] = a
        problem.step(problem.time + dt)
        x += v * dt + 0.5 * a * dt**2
        v += a * dt
        np.testing.assert_allclose(points["velocity"] - v, 0, atol=1e-13 * np.abs(v).max())
        np.testing.assert_allclose(points["x"] - positions - x, 0, atol=1e-13 * np.abs(x).max())
    now, m = problem.energies(), points["density"] @ points["V0"]
    assert now.kinetic == pytest.approx(0.5 * m * v @ v, rel=1e-12)
    assert now.external == pytest.approx(now.kinetic, rel=1e-12)
    assert abs(now.strain) + abs(now.dissipated) < 1e-12 * now.kinetic
    assert problem.momentum() == pytest.approx(m * v, rel=1e-12)


@pytest.mark.parametrize("basis", ["linear", "bspline2", "bspline3"])
@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation", "extended"])
def test_free_fall_in_every_basis_with_every_stabilisation(basis, stabilisation):
    for mass in ("lumped", "consistent"):
        problem, _ = block(
            basis=basis, held=False, load=(0.0, -10.0), mass=mass, stabilisation=stabilisation
        )
        problem.step(0.1)
        problem.step(0.25)
        v = problem.points["velocity"]
        np.testing.assert_allclose(v, np.broadcast_to((0, -2.5), v.shape), rtol=0, atol=1e-10)


def test_without_the_first_acceleration_a_deficit_would_stay():
    """Half a step's gain of velocity, for ever; this is why M a = f comes first."""
    problem, _ = block(held=False, load=(0.0, -10.0), mass="lumped", mapping="accel")
    problem.motion._starting = False
    for _ in range(20):
        problem.step(problem.time + 0.02)
    assert problem.points["velocity"][:, 1] == pytest.approx(-4.0 + 10.0 * 0.02 / 2, rel=1e-12)


@pytest.mark.parametrize("mass", ["lumped", "consistent"])
@pytest.mark.parametrize(("rule", "options"), RULES)
def test_free_fall_of_points_that_come_later(rule, options, mass, tmp_path):
    """They had lacked the gain of up to half a step, for ever."""
    problem, _ = block(rule, held=False, load=(0.0, -10.0), mass=mass, **options)
    points = problem.points
    problem.step(0.02)
    new = mpm.fill(points.grid, mpm.Box((4, 4), (5, 6)), 2, 1000.0)
    new.add_field("velocity", (2,), "m/s", lambda x: np.full(x.T.shape, (0.0, -0.2)))
    points.add(new)
    # a checkpoint knows of the points that have come
    problem.save(tmp_path / "state")
    other, _ = block(rule, held=False, load=(0.0, -10.0), mass=mass, **options)
    other.load(tmp_path / "state")
    for one in (problem, other):
        for t in (0.04, 0.07):
            one.step(t)
        np.testing.assert_allclose(one.points["velocity"][:, 1], -0.7, rtol=1e-12)
        assert abs(one.energies().dissipated) < 1e-12 * one.energies().external


# -- order ----------------------------------------------------------------------


@pytest.mark.parametrize("rho_inf", [0.0, 0.5, 0.8, 1.0])
def test_the_highest_frequencies_keep_the_share_asked_for(rho_inf):
    rule = disc(rho_inf=rho_inf).motion.rule
    amplification = lambda stiffness: np.column_stack(  # noqa: E731
        [oscillator(rule, stiffness, *state) for state in np.eye(3)]
    )
    radius = [
        np.abs(np.linalg.eigvals(amplification(10.0**k))).max() for k in np.arange(-2, 9, 0.5)
    ]
    assert max(radius) < 1 + 1e-8
    # a threefold root at ρ∞ = 0 is not found to more digits
    assert radius[-1] == pytest.approx(rho_inf, abs=2e-3 if rho_inf else 0.02)


def oscillator(rule: NewmarkRule, stiffness, v, a, x):
    """A step of unit length of a mass of 1 kg on a spring, from where it is."""
    inertia = rule.factor(1.0)
    level = -(rule.known(v, a, 1.0) + stiffness * x) / (inertia + stiffness)
    u = level / (1 - rule.alpha_f)
    a_end = rule.acceleration(u, v, a, 1.0)
    return rule.velocity(v, a, a_end, 1.0), a_end, x + u


def confined_bar(rule, dt, end=1.7, **options):
    """Displacements and velocities of a bar that vibrates a little between two walls."""
    grid = mesh.create_interval(COMM, 10, [0.0, 25.0])
    points = mpm.fill(grid, mpm.Box((0.0,), (25.0,)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=100.0, nu=0.0), points, V.increment, V.test)
    points.add_field("velocity", (1,), "m/s", lambda x: 1e-3 * np.sin(np.pi * x.T / 25))
    problem = rule(F, V.increment, points, mpm.fixed(V, "left", "right"), **options)
    for t in mpm.times(end, dt=dt):
        problem.step(t)
    return np.stack([points["x"] - points["x0"], points["velocity"]])


@pytest.mark.parametrize(
    ("rule", "options", "order"),
    [
        (mpm.Newmark, {"mapping": "pic"}, 2),
        (mpm.Newmark, {"mapping": "flip"}, 2),
        (mpm.Newmark, {"mapping": "accel"}, 2),
        (mpm.GeneralisedAlpha, {"rho_inf": 1.0}, 2),
        (mpm.GeneralisedAlpha, {"rho_inf": 0.5}, 2),
        (mpm.GeneralisedAlpha, {"rho_inf": 0.2}, 2),
        (mpm.Newmark, {"gamma": 0.9, "beta": 0.49}, 1),
    ],
)
def test_order_in_time(rule, options, order):
    """In cells that stay full no ghost penalty is needed, and mapping loses nothing."""
    options = {"ghost_mass": 0.0, **options}
    runs = [confined_bar(rule, dt, **options) for dt in (0.05, 0.025, 0.0125)]
    first, second = (
        np.sqrt(np.sum((a - b) ** 2, axis=(1, 2))) for a, b in itertools.pairwise(runs)
    )
    assert np.log2(first / second) == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize(("rule", "options"), RULES[:3])
@pytest.mark.parametrize("by", ["time", "constant"])
def test_order_under_a_load_that_varies(rule, options, by):
    """A free body in a field cos 3t: forces balance under the load of their own time."""
    errors, works = [], []
    for dt in (0.1, 0.05, 0.025):
        grid = mesh.create_interval(COMM, 8, [0.0, 8.0])
        points = mpm.fill(grid, mpm.Box((3.2,), (5.1,)), 2, 1.0)
        V = mpm.Space(grid, "gimp")
        now, g = fem.Constant(grid, 0.0), fem.Constant(grid, 0.0)
        load = ufl.cos(3 * now) if by == "time" else g
        F = mpm.momentum(mpm.materials.Hencky(E=1e4, nu=0.0), points, V.increment, V.test)
        F -= points.density * load * V.test[0] * points.dX
        clock = {"time": now} if by == "time" else {}
        problem = rule(F, V.increment, points, stabilisation="ghost", **clock, **options)
        for t in mpm.times(1.0, dt=dt):
            g.value = math.cos(3 * t)
            problem.step(t)
            assert by != "time" or float(now.value) == t
        v, u = math.sin(3) / 3, (1 - math.cos(3)) / 9
        moved = points["x"] - points["x0"]
        errors.append([np.abs(points["velocity"] - v).max(), np.abs(moved - u).max()])
        works.append(abs(problem.energies().external - 0.5 * 1.9 * v**2))
    errors = np.array(errors)
    assert errors[-1].max() < 5e-4
    assert np.log2(errors[:-1] / errors[1:]).min() > 1.9
    assert works[2] < min(6e-6, works[0] / 8)


# -- energies -------------------------------------------------------------------


def confined_block(rule, dt, law, driven=False, **options):
    """Energies, step by step, of a block that fills its box and is shaken; (steps, 4)."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 3)], (4, 3), QUADRILATERAL)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 3)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(law, points, V.increment, V.test)
    X = points.x0
    g = fem.Constant(grid, 10.0) * ufl.as_vector((ufl.sin(X[1]), ufl.cos(X[0])))
    F -= ufl.inner(points.density * g, V.test) * points.dX
    push = fem.Constant(grid, 0.0)
    right = mpm.prescribed(V, "right", 0, increment=push) if driven else mpm.rollers(V, "right")
    bcs = mpm.rollers(V, "left", "bottom", "top") + right
    problem = rule(F, V.increment, points, bcs, ghost_mass=0.0, **options)
    found = []
    for t in mpm.times(0.4, dt=dt):
        if driven:
            push.value = -0.5 * (t**3 - problem.time**3)
        problem.step(t)
        now = problem.energies()
        whole = now.kinetic + now.strain + now.dissipated - now.external
        assert abs(whole - now.initial) < 1e-9 * now.external
        found.append((now.kinetic, now.strain, now["plastic"], now.external))
    return np.array(found)


LAWS = {
    "hencky": mpm.materials.Hencky(E=2e5, nu=0.3),
    "neo-hookean": mpm.materials.NeoHookean(E=2e5, nu=0.3),
    "yielding": mpm.materials.VonMises(E=2e5, nu=0.3, radius=5e3),
}


@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("law", LAWS)
def test_energies_balance(law, driven):
    """What loads and a moving wall put in is kinetic, stored or dissipated."""
    gaps = []
    for dt in (0.02, 0.01):
        kinetic, strain, dissipated, external = confined_block(mpm.Newmark, dt, LAWS[law], driven).T
        gaps.append(np.abs(kinetic + strain + dissipated - external).max() / external.max())
    assert gaps[0] < 5e-3
    assert gaps[1] < 0.6 * gaps[0]
    # by the midpoint rule nothing goes by way of the points' accelerations
    options = {"rho_inf": 1.0}
    kinetic, strain, dissipated, external = confined_block(
        mpm.GeneralisedAlpha, 0.01, LAWS[law], driven, **options
    ).T
    gap = np.abs(kinetic + strain + dissipated - external).max() / external.max()
    assert gap < 2e-3 if law == "yielding" or driven else gap < 1e-4
    if law == "yielding":
        assert dissipated[-1] > 0.1 * external[-1]
        assert np.diff(dissipated).min() > -1e-3 * dissipated[-1]
    else:
        assert not dissipated.any()


def test_energies_of_a_law_that_does_not_know_its_own():
    class Silent(mpm.materials.Hencky):
        def energy(self, strain, parameters):
            return None

    problem, _ = block(law=Silent(E=1e5, nu=0.3), load=(0.0, -1.0))
    problem.step(0.02)
    now = problem.energies()
    assert math.isnan(now.strain)
    assert now.kinetic > 0


# -- with other things ----------------------------------------------------------------


@pytest.mark.parametrize("cell", [mesh.CellType.triangle, mesh.CellType.tetrahedron])
def test_simplices(cell):
    d = 2 if cell == mesh.CellType.triangle else 3
    n = 6 if d == 2 else 4
    if d == 2:
        grid = mesh.create_rectangle(COMM, [(0, 0), (6, 6)], (n, n), cell)
    else:
        grid = mesh.create_box(COMM, [(0, 0, 0), (6, 6, 6)], (n, n, n), cell)
    points = mpm.fill(grid, mpm.Ball((3.0,) * d, 1.9), 2, 1000.0)
    V = mpm.Space(grid, "linear")
    F = mpm.momentum(mpm.materials.NeoHookean(E=1e5, nu=0.3), points, V.increment, V.test)
    shift, turn = np.arange(1.0, d + 1), np.zeros((d, d))
    turn[0, 1], turn[1, 0] = -1.0, 1.0
    points.add_field("velocity", (d,), "m/s")
    points["velocity"] = shift + (points["x"] - 3.0) @ turn.T
    options = {"stabilisation": "ghost", "tolerance": 1e-12, "rho_inf": 1.0}
    problem = mpm.GeneralisedAlpha(F, V.increment, points, **options)
    start = problem.momentum(), problem.angular_momentum(), problem.energies().kinetic
    for t in mpm.times(0.1, dt=0.02):
        problem.step(t)
    np.testing.assert_allclose(problem.momentum(), start[0], rtol=1e-12)
    scale = np.abs(start[1]).max()
    np.testing.assert_allclose(problem.angular_momentum(), start[1], rtol=0, atol=1e-5 * scale)
    now = problem.energies()
    assert now.kinetic + now.strain == pytest.approx(start[2], rel=1e-3)


def test_a_wall_drags_what_sticks_to_it():
    """A prescribed motion is that of the wall in every part of a step."""
    for rule, options in RULES[:2]:
        problem, _ = block(rule, law=mpm.materials.Hencky(E=1e6, nu=0.3), **options)
        V, points = problem.form.spaces[0], problem.points
        push = fem.Constant(points.grid, 0.0)
        bcs = mpm.prescribed(V, "bottom", 0, increment=push) + mpm.prescribed(V, "bottom", 1)
        problem = rule(problem.form.given, V.increment, points, bcs, **options)
        wall = 0.0
        for t in mpm.times(3.0, dt=0.04):
            push.value = 0.25 * (t - problem.time) * min(t, 1.0)
            wall += push.value
            problem.step(t)
        # it moves with the wall, and swings a little
        moved = points["x"][:, 0] - points["x0"][:, 0]
        assert moved.mean() == pytest.approx(wall, rel=0.02)
        m = points["density"] @ points["V0"]
        assert problem.energies().external == pytest.approx(0.5 * m * 0.25**2, rel=0.2)


# -- what is refused --------------------------------------------------------------


def test_times_must_be_later():
    problem, _ = block()
    problem.step(0.1)
    for t in (0.1, 0.05, -1.0):
        with pytest.raises(ParameterError, match=r"must be later than the time of the state, 0\.1"):
            problem.step(t)
    with pytest.raises(ParameterError, match=r"step\(t\) needs the time to go to"):
        problem.step()
    with pytest.raises(ParameterError, match="t = nan s must be finite"):
        problem.step(math.nan)
    assert problem.time == 0.1
    problem.step(0.2)


def test_a_total_lagrangian_space_is_refused():
    grid = mesh.create_rectangle(COMM, [(0, 0), (3, 3)], (3, 3), QUADRILATERAL)
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1.0)
    V = mpm.Space(grid, "gimp", configuration="total")
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
    with pytest.raises(ParameterError, match=r'configuration="updated"\), got "total"'):
        mpm.Newmark(F, V.increment, points)


def test_nothing_is_warned_of():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        problem, _ = block(load=(0.0, -1.0))
        problem.step(0.01)


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.GeneralisedAlpha])
def test_after_an_error_the_time_of_the_form_is_that_of_the_state(kind):
    clock = None

    class Clocked(kind):
        def __init__(self, form, u, points, *others, **options):
            nonlocal clock
            clock = fem.Constant(points.grid, 0.0)
            super().__init__(form, u, points, *others, time=clock, **options)

    problem, _ = block(Clocked, load=(0.0, -1.0))
    problem.step(0.01)
    finish, taken = problem.scheme.finish, []

    def second_fails(*given):
        taken.append(given)
        return finish(*given) if len(taken) == 1 else "so that it fails"

    problem.scheme.finish, problem.share, problem.max_halvings = second_fails, 0.5, 2
    with pytest.raises(ConvergenceError):
        problem.step(0.03)
    assert problem.time == pytest.approx(0.02)
    assert float(clock.value) == problem.time
    problem.scheme.finish = finish
    problem.step(0.03)
    assert float(clock.value) == problem.time == 0.03
