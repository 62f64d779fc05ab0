"""Contact with rigid bodies in fused explicit steps: as in general ones."""

from __future__ import annotations

import numpy as np
import pytest
from contactscenes import ELASTIC, body, compressed, falls, grid_of, is_hit, is_ploughed, is_pressed
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm._platform.errors import InstabilityError, ParameterError
from dolfinmpm.dynamics import explicitcall

LONG = pytest.mark.long


def alike(scene, end, calls=2, steps=50, touches=True, **options):
    """Both paths take a scene to the same state, to rounding; returns the fused one."""
    one, other = (scene(fused=fused, **options) for fused in (True, False))
    assert one.unfused == ""
    assert other.unfused
    for k in range(calls):
        for p in (one, other):
            p.step(end * (k + 1) / calls)
    assert [r.parts for r in one.history] == [r.parts for r in other.history]
    assert sum(r.parts for r in one.history) >= steps
    a, b = (np.argsort(p.points["id"]) for p in (one, other))
    for name, values in other.points.fields.items():
        if values.dtype == float:
            scale = np.abs(values).max(initial=0.0)
            away = np.abs(one.points[name][a] - values[b]).max(initial=0.0)
            assert away <= 1e-10 * scale, name
    for mine, theirs in zip(one.bodies.all, other.bodies.all):
        for name in ("position", "angle", "force", "moment"):
            expected = getattr(theirs, name)
            scale = max(np.abs(expected).max(), 1e-12)
            assert np.abs(getattr(mine, name) - expected).max() <= 1e-10 * scale, name
        assert mine.time == pytest.approx(theirs.time, rel=1e-12)
    for mine, theirs in zip(one.bodies.contacts, other.bodies.contacts):
        assert mine.dissipated == pytest.approx(theirs.dissipated, rel=1e-9, abs=1e-12)
    mine, theirs = one.energies(), other.energies()
    size = theirs.kinetic + abs(theirs.strain)
    for name in ("kinetic", "strain", "dissipated", "external"):
        assert getattr(mine, name) == pytest.approx(getattr(theirs, name), abs=1e-10 * size), name
    if touches:
        first = one.bodies.contacts[0]
        assert (one.points[first.names.normal_force] > 0).any()
        assert first.law.friction == 0.0 or first.dissipated > 0
    return one


def test_a_disc_falls_on_a_slope():
    alike(falls, 0.2, scheme="musl")


FALLS = [
    # where points cross cells of linear functions, rounding grows by a hundred at once
    {"scheme": "usl", "basis": "linear", "courant": 0.28, "end": 0.15},
    {"scheme": "usf", "basis": "bspline2", "mapping": "apic", "damping": 0.05},
    {"scheme": "usl", "basis": "bspline2", "averaged": False, "mapping": "tpic"},
    {"scheme": "usl", "basis": "bspline3", "corners": "material"},
    {"scheme": "musl", "basis": "gimp", "surface": True, "mass_scaling": 2.0},
    {"scheme": "usl", "graded": True, "damping": 0.05},
]


@pytest.mark.long
@pytest.mark.parametrize("options", FALLS, ids=lambda o: "-".join(map(str, o.values())))
def test_bases_schemes_and_corners(options):
    alike(falls, **({"courant": 0.6, "end": 0.2} | options))


def test_a_free_disc_hits_a_block():
    problem = alike(is_hit, 0.12)
    ball = problem.bodies.all[0]
    assert ball.force[1] > 0
    assert ball.freedom.velocity[1] > -2.5


def test_a_wedge_is_dragged_through_clay():
    problem = alike(is_ploughed, 0.08)
    assert (problem.points["plastic_strain"] > 0).any()
    (contact,) = problem.bodies.contacts
    assert np.abs(problem.points[contact.names.tangential_force]).max() > 0


def test_a_limit_of_the_shear_stress_acts_on_the_same_areas():
    """Fused steps have changed the domains of the points when they find these areas."""
    limit = 500.0
    problem = alike(is_ploughed, 0.1, limit=limit)
    (contact,) = problem.bodies.contacts
    points, names = problem.points, contact.names
    force = np.linalg.norm(points[names.tangential_force], axis=-1)
    area = points[names.slip_area]
    assert np.any((area > 0) & (force > 0.99 * limit * area))


@pytest.mark.long
@pytest.mark.parametrize("free", [False, True])
def test_a_box_is_pressed_into_a_block(free):
    alike(is_pressed, 0.05, free=free, courant=0.4)


