"""Explicit steps by fused loops: the same as the general ones, and why some are not fused."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import InstabilityError
from dolfinmpm.dynamics import fusedloop
from dolfinmpm.dynamics.passes import LAW, PASSES
from dolfinmpm.dynamics.pointarrays import stored_energy
from dolfinmpm.materials import CamClay, Hencky, MohrCoulomb, NeoHookean, VonMises

LONG = pytest.mark.long
FIELDS = ("x", "velocity", "acceleration", "F", "stress", "V", "l")
HENCKY, NEO = Hencky(E=1e5, nu=0.3), NeoHookean(E=1e5, nu=0.3)
STEEL = VonMises(E=1e5, nu=0.3, radius=2e3)
CLAY = CamClay(
    swelling=0.018,
    compression=0.13,
    M=1.05,
    mu0=5400.0,
    alpha=0.0,
    reference_pressure=20.0,
    preconsolidation=2e4,
)


def lattice(d=2, n=8, power=1.0):
    """A grid of [-1, 1]^d; with a power, cells are larger away from the middle."""
    low, high = [-1.0] * d, [1.0] * d
    if d == 2:
        grid = mesh.create_rectangle(COMM, [low, high], (n, n), mesh.CellType.quadrilateral)
    else:
        grid = mesh.create_box(COMM, [low, high], (n,) * 3, mesh.CellType.hexahedron)
    x = grid.geometry.x
    x[:] = np.sign(x) * np.abs(x) ** power
    return grid


def problem(
    law=HENCKY, basis="bspline2", averaged=None, scheme="usl", mapping="flip", strain="large", d=2,
    fbar=False, domains="stretch", body=None, power=1.0, push=0.0, load=None, conditions=None,
    fused=True, start=None, **options,
):  # fmt: skip
    """A body that turns, is strained and falls."""
    grid = lattice(d, 8 if d == 2 else 5, power)
    centre = (0.013, -0.021, 0.034)[:d]
    body = body or (mpm.Disc(centre, 0.55) if d == 2 else mpm.Ball(centre, 0.6))
    points = mpm.fill(grid, body, 2, 1000.0)
    options_of = {} if averaged is None else {"averaged": averaged}
    V = mpm.Space(grid, basis, domains=domains, **options_of)
    u, v = V.increment, V.test
    small = {"strain": strain, "fbar": fbar} if fbar or strain != "large" else {}
    laws = law if isinstance(law, list) else [law]
    if len(laws) > 1:
        points["tag"][points["x"][:, 1] > 0] = 1
        F = sum(mpm.momentum(own, points, u, v, tag=k, **small) for k, own in enumerate(laws))
    else:
        F = mpm.momentum(law, points, u, v, **small)
    g = fem.Constant(grid, (0.3, -1.0, 0.2)[:d])
    b = g if load is None else load(points, g)
    F -= ufl.inner(points.density * b, v) * points.dX
    if start is not None:
        mpm.set_stress(law, points, start)
    points.add_field("velocity", (d,), "m/s")
    x = points["x"]
    points["velocity"] = 0.1 * x
    points["velocity"][:, 0] -= 0.5 * x[:, 1]
    points["velocity"][:, 1] += 0.5 * x[:, 0] + 0.1 * x[:, -1] ** 2
    bcs = mpm.fixed(V, lambda x: x[1] < -0.4)
    if push:
        bcs = mpm.prescribed(V, "bottom", 1, increment=push) + mpm.rollers(V, "left")
    if conditions is not None:
        bcs = conditions(V)
    options = {"courant": 0.4} | options
    return mpm.Explicit(F, u, points, bcs, scheme=scheme, mapping=mapping, fused=fused, **options)


def compare(times=(0.006, 0.02), tolerance=1e-11, **scene):
    """Both loops on one scene; returns the fused one."""
    one, other = (problem(fused=fused, **scene) for fused in (True, False))
    assert one.unfused == "", one.unfused
    assert other.unfused
    first = other.energies().strain
    for t in times:
        for p in (one, other):
            p.step(t)
    a, b = (np.argsort(p.points["id"]) for p in (one, other))
    names = [*FIELDS, *(set(other.points.fields) & {"be", "elastic_strain", "J_bar"})]
    names += [n for n in other.points.fields if n == "plastic_strain"]
    names += [n for n in other.points.fields if n in ("void_ratio", "preconsolidation")]
    for name in names:
        found, expected = one.points[name][a], other.points[name][b]
        scale = np.abs(expected).max()
        assert np.abs(found - expected).max() <= tolerance * scale, name
    assert [r.parts for r in one.history] == [r.parts for r in other.history]
    mine, theirs = one.energies(), other.energies()
    work = max(abs(theirs.kinetic), abs(theirs.strain), abs(theirs.external))
    assert abs(mine.external - theirs.external) <= 1e-10 * work
    assert mine.losses.keys() == theirs.losses.keys()
    for name, loss in mine.losses.items():
        assert abs(loss - theirs[name]) <= 1e-10 * work, name
    if isinstance(one.form.parts.declarations[0].law, NeoHookean):
        # all is stored; the sums of the others err by the length of the steps
        stored = theirs.strain - first
        assert abs(one.ledger.work.internal - stored) <= 1e-10 * work
        assert abs(other.ledger.work.internal - stored) <= 1e-4 * work
    return one


LIGHT, GRITTY = VonMises(E=1e5, nu=0.3, radius=50.0), MohrCoulomb(1e5, 0.3, 20, 25)
VARYING = VonMises(E=lambda x: 1e5 * (1 + 0.5 * x[0]), nu=0.3, radius=80.0)
TWO_NEO = [NEO, NeoHookean(E=3e5, nu=0.2)]
CORNER, EDGES = mpm.Box((-1, -1), (0.6, 0.43)), mpm.Box((-1, -1), (1, 0.3))
PUSHED = {"push": 0.01, "damping": 0.1, "mass_scaling": 4.0}


def by_place(points, g):
    """A load that differs from point to point."""
    return (1 + points.x0[0]) * g


# each kind of loop takes seconds to compile: all pairs of dimension, measure of strain, basis,
# scheme and mapping are in these, and what else may differ is spread over them
PAIRS = [
    (2, "neo", "linear", "musl", "apic", {}),
    (2, "jaumann", "linear", "usl", "tpic", {}),
    (2, "small", "gimp", "usl", "tpic", {}),
    (2, "jaumann", "gimp", "musl", "flip", {"power": 1.3}),
    (2, "large", "bspline2 averaged", "usf", "flip", {"law": VARYING, "domains": "fixed"}),
    (2, "neo", "bspline2 averaged", "usl", "tpic", {"domains": "volume"}),
    (2, "large", "bspline2", "usl", "apic", {"body": EDGES}),
    (2, "small", "bspline2", "usf", "tpic", {}),
    (2, "small", "bspline3 averaged", "usl", "pic", {}),
    (2, "jaumann", "bspline3 averaged", "musl", "apic", {"body": EDGES}),
    (2, "neo", "bspline3", "usl", "pic", {"law": TWO_NEO}),
    (2, "small", "bspline3", "musl", mpm.Mapping("flip", share=0.9), {}),
    (3, "large", "linear", "usl", "flip",
     {"body": mpm.Box((-1, -1, -1), (0.6, 0.4, 0.2)), "courant": 0.03} | PUSHED),
    (3, "small", "linear", "usf", "pic", {"law": LIGHT}),
    (3, "large", "gimp", "musl", "pic", {"power": 1.3}),
    (3, "neo", "gimp", "usf", "apic", {"body": mpm.Box((-1, -1, -1), (1, 0.3, 0.6))}),
    (3, "small", "bspline2 averaged", "musl", "apic", {"law": LIGHT, "domains": "fixed"}),
    (3, "jaumann", "bspline2 averaged", "usf", "pic", {"domains": "volume"}),
    (3, "neo", "bspline2", "musl", "pic", {"law": TWO_NEO, "load": by_place}),
    (3, "jaumann", "bspline2", "usl", "flip", {"body": mpm.Box((-1, -1, -1), (1, 0.3, 1))}),
    (3, "large", "bspline3 averaged", "musl", "tpic", {"law": [HENCKY, VARYING]}),
    (3, "neo", "bspline3 averaged", "usf", "flip", {"load": by_place}),
    (3, "large", "bspline3", "usf", "tpic", {"law": GRITTY, "power": 1.3}),
    (3, "jaumann", "bspline3", "usf", "apic", {}),
]  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(
    ("d", "measure", "basis", "scheme", "mapping", "more"),
    PAIRS,
    ids=["-".join(str(x) for x in scene[:4]) for scene in PAIRS],
)
def test_pairs(d, measure, basis, scheme, mapping, more):
    name, *averaged = basis.split()
    laws = {"large": HENCKY, "neo": NEO, "small": STEEL, "jaumann": STEEL}
    scene = {"d": d, "law": laws[measure], "basis": name, "scheme": scheme, "mapping": mapping}
    if name.startswith("bspline"):
        scene["averaged"] = bool(averaged)
    if measure in ("small", "jaumann"):
        scene["strain"] = measure
    (compare if d == 2 else in_three_dimensions)(**(scene | more))


def test_strain_before_stress():
    compare(basis="bspline2", averaged=False, scheme="usf")


@pytest.mark.parametrize(
    "scene",
    [{"scheme": "musl"}, pytest.param({"d": 3, "averaged": False, "courant": 0.08}, marks=LONG)],
    ids=["2D", "3D"],
)
def test_jaumanns_rate(scene):
    one = compare(strain="jaumann", law=STEEL, times=(0.01, 0.05), **scene)
    # by large strain and the other rate stresses differ
    assert np.abs(one.points["elastic_strain"]).max() > 1e-4


@pytest.mark.parametrize("law", [LIGHT, pytest.param(GRITTY, marks=LONG)], ids=["steel", "sand"])
def test_laws_that_yield(law):
    one = compare(law=law, averaged=False)
    assert np.any(one.points["plastic_strain"] > 0)


@pytest.mark.long
def test_clay():
    stress = np.zeros((3, 3)) - 60e2 * np.eye(3)
    compare(law=CLAY, averaged=False, start=lambda x: np.tile(stress, (x.shape[1], 1, 1)))


def test_two_laws_by_tags_and_parameters_by_points():
    compare(law=[HENCKY, VARYING], averaged=False)


@pytest.mark.long
def test_cells_of_different_sizes():
    compare(power=1.3, averaged=False)


@pytest.mark.long
def test_points_at_the_grids_edges():
    compare(averaged=False, body=EDGES)


@pytest.mark.parametrize("scheme", ["usl", *(pytest.param(s, marks=LONG) for s in ("musl", "usf"))])
def test_prescribed_motion_damping_and_scaled_mass(scheme):
    # fused steps find the critical step anew after 20 steps, others in every call: points have the
    # speed of the side by then. With this Courant number both take as many steps
    body = mpm.Box((-1, -1), (0.6, 0.4))
    compare(body=body, averaged=False, scheme=scheme, courant=0.3, **PUSHED)


def schemes(daily, solid):
    """Schemes and dimensions: all of two dimensions, one of them of every day, and one of three."""
    flat = [pytest.param(s, 2, marks=[LONG] * (s != daily)) for s in ("usl", "musl", "usf")]
    return [*flat, pytest.param(solid, 3, marks=LONG)]


def lying(d):
    """A block on the ground, and how fine its steps are.

    It is not symmetric: damping takes the sign of velocities, which rounding would make of zero.
    """
    body = mpm.Box((-1, -1), (0.6, 0.4)) if d == 2 else mpm.Box((-1, -1, -1), (0.6, 0.4, 0.2))
    return {"d": d, "body": body, "averaged": False, "courant": 0.4 if d == 2 else 0.1}


@pytest.mark.parametrize(("scheme", "d"), schemes("usl", "musl"))
def test_velocities_in_time(scheme, d):
    def conditions(V):
        pressed = mpm.moving(V, "bottom", 1, velocity=lambda t: 0.3 * np.sin(60 * t))
        return (
            pressed
            + mpm.moving(V, lambda x: x[0] < -0.8, 0, velocity=0.1)
            + mpm.rollers(V, "right")
        )

    one = compare(
        conditions=conditions, damping=0.1, mass_scaling=4.0, scheme=scheme, times=(0.013, 0.06),
        **lying(d),
    )  # fmt: skip
    assert abs(one.energies().external) > 0


RUBBING = [("musl", 2), *(pytest.param(*one, marks=LONG) for one in [("usl", 2), ("musl", 3)])]


@pytest.mark.filterwarnings("ignore:the absorbing side")
@pytest.mark.parametrize(("scheme", "d"), RUBBING)
def test_sides_that_rub_and_let_waves_out(scheme, d):
    def conditions(V):
        sides = mpm.frictional(V, "bottom", friction=0.3) + mpm.frictional(V, "left", friction=0.0)
        if d == 3:
            sides += mpm.frictional(V, "front", friction=0.2)
        waves = {"density": 1000.0, "p_speed": 12.0, "s_speed": 6.0}
        return sides + mpm.absorbing(V, "right", **waves) + mpm.rollers(V, "left")

    one = compare(
        conditions=conditions, damping=0.1, mass_scaling=2.0, scheme=scheme, times=(0.013, 0.06),
        mapping="flip", **lying(d),
    )  # fmt: skip
    assert one.energies().kinetic > 0


def in_three_dimensions(law, **scene):
    """Both loops on a scene of many steps."""
    scene = {"courant": 0.08, "d": 3} | scene
    one = compare(times=(0.006, 0.02, 0.08), law=law, **scene)
    assert sum(record.parts for record in one.history) > 20
    if law is LIGHT:
        assert np.any(one.points["plastic_strain"] > 0)


def test_three_dimensions():
    in_three_dimensions(LIGHT, averaged=False)


def test_many_steps_of_a_call_and_loads_that_change():
    t = None

    def load(points, g):
        return ufl.as_vector((g[0] * t, g[1] - t * t))

    found = []
    for fused in (True, False):
        grid = lattice()
        t = fem.Constant(grid, 0.0)
        points = mpm.fill(grid, mpm.Disc((0.01, 0.02), 0.5), 2, 1000.0)
        V = mpm.Space(grid, "bspline2", averaged=False)
        F = mpm.momentum(NEO, points, V.increment, V.test)
        F -= ufl.inner(points.density * ufl.as_vector((50 * t, -100 * t * t)), V.test) * points.dX
        # and a load that differs from point to point
        F -= 20 * t * points.density * points.x0[0] * V.test[1] * points.dX
        p = mpm.Explicit(F, V.increment, points, time=t, courant=0.1, fused=fused, scheme="usl")
        assert (p.unfused == "") == fused
        p.step(0.2)
        p.step(0.3)
        assert p.history[0].parts > 40
        order = np.argsort(points["id"])
        found.append({name: points[name][order] for name in FIELDS} | {"work": p.energies()})
    for name in FIELDS:
        scale = np.abs(found[1][name]).max()
        assert np.abs(found[0][name] - found[1][name]).max() <= 1e-11 * max(scale, 1e-3), name
    one, other = (x["work"] for x in found)
    assert other.external > 0
    assert one.external == pytest.approx(other.external, rel=1e-10)


@pytest.mark.parametrize("d", [2, 3])
def test_loops_can_be_kept_on_disk(d):
    # Numba knows a loop again by what it closes over, and a compiled function never again
    loop = fusedloop.kernel(d, 2, 1, LAW, 1, PASSES["usl"][0], False)
    values = [cell.cell_contents for cell in loop.py_func.__closure__]
    assert values
    assert all(isinstance(value, (bool, int)) for value in values)


def test_fields_may_be_changed_between_calls():
    pair = [problem(fused=fused, averaged=False) for fused in (True, False)]
    for p in pair:
        p.step(0.005)
        p.points["velocity"] *= 2.0
        p.step(0.01)
    a, b = (np.argsort(p.points["id"]) for p in pair)
    for name in ("x", "velocity", "stress"):
        expected = pair[1].points[name][b]
        scale = np.abs(expected).max()
        assert np.abs(pair[0].points[name][a] - expected).max() <= 1e-11 * scale


def test_steps_that_the_solver_chooses():
    """Twenty fused ones a call, as long as the critical step is not asked for anew."""
    pair = [problem(fused=fused, averaged=False, courant=0.05) for fused in (True, False)]
    for p, at_once in zip(pair, (20, 1)):
        for t in mpm.times(0.05, dt="auto"):
            p.step(t)
        *others, last = (record.parts for record in p.history)
        assert len(others) > 1
        assert set(others) == {at_once}
        assert 1 <= last <= at_once
        assert p.time == 0.05
    a, b = (np.argsort(p.points["id"]) for p in pair)
    expected = pair[1].points["velocity"][b]
    assert np.abs(pair[0].points["velocity"][a] - expected).max() <= 1e-11


def test_the_bare_number_of_a_chosen_time_is_enough():
    for fused in (True, False):
        p = problem(fused=fused, averaged=False, courant=0.05)
        for t in mpm.times(0.05, dt="auto"):
            p.step(float(t))
        assert p.time == 0.05
        assert len(p.history) > 1


def test_a_point_that_leaves_the_grid_is_an_error():
    p = problem(averaged=False, body=mpm.Box((0.2, -0.3), (0.9, 0.5)))
    p.points["velocity"][:] = 60.0, 0.0
    with pytest.raises(InstabilityError, match="it is outside: enlarge the grid"):
        p.step(1.0)


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("d", [2, 3])
def test_stored_energy_is_that_of_the_law(d, far):
    rng = np.random.default_rng(3)
    F = np.eye(d) + 0.02 * rng.random((50, d, d))
    if far:
        F[7], F[20] = 1.4 * np.eye(d), np.diag([0.6] + [1.0] * (d - 1))
    V0, (lmbda, mu) = rng.random(50), (2e5, 1e5)
    found = stored_energy(F, V0, np.array([[lmbda, mu]]), np.zeros(1, np.uint8))
    q = np.log(np.linalg.det(F))
    trace = np.einsum("pij,pij->p", F, F) - d
    expected = V0 @ (0.5 * mu * trace - mu * q + 0.5 * lmbda * q**2)
    assert found == pytest.approx(expected, rel=1e-12)
