"""Rigid bodies: their surfaces, poses, the law of contact, and its tangent."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM, Linearised, unit_grid
from contactscenes import compressed
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm.contact.bodymotion import Pose, rotation_of
from dolfinmpm.contact.contactlaw import FREE, SHEARS, SLIPS, STICKS, contact_forces
from dolfinmpm.contact.shapesurface import surface_of
from dolfinmpm.grid.lattice import smallest_height
from dolfinmpm.solve.freebodies import FreeBodies

L_SHAPE = [(0, 0), (2, 0), (2, 2), (1, 0.5), (0, 2)]


@pytest.mark.parametrize(
    ("shape", "fillet", "low", "high"),
    [
        (mpm.Plane((0, 0, 1), (0, 1, 1)), 0.0, (-1, -1, -1), (1, 1, 3)),
        (mpm.Disc((0.2, 0.1), 1), 0.0, (-2, -2), (2, 2)),
        (mpm.Polygon(L_SHAPE), 0.0, (-1, -1), (3, 3)),
        (mpm.Polygon(L_SHAPE[::-1]), 0.1, (-1, -1), (3, 3)),
        (mpm.Wedge((0, 0), 30.0, 1), 0.05, (-1, -1), (1, 2)),
        (mpm.TurnedBox((0, 0, 0), (1, 2, 3), 17.0), 0.0, (-1, -1, -1), (2, 3, 4)),
        (mpm.Box((0, 0, 0), (1, 2, 3)), 0.2, (-1, -1, -1), (2, 3, 4)),
        (mpm.Cone((0, 0, 0), 0.4, 30.0, 2, axis=(1, 1, 1)), 0.0, (-1, -1, -1), (2, 2, 2)),
        (mpm.Cone((0, 0, 0), 0.4, 30.0, 2), 0.05, (-1, -1, -1), (1, 1, 3)),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, mpm.Shape) else None,
)
def test_normal_and_curvature_are_derivatives_of_the_gap(shape, fillet, low, high):
    surface = surface_of(shape, fillet)
    d = surface.gdim
    x = np.random.default_rng(0).uniform(low, high, (1000, d))
    g, n, H = surface.probe(x)
    steps = 1e-6 * np.eye(d)
    sides = [(surface.probe(x + s), surface.probe(x - s)) for s in steps]
    slope = np.stack([(a[0] - b[0]) / 2e-6 for a, b in sides], axis=1)
    bend = np.stack([(a[1] - b[1]) / 2e-6 for a, b in sides], axis=2)
    # but where the nearest facet changes within the difference
    smooth = np.abs(slope - n).max(axis=1) < 1e-6
    assert smooth.mean() > 0.99
    scale = 1 + np.abs(H).max(axis=(1, 2))
    assert (np.abs(bend - H).max(axis=(1, 2)) < 1e-5 * scale**2)[smooth].mean() > 0.99
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, rtol=1e-12)
    # a rounded body is within its shape
    inside = shape.contains(x)
    assert np.all(inside[g < -1e-12])
    assert fillet or np.array_equal(inside, g < 0)
    outline = surface.outline(np.array(low, float), np.array(high, float))
    assert outline.shape[1:] == (d, d)
    # where a rounded edge is concave, what draws it ends within
    assert surface.probe(outline.reshape(-1, d))[0].max() < 0.06


def test_a_fillet_that_does_not_fit_is_refused():
    with pytest.raises(mpm.errors.ParameterError, match="whole edge"):
        surface_of(mpm.Wedge((0, 0), 30.0, 1), 0.5)
    with pytest.raises(mpm.errors.ParameterError, match="half of the box"):
        surface_of(mpm.Box((0, 0), (1, 2)), 0.5)


def test_poses_go_back_and_forth():
    rng = np.random.default_rng(1)
    for d, turn in ((2, np.array([0.3])), (3, np.array([0.3, -0.2, 0.9]))):
        pose = Pose.first(rng.uniform(size=d)).moved(rng.uniform(size=d), turn)
        pose = pose.moved(np.zeros(d), turn)
        x = rng.uniform(size=(5, d))
        np.testing.assert_allclose(pose.back(pose.forth(x)), x, atol=1e-14)
        np.testing.assert_allclose(pose.rotation, rotation_of(2 * turn, d), atol=1e-14)
        np.testing.assert_allclose(pose.turn, 2 * turn)


@pytest.mark.parametrize(
    ("friction", "limit"), [(0.0, np.inf), (0.3, np.inf), (2.0, np.inf), (0.3, 0.1), (5.0, 0.2)]
)
def test_contact_forces_have_their_derivative(friction, limit):
    """Of a curved surface, in all three states, with and without multipliers."""
    rng, m = np.random.default_rng(2), 200
    surface = surface_of(mpm.Ball((0, 0, 0), 1.0), 0.0)
    start = rng.normal(size=(m, 3))
    start *= rng.uniform(0.97, 1.02, (m, 1)) / np.linalg.norm(start, axis=1)[:, None]
    at = start + rng.uniform(-0.02, 0.02, (m, 3))
    eN, eT = rng.uniform(50, 100, m), rng.uniform(20, 50, m)
    before = rng.uniform(-0.3, 0.3, (m, 3))
    held = np.zeros(m, bool)
    multiplier = np.where(rng.uniform(size=m) > 0.5, 0.4, 0.0)
    limits = np.full(m, limit)
    water = np.where(rng.uniform(size=m) > 0.5, rng.uniform(-0.1, 0.5, m), 0.0)

    def forces(x):
        out = [np.empty((m, 3)), np.empty((m, 3)), np.empty(m), np.empty((m, 3, 3))]
        state = np.empty(m, np.int8)
        contact_forces(
            *surface.probe(x), x, start, before, multiplier, eN, eT, friction, limits, water, held,
            *out, state,
        )  # fmt: skip
        return *out, state

    _, traction, pressure, slope, state = forces(at)
    slips, shears = state == SLIPS, state == SHEARS
    assert {FREE, STICKS} <= set(state)
    assert (slips | shears).any() == (friction > 0)
    assert shears.any() == (limit < np.inf)
    sizes = np.linalg.norm(traction, axis=1)
    np.testing.assert_allclose(sizes[shears], limit, rtol=1e-12)
    rubs = friction * np.maximum(pressure - water, 0.0)
    assert (friction == 0.0) or (rubs[slips] == 0.0).any()
    np.testing.assert_allclose(sizes[slips], rubs[slips], rtol=1e-12)
    steps = 1e-6 * np.eye(3)
    numeric = np.stack([(forces(at + s)[0] - forces(at - s)[0]) / 2e-6 for s in steps], axis=2)
    same = np.all([forces(at + s)[-1] == state for s in (*steps, *-steps)], axis=0)
    assert same.mean() > 0.9
    np.testing.assert_allclose(slope[same], numeric[same], atol=2e-5)
    bound = np.minimum(rubs, limit) * (1 + 1e-12)
    assert np.all(sizes <= bound)
    np.testing.assert_allclose(np.sum(traction * surface.probe(at)[1], axis=1), 0, atol=1e-12)


def pressed(basis="gimp", d=2, friction=0.3, kind=None, **options):
    """A problem of a block that a body has been pressed into, aslant."""
    grid = unit_grid(kind or ("quadrilateral" if d == 2 else "hexahedron"), 3)
    points = mpm.fill(grid, mpm.Box((0,) * d, (1,) * (d - 1) + (2 / 3,)), 2, 1.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    middle = (0.45,) * (d - 1) + (2 / 3 + 0.5,)
    turn = 0.03 if d == 2 else (0.02, 0.03, 0.05)
    motion = {
        "increment": (0.01,) + (0,) * (d - 2) + (-0.04,),
        "rotation_increment": np.degrees(turn),
    }
    body = mpm.RigidBody(mpm.Ball(middle, 0.5), **(motion | options))
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.2), points, u, v)
    F += mpm.contact(body, points, u, v, friction=friction, penalty=50.0 * smallest_height(grid))
    return mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom")), body


@pytest.mark.parametrize(
    ("basis", "d", "kind"),
    [
        ("gimp", 2, None),
        ("bspline2", 2, None),
        ("linear", 2, "triangle"),
        ("gimp", 3, None),
    ],
)
def test_the_tangent_of_contact(basis, d, kind):
    problem, body = pressed(basis, d, kind=kind)
    record = problem.step()
    assert record.halvings == 0
    assert body.force[-1] > 0.05
    assert record.bodies[body.name]["force"] == body.force.tolist()
    linearised = Linearised(problem)
    rng = np.random.default_rng(3)
    start = rng.uniform(-1e-4, 1e-4, linearised.size)
    linearised.tangent(start)
    direction = rng.uniform(-1, 1, linearised.size)
    exact, residual, t = linearised.product(direction), linearised.residual, 1e-7
    numerical = (residual(start + t * direction) - residual(start - t * direction)) / (2 * t)
    np.testing.assert_allclose(exact, numerical, atol=2e-6 * np.abs(exact).max())


def test_without_friction_the_tangent_is_symmetric_and_with_it_not():
    for friction, kind in ((0.0, "cholesky"), (0.4, "lu")):
        problem, _ = pressed(friction=friction)
        problem.step()
        assert problem.newton.linear.method.pc == kind


def test_a_step_that_fails_leaves_body_and_slip_as_they_were():
    problem, body = pressed(friction=0.4)
    problem.step()
    points = problem.points
    before = {name: values.copy() for name, values in points.fields.items()}
    place, force = body.position.copy(), body.force.copy()
    assert np.abs(points["contact1_tangential_force"]).max() > 0
    problem.newton.max_iterations, problem.max_halvings = 1, 1
    problem.newton.tolerance = 1e-13
    with pytest.raises(mpm.errors.ConvergenceError):
        problem.step()
    for name, values in before.items():
        np.testing.assert_array_equal(points[name], values, err_msg=name)
    np.testing.assert_array_equal(body.position, place)
    np.testing.assert_array_equal(body.force, force)
    problem.newton.max_iterations, problem.newton.tolerance = 20, 1e-9
    problem.step()
    np.testing.assert_allclose(body.position - place, [0.01, -0.04], atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_the_border_of_a_free_body_has_its_derivatives(d):
    """Of forces by the body's motion, and of its balance by both unknowns."""
    problem, body = pressed(d=d, free=(True,) * (3 if d == 2 else 6), force=(0,) * d)
    body.freedom.increment[d - 1] = -0.03
    body.freedom.increment[0] = 0.01
    body.begin(1.0)
    body.put(1.0)
    operator = problem.operator()
    border = problem.solver.border
    assert isinstance(border, FreeBodies)
    border.begin(operator)
    rng = np.random.default_rng(4)
    x = rng.uniform(-2e-3, 2e-3, operator.here.unknowns.owned)
    m = body.freedom.increment.size

    def balance(x):
        """Forces on the points and, not scaled, those on the body."""
        r = operator.residual(x).values
        force, moment = problem.bodies.acting(operator)[0].totals()
        return r.copy(), -np.concatenate([force, moment])

    balance(x)
    slopes = border.slopes(x)
    gap, by_x, by_y = border.gap(x)
    scale = (balance(x)[1] - body.freedom.external(0.0)) / gap
    y, t = rng.uniform(-1, 1, m), 1e-7

    def at(sign):
        border.move(sign * t * y)
        found = balance(x)
        border.move(-sign * t * y)
        return found

    plus, minus = at(1), at(-1)
    by_motion = slopes @ y
    numeric = (plus[0] - minus[0]) / (2 * t)
    np.testing.assert_allclose(by_motion, numeric, atol=1e-5 * np.abs(by_motion).max())
    own = (plus[1] - minus[1]) / (2 * t)
    np.testing.assert_allclose((by_y @ y) * scale, own, atol=1e-3 * np.abs(own).max())
    balance(x)
    dx = rng.uniform(-1, 1, x.size)
    both = [balance(x + s * t * dx)[1] for s in (1, -1)]
    own = (both[0] - both[1]) / (2 * t)
    np.testing.assert_allclose((dx @ by_x) * scale, own, atol=1e-5 * np.abs(own).max())