@pytest.mark.parametrize("fused", [True, False])
def test_a_constant_that_prescribes_a_motion_is_reached_evenly(fused):
    """At the end of the call, not in its first step; also when it stays for a call."""
    times, downs, found = [0.0, 0.02, 0.04, 0.06], [0.0, -0.003, -0.003, -0.005], []

    def down(t):
        return np.interp(t, times, downs)

    for as_constants in (True, False):
        grid = grid_of((0, 0), (2, 1.5), (8, 6))
        points, V, F = body(grid, mpm.Box((0, 0), (2, 1)), ELASTIC, "gimp", weight=False)
        d, angle = fem.Constant(grid, (0.0, 0.0)), fem.Constant(grid, 0.0)
        motion = {"displacement": lambda t: (0.0, down(t)), "rotation": lambda t: 1e2 * down(t)}
        if as_constants:
            motion = {"displacement": d, "rotation": angle}
        plate = mpm.RigidBody(mpm.Box((0.5, 1.0), (1.5, 1.5)), **motion)
        F += mpm.contact(plate, points, V.increment, V.test)
        problem = mpm.Explicit(F, V.increment, points, mpm.fixed(V, "bottom"), fused=fused)
        for t in times[1:]:
            d.value[1], angle.value = down(t), 1e2 * down(t)
            record = problem.step(t)
        assert record.parts > 2
        order = np.argsort(points["id"])
        found.append((points["x"][order], plate.position, plate.angle, plate.force))
    for one, other in zip(*found):
        assert np.abs(one - other).max() <= 1e-9 * np.abs(other).max()


def test_a_call_for_each_step():
    """Lists of near points, bodies and slips go on from call to call."""
    problem = alike(is_hit, 0.1, calls=60)
    assert max(record.parts for record in problem.history) == 1


@pytest.mark.parametrize("fused", [True, False])
def test_a_run_that_goes_back_takes_its_bodies_along(fused, monkeypatch):
    problem = is_hit(fused=fused)
    problem.step(0.08)
    (ball, *_), points = problem.bodies.all, problem.points
    (first, *_) = problem.bodies.contacts
    fields = {name: values.copy() for name, values in points.fields.items()}
    kept = ball.state(), first.dissipated, problem.energies()
    assert ball.force[1] > 0
    monkeypatch.setattr(explicitcall, "checked_courant", float)
    problem.courant = 40.0
    with pytest.raises(InstabilityError):
        problem.step(0.2)
    assert problem.time == 0.08
    np.testing.assert_array_equal(ball.state(), kept[0])
    np.testing.assert_array_equal(ball.position, ball.start.centre)
    assert first.dissipated == kept[1]
    assert problem.energies() == kept[2]
    order = np.argsort(fields["id"])
    for name in ("x", "velocity", first.names.tangential_force):
        now = points[name][np.argsort(points["id"])]
        np.testing.assert_array_equal(now, fields[name][order], err_msg=name)
    # and goes on as one that has not tried
    problem.courant = 0.8
    problem.step(0.1)
    other = is_hit(fused=fused)
    other.step(0.08)
    other.step(0.1)
    np.testing.assert_allclose(ball.position, other.bodies.all[0].position, rtol=1e-12)


def test_points_that_come_later_touch_too():
    """A layer is laid on a block between steps, and a plate comes down on it."""
    found = []
    for fused in (True, False):
        grid = grid_of((0, 0), (1, 1.25), (8, 10))
        points, V, F = body(grid, mpm.Box((0, 0), (1, 0.5)), ELASTIC, "gimp")
        plate = mpm.RigidBody(mpm.Plane((0, 0.76), (0, -1)), velocity=(0.0, -0.5), name="plate")
        F += mpm.contact(plate, points, V.increment, V.test, friction=0.2, penalty=6.25)
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        problem = mpm.Explicit(F, V.increment, points, bcs, fused=fused)
        problem.step(0.002)
        points.add(mpm.fill(grid, mpm.Box((0, 0.5), (1, 0.75)), 2, 1000.0))
        problem.step(0.12)
        found.append(plate.force)
    assert found[0][1] > 100.0
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9, atol=1e-9 * found[0][1])


def test_what_a_tool_does_is_work():
    """A plate presses an elastic block by 5 %, and what it has done is stored."""
    found = []
    for fused in (True, False):
        problem, stored = compressed(mpm.Explicit, fused=fused, scheme="usl", courant=0.4)
        assert (problem.unfused == "") == fused
        problem.step(1.0)
        found.append(problem.energies())
    work = found[0].external
    assert work == pytest.approx(stored, rel=0.03)
    assert found[0].strain + found[0].kinetic == pytest.approx(work, rel=0.02)
    assert work == pytest.approx(found[1].external, rel=1e-9)


