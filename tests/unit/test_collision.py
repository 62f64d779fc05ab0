"""Bodies that collide at the nodes: what they exchange there, and what they are asked in vain."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM, unit_grid

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.dynamics.collision import BodyAtNodes, NodalContact


def at_nodes(n=200, d=3):
    """Two bodies with anything at their nodes, some of which only one of them has."""
    rng = np.random.default_rng(0)
    bodies = []
    for k in range(2):
        mass = rng.uniform(0.1, 2.0, n)
        mass[k * 20 : (k + 1) * 20] = 0.0
        bodies.append(BodyAtNodes(mass, rng.uniform(0.2, 0.9, n), rng.normal(size=(n, d))))
    return bodies, [rng.normal(size=(n, d)) for _ in bodies]


@pytest.mark.parametrize("friction", [0.0, 0.3, 10.0])
@pytest.mark.parametrize("room", [None, 1.0])
def test_momentum_is_kept_and_bodies_come_no_nearer(friction, room):
    bodies, v = at_nodes()
    before = [one.copy() for one in v]
    room = None if room is None else np.full(len(v[0]), room)
    touching = NodalContact(bodies, room, friction)
    touching.exchange(v)
    got = touching.received
    m = [b.mass[:, None] for b in bodies]
    total = m[0] * v[0] + m[1] * v[1]
    np.testing.assert_allclose(total, m[0] * before[0] + m[1] * before[1], atol=1e-13)
    np.testing.assert_allclose(got, m[0] * (v[0] - before[0]), atol=1e-13)
    both = (bodies[0].mass > 0) & (bodies[1].mass > 0)
    share = [b.slope * (b.volume / np.where(both, b.mass, 1.0))[:, None] for b in bodies]
    n = share[0] - share[1]
    n /= np.linalg.norm(n, axis=1)[:, None]
    if room is not None:
        both &= bodies[0].volume + bodies[1].volume >= 0.98
        assert 20 < both.sum() < 140
    nearing = np.sum((before[0] - before[1]) * n, axis=1)
    touch = both & (nearing > 0)
    w = v[0] - v[1]
    np.testing.assert_allclose(np.sum(w * n, axis=1)[touch], 0.0, atol=1e-12)
    for one, first in zip(v, before):
        np.testing.assert_array_equal(one[~touch], first[~touch])
    # friction takes of the slip what the normal impulse allows, and no more than all of it
    slip = before[0] - before[1]
    slip -= np.sum(slip * n, axis=1)[:, None] * n
    size = np.linalg.norm(slip, axis=1)
    left = np.maximum(size - friction * np.maximum(nearing, 0), 0)
    np.testing.assert_allclose(np.linalg.norm(w, axis=1)[touch], left[touch], atol=1e-12)


def blocks(kind="quadrilateral", basis="gimp", fbar=False, extra=None, tags=(1, 2), **options):
    grid = unit_grid(kind, 8)
    points = mpm.fill(grid, mpm.Box((0.1, 0.1), (0.5, 0.6)), 2, 1000.0, tag=1)
    points += mpm.fill(grid, mpm.Box((0.5, 0.1), (0.9, 0.6)), 2, 1000.0, tag=2)
    V = mpm.Space(grid, basis)
    law = mpm.materials.Hencky(E=1e5, nu=0.2)
    F = mpm.momentum(law, points, V.increment, V.test, fbar=fbar)
    if extra is not None:
        F += extra(points, V.increment, V.test)
    return mpm.Explicit(F, V.increment, points, collision=mpm.Collision(tags), **options)


def following_pressure(points, u, v):
    return 10.0 * ufl.det(ufl.Identity(2) + ufl.grad(u)) * ufl.div(v) * points.dX


def load_over_cells(points, u, v):
    return 10.0 * v[1] * ufl.dx


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (lambda: mpm.Collision((1,)), ParameterError, "two bodies"),
        (lambda: mpm.Collision((1, 1)), ParameterError, "two of them"),
        (lambda: mpm.Collision((1, "two")), ParameterError, "must be the tags"),
        (lambda: mpm.Collision(2), ParameterError, "must be the tags"),
        (lambda: mpm.Collision(friction=-0.1), ParameterError, "friction"),
        (lambda: blocks(mapping="apic"), ParameterError, "flip"),
        (lambda: blocks(mass="consistent"), ParameterError, "lumped"),
        (lambda: blocks(scheme="usf"), ParameterError, "musl"),
        (lambda: blocks(bulk_viscosity=(0.06, 1.2)), ParameterError, "viscosity"),
        (lambda: blocks(stabilisation="aggregation"), ParameterError, "tie nodes"),
        (lambda: blocks(fbar=True), FormError, "F-bar"),
        (lambda: blocks("triangle", "linear"), ParameterError, "rectangular"),
        (lambda: blocks(extra=following_pressure), FormError, "internal forces"),
        (lambda: blocks(extra=load_over_cells), FormError, "loads on the points"),
        (lambda: blocks(tags=(1, 2, 3)).step(1e-3), ParameterError, "no point has the tag 3"),
        (lambda: blocks(tags=((1, 2), (4, 5))).step(1e-3), ParameterError, "4, 5"),
        (lambda: blocks(tags=(1, 2)).step(-1.0), ParameterError, "later"),
    ],
)
def test_what_does_not_collide(make, error, text):
    with pytest.raises(error, match=text):
        make()


def test_neither_a_rigid_body_nor_anything_else_is_a_collision():
    body = mpm.RigidBody(mpm.Plane((0, 0.05), (0, 1)))
    with pytest.raises(FormError, match="rigid bodies"):
        blocks(extra=lambda points, u, v: mpm.contact(body, points, u, v))
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.2), points, V.increment, V.test)
    with pytest.raises(ParameterError, match="Collision"):
        mpm.Explicit(F, V.increment, points, collision=(1, 2))
    np.testing.assert_array_equal(mpm.Explicit(F, V.increment, points).collision_force, 0.0)


def between_walls(contact=(1, 2), sides=(), velocity=0.0, third=None, **options):
    """Two blocks that fill the width of a grid, of which one or both sides act on them."""
    grid = unit_grid("quadrilateral", 8)
    points = mpm.fill(grid, mpm.Box((0, 0), (0.5, 0.5)), 2, 1000.0, tag=1)
    points += mpm.fill(grid, mpm.Box((0.5, 0), (1, 0.5)), 2, 1000.0, tag=2)
    if third is not None:
        points += mpm.fill(grid, third, 2, 1000.0, tag=3)
    V = mpm.Space(grid, "gimp")
    law = mpm.materials.Hencky(E=1e5, nu=0.2)
    F = mpm.momentum(law, points, V.increment, V.test)
    bcs = [*mpm.rollers(V, "bottom"), *sides(V)]
    if contact:
        options["collision"] = mpm.Collision(contact)
    problem = mpm.Explicit(F, V.increment, points, bcs, **options)
    points["velocity"][:, 0] = velocity
    return problem


@pytest.mark.parametrize("scheme", ["musl", "usl"])
@pytest.mark.parametrize("contact", [(1, 2), None])
def test_what_moves_a_wall_does_work(scheme, contact):
    """A wall pushes two blocks against another: the energy that they have is its work."""

    def sides(V):
        return [*mpm.moving(V, "left", 0, velocity=0.5), *mpm.rollers(V, "right")]

    problem = between_walls(contact, sides, scheme=scheme)
    problem.step(0.1)
    energies = problem.energies()
    assert energies.external > 20.0
    assert energies.kinetic + energies.strain == pytest.approx(energies.external, rel=0.05)
    if contact:
        # the one that is pushed pushes back
        assert problem.collision_force[0] < -100.0


def test_dashpots_slow_what_collides_as_what_does_not():
    """Both blocks are one of two bodies, and go against a side as they do without the other."""

    def sides(V):
        return mpm.absorbing(V, "right", density=1000.0, p_speed=10.0)

    found = []
    for contact in (((1, 2), 3), None):
        problem = between_walls(contact, sides, 0.5, mpm.Box((0.25, 0.75), (0.5, 1.0)))
        problem.step(0.05)
        # fused steps keep points in another order
        order = np.lexsort(problem.points["x0"].T)
        found.append(problem.points["velocity"][order])
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-12)
    assert found[0][:, 0].min() < 0.2
    assert found[0][:, 0].max() == pytest.approx(0.5)


def thrown(boxes, velocities, sides=(), friction=0.0, gravity=0.0, contact=True, **options):
    """Boxes with velocities of their own in explicit steps."""
    grid = mpm.create_lattice(COMM, [np.linspace(0.0, 3.0, 25), np.linspace(0.0, 1.5, 13)])
    parts = [mpm.fill(grid, box, 2, 1000.0, tag=k) for k, box in enumerate(boxes, 1)]
    points = sum(parts[1:], parts[0])
    V = mpm.Space(grid, "gimp")
    law = mpm.materials.Hencky(E=1e6, nu=0.0)
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -gravity)), V.test) * points.dX
    points.add_field("velocity", (2,), "m/s")
    for k, v in enumerate(velocities, 1):
        points["velocity"][points["tag"] == k] = v
    if contact:
        options["collision"] = mpm.Collision((1, 2), friction=friction)
    faces = sides(V) if sides else ()
    return mpm.Explicit(F, V.increment, points, faces, fused=False, **options)


@pytest.mark.parametrize("scheme", ["musl", "usl"])
@pytest.mark.parametrize("mu", [0.0, 0.2])
def test_boxes_that_slide_apart_are_as_those_of_one_field(scheme, mu):
    """Sides rub bodies that could collide as bodies that could not, with the same account."""
    boxes = [mpm.Box((0.5, 0), (1.0, 0.5)), mpm.Box((2.0, 0), (2.5, 0.5))]
    found, momenta = [], []
    for contact in (True, False):
        problem = thrown(
            boxes, [(2, 0), (2, 0)], lambda V: mpm.frictional(V, "bottom", friction=mu),
            gravity=10.0, contact=contact, scheme=scheme,
        )  # fmt: skip
        pushed = 0.1 - 0.5 * problem.step(0.1).dt  # velocities are half a step behind
        e = problem.energies()
        found.append([e.kinetic, e.strain, e.external, *e.losses.values()])
        momenta.append(problem.momentum())
        # Coulomb's law, with the impulse of the bottom
        lost = mu * (500.0 * 10.0 * pushed + momenta[-1][1])
        assert momenta[-1][0] == pytest.approx(1000.0 - lost, abs=1e-9)
        assert e["integrator"] > -1e-9
        assert e["integrator"] < 0.02 * max(e["friction"], 1e2)
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(momenta[0], momenta[1], rtol=0, atol=1e-9)


def test_points_of_no_body_are_told():
    problem = blocks(tags=(1, 2))
    problem.points["tag"][0] = 3
    with pytest.raises(ParameterError, match="belong to no body"):
        problem.step(1e-3)


def test_infinite_friction_sticks():
    """As a large one does; it had made impulses that are no numbers."""
    found = []
    for mu in (np.inf, 1e3):
        bodies, v = at_nodes()
        v[0][150:] = v[1][150:]
        NodalContact(bodies, None, mu).exchange(v)
        found.append(v)
    np.testing.assert_array_equal(found[0], found[1])


def test_energy_taken_by_an_impact_has_names():
    """Friction, impact, local damping and absorbing sides; little is left for the steps."""
    boxes = [mpm.Box((0.5, 0.5), (1.0, 1.0)), mpm.Box((1.0, 0.5), (1.75, 1.0))]
    problem = thrown(boxes, [(1, 0.3), (-1, 0)], friction=0.3)
    problem.step(0.08)
    e = problem.energies()
    assert e["friction"] > 0.5
    assert e["collision"] > 0.1 * e.initial
    assert abs(e["integrator"]) < 2e-3 * e.initial
    problem = thrown(boxes, [(1, 0.3), (-1, 0)], damping=0.2, courant=0.2)
    problem.step(0.08)
    e = problem.energies()
    assert e["damping"] > 0.5 * e.initial
    assert abs(e["integrator"]) < 0.02 * e.initial
    boxes = [mpm.Box((2.0, 0.5), (2.5, 1.0)), mpm.Box((2.5, 0.5), (3.0, 1.0))]
    problem = thrown(
        boxes, [(1, 0), (1, 0)], courant=0.2,
        sides=lambda V: mpm.absorbing(V, "right", density=1000.0, p_speed=30.0),
    )  # fmt: skip
    problem.step(0.03)
    e = problem.energies()
    assert e["damping"] > 0.4 * e.initial
    assert abs(e["integrator"]) < 0.02 * e.initial


@pytest.mark.parametrize("friction", [0.0, 0.3, 10.0])
def test_exchanges_take_what_the_bodies_lose(friction):
    """Kinetic energy at the nodes before less that after, of which friction has its share."""
    bodies, v = at_nodes()
    before = [one.copy() for one in v]
    touching = NodalContact(bodies, None, friction)
    touching.exchange(v)
    kinetic = [
        sum(0.5 * float(body.mass @ np.sum(V**2, axis=1)) for body, V in zip(bodies, both))
        for both in (before, v)
    ]
    rubbed, lost = touching.losses(before, v, 1.0, slice(None))
    assert rubbed + lost == pytest.approx(kinetic[0] - kinetic[1], rel=1e-12)
    # what sticks does not slip
    assert rubbed == 0.0 if friction == 0.0 else rubbed > 0.0
    rows = np.arange(len(v[0]))
    halves = [touching.losses(before, v, 1.0, own) for own in (rows[:90], rows[90:])]
    np.testing.assert_allclose(np.sum(halves, axis=0), (rubbed, lost), rtol=1e-12)
