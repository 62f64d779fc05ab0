"""Fused explicit steps of axisymmetric bodies: the same as the general ones."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm.materials import Hencky, MohrCoulomb, NeoHookean, VonMises

LONG = pytest.mark.long
HENCKY, NEO = Hencky(E=1e5, nu=0.3), NeoHookean(E=1e5, nu=0.3)
GRITTY, STEEL = MohrCoulomb(1e5, 0.3, 20, 25), VonMises(E=1e5, nu=0.3, radius=60.0)
FIELDS = ("x", "velocity", "acceleration", "F", "stress", "V", "l")


def problem(
    law=HENCKY, basis="gimp", scheme="musl", mapping="flip", strain="large", fbar=False,
    domains="stretch", body=None, power=1.0, load=None, conditions=None, fused=True, start=None,
    contact=None, **options,
):  # fmt: skip
    """A body around the axis that falls, is strained and swings."""
    lines = [np.linspace(0.0, 1.0, 9) ** power, np.linspace(-1.0, 1.0, 17)]
    grid = mpm.create_lattice(COMM, lines)
    body = body or mpm.Polygon([(0, -0.61), (0.45, -0.41), (0.61, 0), (0.4, 0.4), (0, 0.61)])
    points = mpm.fill(grid, body, 2, 1000.0, axisymmetric=True)
    V = mpm.Space(grid, basis, domains=domains)
    u, v = V.increment, V.test
    small = {"strain": strain, "fbar": fbar} if fbar or strain != "large" else {}
    F = mpm.momentum(law, points, u, v, **small)
    g = fem.Constant(grid, (0.0, -1.0))
    b = g if load is None else load(points, g)
    F -= ufl.inner(points.density * b, v) * points.dX
    if start is not None:
        mpm.set_stress(law, points, start)
    if contact is not None:
        F += contact(points, u, v)
    points.add_field("velocity", (2,), "m/s")
    r, z = points["x"].T
    points["velocity"] = np.column_stack([0.3 * r + 0.2 * r * z, -0.3 * z + 0.1 * r**2])
    bcs = mpm.rollers(V, "left")
    bcs += mpm.fixed(V, lambda x: x[1] < -0.45) if conditions is None else conditions(V)
    options = {"courant": 0.4} | options
    return mpm.Explicit(F, u, points, bcs, scheme=scheme, mapping=mapping, fused=fused, **options)


def compare(times=(0.006, 0.02, 0.04), **scene):
    """Both loops on one scene; returns the fused one."""
    one, other = (problem(fused=fused, **scene) for fused in (True, False))
    assert one.unfused == "", one.unfused
    assert other.unfused
    for t in times:
        for p in (one, other):
            p.step(t)
    a, b = (np.argsort(p.points["id"]) for p in (one, other))
    state = {"be", "elastic_strain", "J_bar", "plastic_strain"} & set(other.points.fields)
    for name in (*FIELDS, *state):
        found, expected = one.points[name][a], other.points[name][b]
        assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max(), name
    assert [r.parts for r in one.history] == [r.parts for r in other.history]
    mine, theirs = one.energies(), other.energies()
    work = max(abs(theirs.kinetic), abs(theirs.strain), abs(theirs.external))
    assert abs(mine.external - theirs.external) <= 1e-10 * work
    for name, loss in mine.losses.items():
        if name != "integrator" or scene.get("law") is not NEO:
            assert abs(loss - theirs[name]) <= 1e-10 * work, name
    # the hoop terms count
    assert np.abs(one.points["stress"][:, 2, 2]).max() > 0.0
    return one


# each scene has loops of its own, which take seconds to compile
DAILY = [
    ("gimp", "musl", "flip", {"fbar": True, "law": STEEL}),
]
MORE = [
    ("gimp", "usf", "apic", {"law": NEO, "domains": "volume"}),
    ("bspline2", "musl", "flip", {"law": GRITTY}),
    ("linear", "usl", "flip", {}),
    ("gimp", "musl", "flip", {"law": NEO}),
    ("gimp", "musl", "tpic", {"strain": "jaumann", "law": STEEL}),
    ("gimp", "usl", "pic", {"power": 1.3, "domains": "fixed"}),
    ("bspline2", "usl", "apic", {"strain": "small"}),
    ("bspline3", "musl", "flip", {"law": STEEL}),
    ("linear", "usl", "apic", {"fbar": True, "strain": "small"}),
    ("bspline2", "usf", "tpic", {"fbar": True, "strain": "jaumann"}),
    ("gimp", "musl", "flip", {"fbar": "centres", "power": 1.3}),
]
SCENES = [*DAILY, *(pytest.param(*scene, marks=LONG) for scene in MORE)]


@pytest.mark.parametrize(("basis", "scheme", "mapping", "more"), SCENES)
def test_the_same_as_general_steps(basis, scheme, mapping, more):
    compare(basis=basis, scheme=scheme, mapping=mapping, **more)


def test_a_ring_away_from_the_axis_with_its_own_loads():
    """The ring's domains end inside the grid, and forces differ from point to point."""
    compare(
        body=mpm.Box((0.28, -0.5), (0.77, 0.41)), load=lambda points, g: (1 + points.x0[0]) * g,
        start=np.diag([-1e3, -2e3, -1.5e3]), damping=0.1,
    )  # fmt: skip


def test_sides_that_move_rub_and_let_waves_out():
    def conditions(V):
        waves = {"density": 1000.0, "p_speed": 12.0, "s_speed": 6.0}
        sides = mpm.moving(V, "bottom", 1, velocity=0.1)
        sides += mpm.frictional(V, "right", friction=0.3)
        return sides + mpm.absorbing(V, "top", **waves)

    compare(body=mpm.Box((0.0, -1.0), (1.0, 1.0)), conditions=conditions)


@pytest.mark.parametrize("basis", ["gimp", pytest.param("bspline2", marks=LONG)])
def test_contact_with_a_rigid_cone(basis):
    def contact(points, u, v):
        tip = mpm.Polygon([(-1.0, 0.75), (0.0, 0.2), (1.0, 0.75)])
        body = mpm.RigidBody(tip, velocity=(0.0, -0.4), name="cone")
        return mpm.contact(body, points, u, v, penalty=5.0, friction=0.2)

    one = compare(
        body=mpm.Box((0.0, -1.0), (0.75, 0.15)), basis=basis, contact=contact,
        conditions=lambda V: mpm.fixed(V, "bottom"), times=(0.1, 0.2, 0.3),
    )  # fmt: skip
    assert one.history[-1].bodies["cone"]["force"][1] > 0.0