@pytest.mark.parametrize("d", [2, 3])
def test_bodies_are_drawn_and_written(d, tmp_path):
    problem, body = pressed(d=d)
    problem.step()
    zero = (0,) * (d - 1)
    floor = mpm.RigidBody(mpm.Plane((*zero, 0), (*zero, 1)), name="floor")
    mpm.plot(problem.points, tmp_path / "body.png", bodies=[body, floor])
    if d == 3:
        mpm.plot(problem.points, tmp_path / "cut.png", cut=("y", 0.4), bodies=[body])
    with pytest.raises(mpm.errors.ParameterError, match="bodies"):
        mpm.plot(problem.points, tmp_path / "no.png", bodies=body)
    with mpm.ParaView(tmp_path / "run.pvd", problem.points, bodies=[body, floor]) as series:
        series.write(0.0)
        problem.step()
        series.write(1.0)
    assert (tmp_path / "run_bodies.pvd").read_text().count("bodies_00000") == 2

    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / "run" / "bodies_000001.vtp"))
    reader.Update()
    written = reader.GetOutput()
    x = vtk_to_numpy(written.GetPoints().GetData())[:, :d]
    which = vtk_to_numpy(written.GetCellData().GetArray("body"))
    force = vtk_to_numpy(written.GetCellData().GetArray("force"))[:, :d]
    assert set(which) == {0, 1}
    np.testing.assert_allclose(force[which == 0], body.force[None].repeat(sum(which == 0), 0))
    own = np.repeat(which, d) == 0
    distance = np.linalg.norm(x[own] - body.position, axis=1)
    np.testing.assert_allclose(distance, 0.5, rtol=1e-12)


