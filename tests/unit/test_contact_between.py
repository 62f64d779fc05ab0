"""Fields of tags, and contact of the bodies that they move."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import Linearised
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import two_blocks

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError

NAMES = "x", "F", "stress", "l"


def moved(which, kind, stabilisation, basis, fbar=False):
    """Blocks that move each by itself, with fields of their own or alone; states by tag."""
    comm = MPI.COMM_WORLD
    grid = mesh.create_rectangle(comm, [(0, 0), (4, 4)], (8, 8), mesh.CellType.quadrilateral)
    parts = {
        1: mpm.fill(grid, mpm.Box((0.3, 0), (3.1, 1.3)), 2, 1.0, tag=1),
        2: mpm.fill(grid, mpm.Box((0.7, 1.3), (2.6, 4)), 3, 2.0, tag=2),
    }
    laws = {1: mpm.materials.Hencky(E=1e3, nu=0.3), 2: mpm.materials.Hencky(E=5e3, nu=0.2)}
    points = parts[which[0]] if len(which) == 1 else parts[1] + parts[2]
    F, increments, bcs = 0, [], []
    for k in which:
        tag = k if len(which) > 1 else None
        V = mpm.Space(grid, basis, tag=tag)
        F += mpm.momentum(laws[k], points, V.increment, V.test, fbar=fbar)
        F -= ufl.dot(points.density * ufl.as_vector((30.0 * k, -20.0)), V.test) * points.dX
        increments.append(V.increment)
        bcs += mpm.fixed(V, "bottom" if k == 1 else "top")
    problem = kind(F, increments, points, bcs, stabilisation=stabilisation, tolerance=1e-12)
    names = NAMES if kind is mpm.QuasiStatic else (*NAMES, "velocity")
    for k in range(2):
        problem.step(*([] if kind is mpm.QuasiStatic else [0.01 * (k + 1)]))
    return {k: {name: points[name][points["tag"] == k] for name in names} for k in which}


LONG = pytest.mark.long


@pytest.mark.parametrize(
    ("kind", "stabilisation", "basis"),
    [
        (mpm.QuasiStatic, "ghost", "gimp"),
        pytest.param(mpm.QuasiStatic, "aggregation", "bspline2", marks=LONG),
        pytest.param(mpm.QuasiStatic, "weak-aggregation", "linear", marks=LONG),
        pytest.param(mpm.Newmark, "ghost", "gimp", marks=LONG),
        pytest.param(mpm.Newmark, "ghost", "bspline2", marks=LONG),
        pytest.param(mpm.Newmark, "aggregation", "gimp", marks=LONG),
        pytest.param(mpm.GeneralisedAlpha, "ghost", "gimp", marks=LONG),
    ],
)
def test_two_fields_of_tags_are_two_problems(kind, stabilisation, basis):
    both = moved((1, 2), kind, stabilisation, basis)
    for k in (1, 2):
        for name, expected in moved((k,), kind, stabilisation, basis)[k].items():
            scale = np.abs(expected).max()
            np.testing.assert_allclose(both[k][name], expected, atol=1e-10 * scale, err_msg=name)


def pressed(friction=0.3, basis="gimp", stabilisation="ghost", **options):
    """The upper block is pressed onto the lower one and drawn aside."""
    points, (low, up), F, _ = two_blocks(friction, basis, top=3.0, **options)
    down, aside = (fem.Constant(points.grid, 0.0) for _ in "ab")
    bcs = mpm.fixed(low, "bottom") + mpm.prescribed(up, "top", 1, increment=down)
    bcs += mpm.prescribed(up, "top", 0, increment=aside)
    u = [low.increment, up.increment]
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation)
    down.value, aside.value = -0.02, 0.03
    return problem


@pytest.mark.parametrize(
    ("friction", "basis", "stabilisation"),
    [
        (0.3, "gimp", "ghost"),
        pytest.param(0.0, "gimp", "ghost", marks=LONG),
        pytest.param(0.3, "bspline2", "aggregation", marks=LONG),
        pytest.param(0.3, "linear", "ghost", marks=LONG),
    ],
)
def test_the_tangent_of_two_bodies(friction, basis, stabilisation):
    problem = pressed(friction, basis, stabilisation)
    record = problem.step()
    assert record.halvings == 0
    force = record.bodies[problem.form.parts.terms[0].name]["force"]
    assert force[1] > 10.0
    # friction pulls back by no more than Coulomb's law allows
    assert abs(force[0]) <= (friction + 1e-4) * force[1]
    assert problem.newton.linear.method.pc == ("lu" if friction else "cholesky")
    linearised = Linearised(problem)
    rng = np.random.default_rng(3)
    start = rng.uniform(-1e-3, 1e-3, linearised.size)
    linearised.tangent(start)
    assert sum(linearised.operator.active(problem.form.parts.terms[0]).count) > 4
    way, t = rng.uniform(-1, 1, linearised.size), 1e-7
    exact, residual = linearised.product(way), linearised.residual
    numerical = (residual(start + t * way) - residual(start - t * way)) / (2 * t)
    np.testing.assert_allclose(exact, numerical, atol=2e-6 * np.abs(exact).max())


@pytest.mark.long
@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_each_body_has_means_of_its_own(basis):
    """F-bar in cells that points of both bodies are in."""
    both = moved((1, 2), mpm.QuasiStatic, "ghost", basis, True)
    for k in (1, 2):
        for name, expected in moved((k,), mpm.QuasiStatic, "ghost", basis, True)[k].items():
            scale = np.abs(expected).max()
            np.testing.assert_allclose(both[k][name], expected, atol=1e-10 * scale, err_msg=name)


def test_a_step_that_fails_leaves_the_slip_as_it_was():
    problem = pressed()
    problem.step()
    (contact,) = problem.form.parts.terms
    points, markers = problem.points, contact.boundaries[0].markers
    before = [{n: a.copy() for n, a in one.fields.items()} for one in (points, markers)]
    assert np.abs(markers[contact.names.tangential_force]).max() > 0
    assert contact.dissipated > 0
    problem.newton.max_iterations, problem.max_halvings = 1, 1
    problem.newton.tolerance = 1e-13
    with pytest.raises(mpm.errors.ConvergenceError):
        problem.step()
    for one, kept in zip((points, markers), before):
        for name, values in kept.items():
            np.testing.assert_array_equal(one[name], values, err_msg=name)
    problem.newton.max_iterations, problem.newton.tolerance = 20, 1e-9
    problem.step()


@pytest.mark.long
def test_multipliers_bound_the_penetration():
    deepest = []
    for bound in (None, 2e-4):
        problem = pressed(0.0, penalty=2.0, penetration=bound)
        problem.step()
        (contact,) = problem.form.parts.terms
        deepest.append(-problem.operator().active(contact).pairs.gap.min())
    assert deepest[0] > 3e-3
    # the next step measures the gap anew, between surfaces that have bent
    assert deepest[1] < 1.2 * 2e-4


def test_a_boundary_without_its_body_is_named():
    """A removed body; the problem goes on when it is back."""
    problem = pressed()
    problem.step()
    points = problem.points
    points.remove(tag=2)
    with pytest.raises(ParameterError, match=r"no point has the tags 2 .*Boundary '.*' follows"):
        problem.step()
    box = mpm.Box((0.4, 1.3), (2.5, 3.0))
    points.add(mpm.fill(points.grid, box, 3, 1.0, tag=2, aligned="body"))
    assert problem.step().halvings == 0


def test_a_step_beyond_a_cell_is_halved():
    problem = pressed(0.0)
    problem.bcs[-1].value.value = 0.8
    assert problem.step().halvings == 1


def test_what_cannot_be_two_bodies_is_named():
    points, (low, up), F, (upper, lower) = two_blocks()
    grid, u, v = points.grid, (low.increment, up.increment), (low.test, up.test)
    both, tests = (upper, lower), v[::-1]

    def refused(words, *arguments, **options):
        with pytest.raises(ParameterError, match=words):
            mpm.contact_between(*arguments, **options)

    refused("must be two", (upper,), u, v)
    refused("must be two", both, u[0], v)
    refused("two boundaries, each of a body", (upper, upper), u, v)
    refused("no mpm.Boundary", (upper, mpm.Plane((0, 0), (0, 1))), u, v)
    wall = mpm.Boundary.from_side(points, "bottom")
    refused("follow", (upper, wall), u, v)
    refused("fields of their own", both, (u[0], u[0]), (v[0], v[0]))
    whole = mpm.Space(grid, "gimp")
    refused("fields of their own", both, (u[1], whole.increment), (v[1], whole.test))
    refused("in their order", both, u[::-1], v)
    refused("friction", both, u[::-1], tests, friction=-0.1)
    refused("penetration", both, u[::-1], tests, penetration=0.0)
    with pytest.raises(ParameterError, match="tag = -1"):
        mpm.Space(grid, "gimp", tag=-1)
    second = mpm.contact_between(both[::-1], u, tests[::-1])
    with pytest.raises(FormError, match="twice, and the bodies would feel"):
        mpm.QuasiStatic(F + second, u, points)
    with pytest.raises(FormError, match="does not solve for"):
        mpm.QuasiStatic(F, u[0], points)
    law = mpm.materials.Hencky(E=1.0, nu=0.0)
    own = mpm.momentum(law, points, u[0], v[0], tag=1)
    with pytest.raises(ParameterError, match="moved by no field"):
        mpm.QuasiStatic(own, u[0], points)
    with pytest.raises(ParameterError, match="moved by no field"):
        mpm.Explicit(own, u[0], points)
    again = mpm.Space(grid, "gimp", tag=(1, 2))
    second = mpm.momentum(law, points, again.increment, again.test, tag=2)
    with pytest.raises(ParameterError, match="both move the points of tag 1"):
        mpm.QuasiStatic(own + second, [u[0], again.increment], points)
    whole_tags = mpm.Space(grid, "gimp", tag=(1, 2))
    F = mpm.momentum(law, points, whole_tags.increment, whole_tags.test)
    with pytest.raises(ParameterError, match="Explicit has one field"):
        mpm.Explicit(F, whole_tags.increment, points)
    total = [mpm.Space(grid, "gimp", tag=k, configuration="total") for k in (1, 2)]
    w, t = [V.increment for V in total], [V.test for V in total]
    F = sum(mpm.momentum(law, points, w[k], t[k], tag=k + 1) for k in (0, 1))
    F += mpm.contact_between(both, w[::-1], t[::-1])
    with pytest.raises(ParameterError, match="updated"):
        mpm.QuasiStatic(F, w, points)


def test_bodies_that_overlap_at_first_are_refused():
    points, (low, up), F, (upper, _) = two_blocks()
    upper.markers["x"] = upper.markers["x"] - [0.0, 0.01]
    problem = mpm.QuasiStatic(
        F, [low.increment, up.increment], points, mpm.fixed(low, "bottom"), stabilisation="ghost"
    )
    with pytest.raises(ParameterError, match="overlap before the first step"):
        problem.step()


def test_boundaries_of_the_wrong_body_are_refused():
    points, (low, up), F, boundaries = two_blocks()
    increments, tests = [low.increment, up.increment], [low.test, up.test]
    law = mpm.materials.Hencky(E=1e3, nu=0.2)
    F = sum(mpm.momentum(law, points, *both) for both in zip(increments, tests))
    F += mpm.contact_between(boundaries, increments, tests)
    problem = mpm.QuasiStatic(F, increments, points, mpm.fixed(low, "bottom"))
    with pytest.raises(ParameterError, match="in front of 9 of 9 of its markers"):
        problem.step()


@pytest.mark.long
def test_a_rigid_body_touches_one_of_two_bodies():
    """A plane carries the lower block, and with it the upper one, which it does not see."""
    points, (low, up), F, _ = two_blocks(0.2)
    low_form = mpm.contact(
        mpm.RigidBody(mpm.Plane((0, 1e-4), (0, 1)), name="floor"), points, low.increment, low.test,
        friction=0.3, penalty=100.0,
    )  # fmt: skip
    g = ufl.as_vector((0.0, -10.0))
    F += low_form - sum(ufl.dot(g, V.test) * points.dX for V in (low, up))
    bcs = mpm.rollers(low, "left")
    increments = [low.increment, up.increment]
    record = mpm.QuasiStatic(F, increments, points, bcs, stabilisation="ghost").step()
    upper, lower = 10.0 * 2.1 * 1.15, 10.0 * 3.0 * 1.3
    forces = record.bodies["floor"]["force"], record.bodies["contact1"]["force"]
    assert forces[0][1] == pytest.approx(-upper - lower, rel=1e-8)
    assert forces[1][1] == pytest.approx(upper, rel=1e-8)


def test_boundaries_have_the_force_of_the_touching_body():
    comm = MPI.COMM_WORLD
    grid = mpm.create_lattice(comm, [np.arange(0, 4.1, 0.5), np.arange(0, 3.1, 0.5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 1)), 2, 2000.0, tag=1)
    points = points + mpm.fill(grid, mpm.Box((1, 1), (3, 2)), 2, 2000.0, tag=2)
    A, B = mpm.Space(grid, "gimp", tag=1), mpm.Space(grid, "gimp", tag=2)
    top, bottom = (
        mpm.Boundary.from_polygon(points, ends, closed=False, rule=1, spacing=0.125)
        for ends in ([(4, 1), (0, 1)], [(1, 1), (3, 1)])
    )
    law, F = mpm.materials.Hencky(1e7, 0.2), 0
    for space, tag in ((A, 1), (B, 2)):
        F += mpm.momentum(law, points, space.increment, space.test, tag=tag)
    # its weight, and a push to the side that friction holds
    load = ufl.as_vector([2.0, -10.0])
    F -= ufl.inner(points.density * load, B.test) * points.dX(2)
    fields, tests = (B.increment, A.increment), (B.test, A.test)
    F += mpm.contact_between((bottom, top), fields, tests, friction=0.5)
    problem = mpm.QuasiStatic(
        F, [A.increment, B.increment], points, mpm.fixed(A, "bottom"), stabilisation=["ghost"] * 2
    )
    assert bottom.force() == pytest.approx([0.0, 0.0])
    problem.step()
    assert bottom.force() == pytest.approx([-8000.0, 40000.0], rel=1e-7)
    assert top.force() == pytest.approx([8000.0, -40000.0], rel=1e-7)