def test_what_is_pressed_in_at_first_comes_from_somewhere():
    """A plate that overlaps a block a little throws it off, and the run goes on."""
    grid, found = grid_of((0, 0), (1, 1.25), (8, 10)), []
    for fused in (True, False):
        points, V, F = body(grid, mpm.Box((0, 0.125), (1, 1)), ELASTIC, "gimp", weight=False)
        plate = mpm.RigidBody(mpm.Plane((0, 0.135), (0, 1)), name="plate")
        F += mpm.contact(plate, points, V.increment, V.test, stiffness_per_area=1e6)
        problem = mpm.Explicit(F, V.increment, points, fused=fused, scheme="usl", courant=0.4)
        problem.step(0.05)
        found.append(problem.energies())
    one, other = found
    assert one.external == pytest.approx(0.5 * 1e6 * 0.01**2, rel=1e-9)
    assert 0.6 * one.external < one.kinetic + one.strain < 1.01 * one.external
    assert one.kinetic == pytest.approx(other.kinetic, rel=1e-10)
    assert one.external == other.external


@pytest.mark.parametrize("fused", [True, False])
class TestWhatCannotBe:
    """The same named errors on both paths, and a state to go on from."""

    def block(self, fused, shape=None, law=ELASTIC, **motion):
        grid = grid_of((0, 0), (1, 1.25), (8, 10))
        points, V, F = body(grid, mpm.Box((0, 0), (1, 1)), law, "gimp")
        tool = mpm.RigidBody(shape or mpm.Disc((0.5, 1.3), 0.3), name="tool", **motion)
        F += mpm.contact(tool, points, V.increment, V.test, friction=0.3, penalty=6.25)
        return mpm.Explicit(F, V.increment, points, mpm.fixed(V, "bottom"), fused=fused), tool

    def test_a_tool_outside_of_the_grid(self, fused):
        problem, tool = self.block(fused, mpm.Disc((9, 12), 0.3), velocity=(1.0, 0.0))
        problem.step(0.05)
        np.testing.assert_array_equal(tool.force, 0.0)
        assert tool.position[0] == pytest.approx(9.05)
        assert problem.unfused == ("" if fused else "fused=False")

    def test_points_within_the_body(self, fused):
        problem, tool = self.block(fused, mpm.Disc((0.5, 1.0), 0.3))
        for _ in range(2):
            with pytest.raises(ParameterError, match="material points are inside 'tool' before"):
                problem.step(0.05)
            np.testing.assert_array_equal(problem.points["x"], problem.points["x0"])
            assert problem.time == tool.time == 0.0

    def test_a_tool_that_is_too_fast_at_once(self, fused):
        problem, tool = self.block(fused, velocity=(0.0, -1e6))
        with pytest.raises(ParameterError, match=r"'tool' moves .* m at once, more than a cell"):
            problem.step(0.05)
        assert problem.time == tool.time == 0.0

    def test_a_tool_that_becomes_too_fast(self, fused):
        """The steps before it are whole."""
        problem, tool = self.block(fused, velocity=lambda t: (0.0, 0.0 if t < 0.1 else 1e4))
        with pytest.raises(ParameterError, match=r"'tool' moves .* more than a cell"):
            problem.step(0.2)
        assert 0.09 < problem.time < 0.1
        assert tool.time == pytest.approx(problem.time)
        # what had been taken is the points' state, its stress and volume too
        J = np.linalg.det(problem.points["F"])
        np.testing.assert_allclose(problem.points["V"], J * problem.points["V0"], rtol=1e-13)
        np.testing.assert_array_equal(tool.position, (0.5, 1.3))

    def test_a_motion_that_is_no_number_later_on(self, fused):
        problem, tool = self.block(
            fused, velocity=lambda t: (0.0, 0.0 if t < 0.1 else float("nan"))
        )
        with pytest.raises(ParameterError, match="2 finite numbers"):
            problem.step(0.2)
        assert 0.09 < problem.time < 0.1
        assert tool.time == pytest.approx(problem.time)

    def test_points_that_are_thrown_into_the_body(self, fused, monkeypatch):
        grid = grid_of((0, 0), (1, 1.25), (8, 10))
        points, V, F = body(grid, mpm.Box((0, 0), (1, 0.5)), ELASTIC, "gimp")
        tool = mpm.RigidBody(mpm.Box((-1, 0.644), (2, 3)), name="tool")
        F += mpm.contact(tool, points, V.increment, V.test, penalty=6.25)
        problem = mpm.Explicit(F, V.increment, points, fused=fused, scheme="usl", courant=1.0)
        problem.step(0.002)
        # further in one step than points are looked at
        points["velocity"][:] = 0.0, 60.0
        monkeypatch.setattr(explicitcall, "checked_courant", float)
        problem.courant = 4.5
        with pytest.raises(InstabilityError, match="from further away than was looked at"):
            problem.step(0.005)
        assert problem.time == tool.time == 0.002