def test_motion_is_prescribed_by_functions_and_constants():
    turn = np.array([0.3, -0.2, 0.5])
    ball = mpm.RigidBody(
        mpm.Box((0, 0, 0), (1, 1, 1)), displacement=lambda t: (t, 0, t**2), centre=(0, 0, 0),
        rotation=lambda t: t * np.degrees(turn),
    )  # fmt: skip
    for dt in (0.5, 1.0):
        ball.begin(dt)
        ball.put(0.5)
        ball.put(1.0)
        ball.commit(np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(ball.position, [1.5, 0, 2.25], atol=1e-14)
    np.testing.assert_allclose(ball.pose.rotation, rotation_of(1.5 * turn, 3), atol=1e-14)
    again = mpm.RigidBody(
        mpm.Box((0, 0, 0), (1, 1, 1)), centre=(0, 0, 0), rotation=lambda t: np.degrees(turn)
    )
    again.set_state(ball.state())
    np.testing.assert_array_equal(again.pose.rotation, ball.pose.rotation)
    assert again.time == 1.5


@pytest.mark.parametrize("when", ["before the body", "before the problem", "after it"])
def test_what_a_constant_holds_at_first_the_first_step_brings_about(when):
    grid = unit_grid("quadrilateral", 3)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 2 / 3)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    place, angle = fem.Constant(grid, (0.0, 0.0)), fem.Constant(grid, 0.0)

    def put(now):
        if when == now:
            place.value[:], angle.value = (0.02, -0.06), 6.0

    put("before the body")
    body = mpm.RigidBody(mpm.Disc((0.5, 2 / 3 + 0.5), 0.5), displacement=place, rotation=angle)
    put("before the problem")
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.2), points, u, v)
    problem = mpm.QuasiStatic(
        F + mpm.contact(body, points, u, v, penalty=12.5), u, points, mpm.fixed(V, "bottom")
    )
    put("after it")
    problem.share = 0.5
    assert problem.step().parts == 2
    np.testing.assert_allclose(body.position, [0.52, 2 / 3 + 0.44], atol=1e-14)
    np.testing.assert_allclose(body.angle, 6.0)
    assert body.force[1] == pytest.approx(0.593828, rel=1e-4)
    with pytest.raises(mpm.errors.ParameterError, match=r"displacement = .* its own constant"):
        mpm.RigidBody(mpm.Disc((0.5, 2), 0.5), displacement=place)
    away = mpm.RigidBody(mpm.Disc((0.5, 2), 0.5), displacement=lambda t: (0.0, -0.1 - t))
    with pytest.raises(mpm.errors.ParameterError, match=r"displacement\(0\) = .* must be 0"):
        mpm.QuasiStatic(F + mpm.contact(away, points, u, v), u, points)


