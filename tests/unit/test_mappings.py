"""Velocities from the points to the grid and back: what is exact, and what is kept."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from conftest import COMM, unit_grid
from dolfinx import mesh
from scenes import disc

import dolfinmpm as mpm
from dolfinmpm._platform.errors import DolfinMPMError, SingularMassWarning
from dolfinmpm.dynamics import transfer
from dolfinmpm.dynamics.energies import angular_momentum
from dolfinmpm.dynamics.nodalmass import Mass

OF_ANY_MASS = ("pic", "flip", "accel")
OF_LUMPED = ("apic", "tpic", "xpic", "fmpm")
GRADIENT = np.array([[0.7, -0.3], [1.1, 0.4]])
SHIFT = np.array([2.0, -1.0])


def affine(x):
    """An affine field at positions of shape (n, d)."""
    d = x.shape[1]
    return x @ GRADIENT[:d, :d].T + SHIFT[:d]


def block(kind, basis, cut, rule=mpm.Newmark, **options):
    """A block whose edges reach into their last cells by a share of one; it moves affinely."""
    h, low, high = 0.1, 0.53, 1.2 + 0.1 * cut
    if kind == "interval":
        grid = mesh.create_interval(COMM, 20, [0.0, 2.0])
        shape = mpm.Box((low,), (high,))
    else:
        grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (20, 20), mesh.CellType[kind])
        shape = mpm.Box((low, 0.6), (high, 1.0 + h * cut))
    if kind == "triangle":
        # the last points are by that much in their cells
        sides = np.linspace(low, high, 28), np.linspace(0.62, 1.0 + h * cut, 17)
        x = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
        points = mpm.MaterialPoints.from_arrays(grid, x, 0.4 * (high - low) / len(x), 1000.0)
    else:
        points = mpm.fill(grid, shape, 2, 1000.0, aligned="body")
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.0), points, V.increment, V.test)
    points.add_field("velocity", (points.gdim,), "m/s")
    points["velocity"] = affine(points["x"])
    return rule(F, V.increment, points, (), **options)


def mapped(problem):
    """Mass, nodal velocities, active nodes and their positions."""
    here = problem.activate()
    (field,) = here.fields
    mass, x = Mass(problem.terms, here), field.basis.node_coordinates()
    momenta = mass.nodal()
    problem.motion.mapping.to_grid(problem.points, field, x, momenta)
    (V,) = mass.solve(momenta, np.zeros_like(momenta.arrays[0])).arrays
    return mass, V, field.nodes, x[field.nodes, : problem.points.gdim]


def masses(points):
    return points["density"] * points["V0"]


# -- sums ------------------------------------------------------------------------


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_sums_are_those_of_the_stencils(basis):
    problem = disc(basis=basis)
    (field,) = problem.activate().fields
    s, points, rng = field.stencils, problem.points, np.random.default_rng(1)
    n, x_node = len(points), field.basis.node_coordinates()
    weight, q, C = rng.random(n), rng.random((n, 2)), rng.random((n, 2, 2))
    nodal = rng.random((len(x_node), 2))
    plain, with_affine = np.zeros_like(nodal), np.zeros_like(nodal)
    transfer.scatter(s, weight, q, plain)
    transfer.scatter_affine(s, x_node, points["x"], weight, q, C, with_affine)
    back = transfer.collect(s, nodal)
    about = rng.random((n, 2))
    moments = transfer.moments(s, nodal, back, x_node[:, :2], about)
    M = np.zeros((len(x_node), len(x_node)))
    np.add.at(M, *((rows := transfer.mass_entries(s, weight))[:2], rows[2]))
    expected = [np.zeros_like(a) for a in (plain, with_affine, back, moments, M)]
    for p in range(n):
        nodes, N, _ = s.row(p)
        arms = x_node[nodes, :2] - points["x"][p]
        expected[0][nodes] += weight[p] * N[:, None] * q[p]
        expected[1][nodes] += weight[p] * N[:, None] * (q[p] + arms @ C[p].T)
        expected[2][p] = N @ nodal[nodes]
        expected[3][p] = (N[:, None] * (nodal[nodes] - back[p])).T @ (x_node[nodes, :2] - about[p])
        expected[4][np.ix_(nodes, nodes)] += weight[p] * np.outer(N, N)
    for found, right in zip((plain, with_affine, back, moments, M), expected):
        np.testing.assert_allclose(found, right, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("basis", "averaged", "D"), [("bspline2", False, 0.25), ("bspline3", False, 1 / 3)]
)
def test_second_moments_of_splines_do_not_depend_on_the_place(basis, averaged, D):
    grid = unit_grid("quadrilateral", 8)
    points = mpm.fill(grid, mpm.Box((0.3, 0.3), (0.71, 0.69)), 3, 1.0)
    V = mpm.Space(grid, basis, averaged=averaged)
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
    problem = mpm.Newmark(F, V.increment, points)
    (field,) = problem.activate().fields
    x, x_node = points["x"], field.basis.node_coordinates()[:, :2]
    found = transfer.moments(field.stencils, x_node, x, x_node, x)
    h = np.array([1 / 8, 1 / 9])
    np.testing.assert_allclose(found, np.broadcast_to(np.diag(D * h**2), found.shape), atol=1e-15)


# -- to the grid ------------------------------------------------------------------


@pytest.mark.parametrize("cut", [0.5, 1e-3, 1e-6])
@pytest.mark.parametrize(
    ("kind", "basis"),
    [
        ("interval", "linear"),
        ("interval", "gimp"),
        ("interval", "bspline2"),
        ("quadrilateral", "linear"),
        ("quadrilateral", "gimp"),
        ("quadrilateral", "bspline2"),
        ("triangle", "linear"),
    ],
)
@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation"])
def test_a_consistent_mass_gives_affine_velocities_back(kind, basis, cut, stabilisation):
    problem = block(kind, basis, cut, stabilisation=stabilisation)
    mass, V, nodes, x = mapped(problem)
    expected, points = affine(x), problem.points
    np.testing.assert_allclose(V[nodes], expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    momentum = masses(points) @ points["velocity"]
    sums = mass.times(V).arrays[0].sum(axis=0)
    np.testing.assert_allclose(sums, momentum, rtol=0, atol=1e-13 * np.abs(momentum).max())
    # and the points get them back
    back = transfer.collect(problem.here.fields[0].stencils, V)
    np.testing.assert_allclose(back, points["velocity"], rtol=0, atol=1e-10)


def test_without_a_ghost_penalty_small_cuts_spoil_it():
    for cut, worst in ((0.5, 1e-10), (1e-3, 1e-3)):
        _, V, nodes, x = mapped(block("quadrilateral", "gimp", cut, ghost_mass=0.0))
        error = np.abs(V[nodes] - affine(x)).max() / np.abs(affine(x)).max()
        assert (error < worst) == (cut == 0.5)


@pytest.mark.parametrize("rule", [mpm.Newmark, mpm.Explicit])
def test_velocities_that_a_singular_mass_makes_of_small_cuts_are_told(rule):
    def wavy(cut, **options):
        problem = block("quadrilateral", "gimp", cut, rule, mass="consistent", **options)
        problem.points["velocity"] = np.sin(3 * problem.points["x"])
        return problem

    given = {"mapping": "pic", "scheme": "usl"} if rule is mpm.Explicit else {}
    message = r"next to singular: a node has the velocity .* m/s .* give a ghost_mass above 0"
    with pytest.warns(SingularMassWarning, match=message), contextlib.suppress(DolfinMPMError):
        wavy(1e-6, ghost_mass=0.0, **given).step(1e-3)
    # sound where cuts are large, or a penalty or ties act
    wavy(0.5, ghost_mass=0.0, **given).step(1e-3)
    wavy(1e-6, **given).step(1e-3)
    wavy(1e-6, stabilisation="aggregation", **given).step(1e-3)


@pytest.mark.parametrize(
    ("options", "word"), [({"ghost_mass": 0.1}, "ghost"), ({"stabilisation": "aggregation"}, "agg")]
)
def test_advice_on_a_singular_mass_leaves_out_what_is_set(options, word):
    advice = mapped(block("quadrilateral", "gimp", 0.5, **options))[0]._advice()
    assert word not in advice
    assert 'mass="lumped", or' in advice


@pytest.mark.parametrize("stabilisation", ["none", "aggregation"])
@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_a_lumped_mass_smears_by_a_share_of_a_cell_and_keeps_momentum(basis, stabilisation):
    problem = block("quadrilateral", basis, 0.37, mass="lumped", stabilisation=stabilisation)
    mass, V, nodes, x = mapped(problem)
    # a node at the edge takes what points within its support have
    most = 1.5 * 0.1 * np.abs(GRADIENT).sum(axis=1).max()
    assert 1e-3 < np.abs(V[nodes] - affine(x)).max() < most
    points = problem.points
    momentum = masses(points) @ points["velocity"]
    np.testing.assert_allclose(mass.lumped @ V, momentum, rtol=1e-13)
    assert mass.lumped.sum() == pytest.approx(masses(points).sum(), rel=1e-13)
    assert (mass.lumped[nodes] > 0).all()


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
@pytest.mark.parametrize("stabilisation", ["aggregation", "extended"])
def test_a_lumped_mass_behind_ties_keeps_rigid_velocities_and_makes_no_energy(basis, stabilisation):
    """The edges of a box that is turned have steps; row sums behind C would make energy there."""
    grid = mesh.create_rectangle(COMM, [(-1, -1), (1, 1)], (16, 16), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((-0.5, -0.5), (0.5, 0.5)), 2, 1000.0)
    c, s = np.cos(0.25), np.sin(0.25)
    points["x"] = points["x"] @ np.array([[c, s], [-s, c]]) + (0.013, -0.021)
    points.locate()
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.3), points, V.increment, V.test)
    problem = mpm.Newmark(F, V.increment, points, mass="lumped", stabilisation=stabilisation)
    points["velocity"] = SHIFT
    mass, V, nodes, _ = mapped(problem)
    (s,), m = (field.stencils for field in problem.here.fields), mass.lumped
    M = np.zeros((len(m), len(m)))
    np.add.at(M, *((rows := transfer.mass_entries(s, masses(points)))[:2], rows[2]))
    by_sums = (M / np.sqrt(np.outer(m, m).clip(1e-300)))[np.ix_(nodes, nodes)]
    assert basis != "gimp" or np.linalg.eigvalsh(by_sums)[-1] > 1.05
    np.testing.assert_allclose(V[nodes], np.tile(SHIFT, (len(nodes), 1)), rtol=0, atol=1e-12)
    rng = np.random.default_rng(3)
    velocities = [*rng.standard_normal((20, len(points), 2)), affine(points["x"])]
    # and those that come back largest
    for _ in range(40):
        points["velocity"] = velocities[-1]
        _, V, *_ = mapped(problem)
        back = transfer.collect(problem.here.fields[0].stencils, V)
        velocities.append(back / np.abs(back).max())
    for velocity in velocities:
        points["velocity"] = velocity
        mass, V, *_ = mapped(problem)
        kinetic = masses(points) @ (velocity**2).sum(axis=1)
        assert np.sum(V * mass.times(V).arrays[0]) <= kinetic * (1 + 1e-12)
        back = transfer.collect(problem.here.fields[0].stencils, V)
        assert masses(points) @ (back**2).sum(axis=1) <= kinetic * (1 + 1e-12)


def test_the_ghost_penalty_of_the_mass_gives_nothing_to_affine_fields():
    problem = block("quadrilateral", "gimp", 1e-6, ghost_mass=0.25)
    bare = block("quadrilateral", "gimp", 1e-6, ghost_mass=0.0)
    parts = [mapped(p) for p in (problem, bare)]
    field = affine(problem.here.fields[0].basis.node_coordinates()[:, :2])
    penalty, alone = (mass.times(field).arrays[0] for mass, *_ in parts)
    np.testing.assert_allclose(penalty, alone, rtol=0, atol=1e-13 * np.abs(alone).max())
    rough = np.random.default_rng(2).random(field.shape)
    penalty, alone = (mass.times(rough).arrays[0] for mass, *_ in parts)
    assert np.abs(penalty - alone).max() > 1e-2 * np.abs(alone).max()
    np.testing.assert_allclose(penalty.sum(axis=0), alone.sum(axis=0), rtol=1e-13)


# -- and back ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mass", "mapping"),
    [*(("lumped", m) for m in OF_ANY_MASS + OF_LUMPED), *(("consistent", m) for m in OF_ANY_MASS)],
)
@pytest.mark.parametrize("basis", ["gimp", "linear"])
def test_every_mapping_keeps_momentum(basis, mass, mapping):
    def rough(x):
        return np.stack([np.sin(9 * x[0]) + 1, np.cos(7 * x[1]) - 0.3], axis=1)

    problem = disc(mpm.Newmark, basis, rough, mass=mass, mapping=mapping, tolerance=1e-12)
    start = problem.momentum()
    for _ in range(4):
        problem.step(problem.time + 0.01)
    np.testing.assert_allclose(problem.momentum(), start, rtol=0, atol=1e-13 * np.abs(start).max())


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_apic_keeps_angular_momentum_with_its_moments(basis):
    """With the midpoint rule, whose increments are those of the mean velocity."""
    given = {"basis": basis, "mass": "lumped", "rho_inf": 1.0, "tolerance": 1e-13}
    kept, lost = disc(mapping="apic", **given), disc(mapping="flip", **given)
    start = kept.angular_momentum()
    assert start == pytest.approx(angular_momentum(kept.points), rel=1e-15)
    for problem in (kept, lost):
        for _ in range(20):
            problem.step(problem.time + 0.02)
    assert kept.angular_momentum() == pytest.approx(start, rel=1e-12)
    # without the moments m (B_21 - B_12) it is not all there
    m, B = masses(kept.points), kept.points["velocity_moment"]
    own = angular_momentum(kept.points)
    assert own < 0.99 * start
    assert own + m @ (B[:, 1, 0] - B[:, 0, 1]) == pytest.approx(start, rel=1e-12)
    assert lost.angular_momentum() < 0.99 * start


def test_apic_keeps_it_in_3d():
    def tumbling(x):
        return np.cross((0.3, -0.2, 1.0), (x - 4.0).T)

    problem = disc(
        dimension=3, velocity=tumbling, mass="lumped", mapping="apic", rho_inf=1.0, tolerance=1e-13
    )
    start = problem.angular_momentum()
    assert start.shape == (3,)
    for _ in range(4):
        problem.step(problem.time + 0.05)
    np.testing.assert_allclose(problem.angular_momentum(), start, rtol=0, atol=1e-12 * start.max())


def test_pic_with_a_consistent_mass_keeps_angular_momentum_and_energy():
    """Nearly: the ghost penalty weighs the turn of the nodes, and steps are of second order."""
    given = {"mapping": "pic", "stabilisation": "ghost", "tolerance": 1e-12}
    for rho_inf, bound in ((1.0, 1e-8), (0.8, 1e-4)):
        problem = disc(rho_inf=rho_inf, **given)
        start, energy = problem.angular_momentum(), problem.energies().kinetic
        for _ in range(20):
            problem.step(problem.time + 0.02)
        assert problem.angular_momentum() == pytest.approx(start, rel=bound)
        now = problem.energies()
        assert now.kinetic + now.strain == pytest.approx(energy, rel=1e-3)


@pytest.mark.parametrize(
    ("mass", "mapping"),
    [("consistent", "pic"), ("consistent", "flip"), ("consistent", "accel"), ("lumped", "tpic")],
)
def test_a_body_that_flies_apart_is_followed_exactly(mass, mapping):
    """Nothing but its own velocity moves it: v = x / (1 + t), however it is mapped."""
    problem = disc(
        mpm.Newmark, velocity=lambda x: (x - 7.0).T * 0.1, E=1e-12, mass=mass, mapping=mapping,
        stabilisation="ghost",
    )  # fmt: skip
    points = problem.points
    if mapping == "tpic":
        points["velocity_gradient"] = 0.1 * np.eye(2)
    start = points["velocity"].copy()
    for _ in range(10):
        problem.step(problem.time + 0.4)
    np.testing.assert_allclose(points["velocity"], start, rtol=0, atol=1e-9)
    np.testing.assert_allclose(points["x"], points["x0"] + 4.0 * start, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("fused", "d"), [(True, 2), (False, 2), pytest.param(True, 3, marks=pytest.mark.long)]
)
@pytest.mark.parametrize(
    "scheme",
    [pytest.param(s, marks=[pytest.mark.long] * (s != "musl")) for s in ("usl", "usf", "musl")],
)
def test_tpic_follows_a_body_that_flies_apart_and_turns_in_explicit_steps(scheme, fused, d):
    """x = (1 + t A) X, for the gradient is that of where the points have gone."""
    kind = mesh.CellType.quadrilateral if d == 2 else mesh.CellType.hexahedron
    make = mesh.create_rectangle if d == 2 else mesh.create_box
    grid = make(COMM, [(-2,) * d, (2,) * d], (16,) * d, kind)
    box = mpm.Box((-0.47, -0.5, -0.38)[:d], (0.53, 0.41, 0.47)[:d])
    points = mpm.fill(grid, box, 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=1e-16, nu=0.0), points, V.increment, V.test)
    problem = mpm.Explicit(F, V.increment, points, mapping="tpic", scheme=scheme, fused=fused)
    assert (problem.unfused == "") == fused
    X = points["x0"]
    A = np.array([[0.8, -0.6, 0.2], [0.9, 0.3, -0.5], [-0.1, 0.4, 0.6]])[:d, :d]
    points["velocity"], points["velocity_gradient"] = X @ A.T, A
    for t in np.arange(0.1, 1.05, 0.1):
        problem.step(t)
    X = points["x0"]
    np.testing.assert_allclose(points["x"], X @ (np.eye(d) + A).T, rtol=0, atol=1e-12)
    turned = A @ np.linalg.inv(np.eye(d) + A)
    given = np.broadcast_to(turned, points["velocity_gradient"].shape)
    np.testing.assert_allclose(points["velocity_gradient"], given, rtol=0, atol=1e-11)


def test_pic_with_a_lumped_mass_does_not():
    problem = disc(
        mpm.Newmark, velocity=lambda x: (x - 7.0).T * 0.1, E=1e-12, mass="lumped", mapping="pic"
    )
    kinetic = problem.energies().kinetic
    for _ in range(10):
        problem.step(problem.time + 0.4)
    assert problem.energies().kinetic < 0.9 * kinetic
