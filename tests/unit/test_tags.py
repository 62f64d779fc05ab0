"""Tags in a form that match no point, and points that have a load and no law."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    ConvergenceError,
    FormError,
    IdlePointsWarning,
    ParameterError,
)

LAW = mpm.materials.Hencky(1e3, 0.3)
KINDS = (mpm.QuasiStatic, mpm.Newmark, mpm.Explicit)


def scene(law=None, load="everywhere", extra=None, kind=mpm.QuasiStatic, **options):
    """Two bodies of tags 1 and 2 in a row, under their weight; the problem is made."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 4)], (4, 4), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1.0, tag=1)
    points = points + mpm.fill(grid, mpm.Box((2, 0), (4, 1)), 2, 1.0, tag=2)
    V = mpm.Space(grid)
    u, v = V.increment, V.test
    F = mpm.momentum(LAW, points, u, v, tag=law)
    weight = points.density * fem.Constant(grid, (0.0, -1.0))
    F -= ufl.inner(weight, v) * points.dX(load)
    if extra is not None:
        F += extra(points, u, v)
    return kind(F, u, points, mpm.fixed(V, "bottom"), **options)


def take(problem):
    return problem.step(*(() if type(problem) is mpm.QuasiStatic else (0.02,)))


def on_body(points, u, v):
    return mpm.contact(mpm.RigidBody(mpm.Disc((1.0, 2.4), 0.5)), points, u, v, tag=7)


def on_wall(points, u, v):
    wall = mpm.Boundary.from_side(points, "right")
    return mpm.signorini(wall, u, v, law=LAW, tag=7)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"load": 9}, r"the term '.*density.*' is for points with tag=9, .* the tags 1, 2\. Give"),
        ({"load": (8, 9)}, r"tag=\(8, 9\), and no point has it"),
        ({"extra": on_body}, r"the contact with 'body\d+' is for points with tag=7, and no point"),
        ({"extra": on_wall}, "a term over Boundary 'right' is for points with tag=7"),
        ({"law": 9}, "no point has a law: the laws are for tag=9, .* the tags 1, 2"),
        ({"law": 9, "load": 9}, "no point has a law"),
        ({"law": 1}, r"the 8 points of tag 2 have the load '.*density.*momentum\(.*, tag=2\)"),
    ],
)  # fmt: skip
def test_what_matches_nothing_is_named_before_the_first_step(kind, given, match):
    problem = scene(kind=kind, **given)
    before = problem.points["x"].copy()
    for _ in range(2):
        with pytest.raises(FormError, match=match):
            take(problem)
    np.testing.assert_array_equal(problem.points["x"], before)


def test_a_penalty_is_no_law():
    problem = scene(law=9, load=9, stabilisation="none")
    with pytest.raises(FormError, match="no point has a law"):
        problem.step()
    problem = scene(law=9, load=9, extra=lambda p, u, v: mpm.ghost(p, u, v, 1.0))
    with pytest.raises(FormError, match="no point has a law"):
        problem.step()


def second(points, u, v):
    """A law for points that come later, and their weight."""
    return mpm.momentum(LAW, points, u, v, tag=3) + v[1] * points.dX(3)


@pytest.mark.parametrize("kind", KINDS)
def test_tags_of_laws_may_wait_for_their_points(kind):
    problem = scene(law=(1, 2), extra=second, kind=kind)
    take(problem)
    problem.points.add(mpm.fill(problem.points.grid, mpm.Box((0, 2), (2, 3)), 2, 1.0, tag=3))
    problem.step(*(() if kind is mpm.QuasiStatic else (0.04,)))


def energy(points, u, v):
    """A law of one's own in UFL, for the points of tag 2."""
    e = ufl.sym(ufl.grad(u))
    return ufl.derivative(500.0 * ufl.inner(e, e) * points.dX(2), u, v)


def traction(points, u, v):
    side = mpm.Surface(points, lambda x: np.isclose(x[0], 0), (-1, 0))
    return side.traction((1.0, 0.0), v)


@pytest.mark.parametrize("given", [
    {"load": (1, 9)},
    {"law": 1, "load": 1, "extra": energy},
    {"law": 1, "extra": energy},
])  # fmt: skip
def test_what_has_all_it_needs_goes_on(given):
    problem = scene(**given)
    take(problem)
    assert np.abs(problem.points["x"] - problem.points["x0"]).max() > 1e-5


def test_a_stress_is_set_where_points_are():
    points = scene().points
    with pytest.raises(ParameterError, match=r"tag = 9: no point has it; the points have .* 1, 2"):
        mpm.set_stress(LAW, points, -np.eye(3), tag=9)
    mpm.set_stress(LAW, points, -np.eye(3), tag=(2, 9))


def pressed(points, u, v):
    return mpm.Surface(points, lambda x: x[1] > 1.99, (0, 1)).pressure(1.0, u, v)


def under_a_footing(points, u, v):
    under = mpm.Surface(points, lambda x: x[1] > 1.99, (0, 1))
    settlement = fem.Constant(points.grid, 0.0)
    return mpm.RigidFooting(under, settlement, rough=False, E=1e3).contact(u, v)


@pytest.mark.parametrize("extra", [pressed, under_a_footing])
def test_faces_resist_nothing_elsewhere(extra):
    with pytest.raises(FormError, match="the 8 points of tag 2 have the load"):
        take(scene(law=1, extra=extra))


@pytest.mark.parametrize("kind", KINDS)
def test_points_without_a_law_are_told_once(kind):
    # points that are only looked at, and a load on faces that they do not have
    options = {} if kind is mpm.Explicit else {"stabilisation": "ghost", "max_halvings": 0}
    problem = scene(law=1, load=1, extra=traction, kind=kind, **options)
    told = pytest.warns(IdlePointsWarning, match=r"the 8 points of tag 2 have no law, .*tag=2\)")
    # nothing holds them in steps without time
    fails = ConvergenceError if kind is mpm.QuasiStatic else ()
    with told, contextlib.suppress(fails):
        take(problem)
    problem.points["tag"][:] = 1
    problem.step(*(() if kind is mpm.QuasiStatic else (0.04,)))
    assert np.abs(problem.points["x"] - problem.points["x0"]).max() > 1e-5


@pytest.mark.parametrize("tag", [None, 1])
def test_a_pressure_belongs_to_wet_points(tag):
    grid = mpm.create_lattice(COMM, [np.arange(5.0)] * 2)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), 2, 2000.0, tag=1)
    points = points + mpm.fill(grid, mpm.Box((0, 2), (4, 4)), 2, 2000.0, tag=2)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=(), tag=tag)
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    water = {"permeability": 1e-6, "porosity": 0.4, "tag": 1}
    F = mpm.poromechanics(LAW, points, fields, tests, **water)
    F += mpm.momentum(LAW, points, V.increment, V.test, tag=2)
    bcs = mpm.fixed(V, "bottom") + mpm.fixed(Q, "bottom")
    problem = mpm.Transient(F, fields, points, bcs, max_halvings=0)
    if tag is not None:
        problem.step(1.0)
        return
    told = pytest.warns(IdlePointsWarning, match="the 32 points of tag 2 have no term of field 2")
    with told, contextlib.suppress(ConvergenceError):
        problem.step(1.0)