def test_a_constant_moves_a_body_and_is_scaled_as_a_load_is():
    grid = unit_grid("quadrilateral", 3)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 2 / 3)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    place, angle = fem.Constant(grid, (0.0, 0.0)), fem.Constant(grid, 0.0)
    body = mpm.RigidBody(mpm.Disc((0.5, 2 / 3 + 0.5), 0.5), displacement=place, rotation=angle)
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.2), points, u, v)
    F += mpm.contact(body, points, u, v, friction=0.3, penalty=12.5)
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    place.value[:], angle.value = (0.02, -0.06), 6.0
    record = problem.step()
    np.testing.assert_allclose(body.position, [0.52, 2 / 3 + 0.44], atol=1e-14)
    np.testing.assert_allclose(body.angle, 6.0)
    assert record.parts >= 1
    free = mpm.RigidBody(mpm.Disc((0.5, 2), 0.5), force=(0, -1), free=(False, True, False))
    load = fem.Constant(grid, (0.0, -1e-3))
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.2), points, u, v)
    F += mpm.contact(free, points, u, v) - ufl.inner(load, v) * points.dX
    with pytest.raises(mpm.errors.ParameterError, match="is free"):
        mpm.ArcLength(F, u, points, mpm.fixed(V, "bottom"), load=load)


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.GeneralisedAlpha])
def test_the_work_of_tools_counts_in_implicit_steps(kind):
    """A plate presses a block between walls by 5 %: the work is what the block stores."""
    problem, stored = compressed(kind, stabilisation="aggregation")
    for t in mpm.times(1.0, dt=0.02):
        problem.step(t)
    found = problem.energies()
    assert found.external == pytest.approx(stored, rel=0.03)
    assert found.strain + found.kinetic == pytest.approx(found.external, rel=0.02)


def test_penalties_in_units_of_the_modulus_are_told_in_pascals_per_metre():
    grid = mpm.create_lattice(COMM, [np.linspace(0, 1, 5)] * 2)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law, h = mpm.materials.Hencky(E=10.0, nu=0.2), 0.25
    body = mpm.RigidBody(mpm.Disc((0.5, 1.01), 0.5), name="disc")
    side = mpm.Boundary.from_side(points, "right")
    F = mpm.momentum(law, points, u, v)
    F += mpm.contact(body, points, u, v, penalty=3.0)
    with pytest.raises(mpm.errors.ParameterError, match="before a problem is made"):
        mpm.stiffness_per_area(F)
    F += mpm.signorini(side, u, v, law=law, penalty=7.0)
    F += mpm.dirichlet(side, u, v, method="penalty", stiffness_per_area=11.0)
    mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom")).step()
    found = dict(mpm.stiffness_per_area(F))
    M = 10.0 * (1 - 0.2) / ((1 + 0.2) * (1 - 2 * 0.2))
    for name, k in (
        ("the contact with 'disc'", 3.0 * 10.0 / h),
        ("the wall at 'right'", 7.0 * M / h),
        ("the condition at 'right'", 11.0),
    ):
        np.testing.assert_allclose(found[name], k, rtol=1e-12)
    with pytest.raises(mpm.errors.ParameterError, match="must be a Form"):
        mpm.stiffness_per_area(3.0)
