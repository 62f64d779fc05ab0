"""The account of energies where points come, go, split or merge between steps."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM

import dolfinmpm as mpm

LAW = mpm.materials.VonMises(1e5, 0.2, yield_stress=1e6)


def column(kind):
    """A column that its weight has pressed, and that goes on in time."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 1, 5), np.linspace(0, 2, 9)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 2)), 2, 1e3)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(LAW, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector([0.0, -10.0]), v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    mpm.QuasiStatic(F, u, points, bcs).step()
    problem = kind(F, u, points, bcs)
    problem.step(0.01)
    return problem


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.Explicit])
def test_what_is_removed_takes_its_elastic_energy_along(kind, tmp_path):
    """It had been lost in "plastic" and "integrator", which judges a run."""
    problem = column(kind)
    before = problem.energies()
    problem.points.remove(lambda x: x[1] > 1.0)
    after = problem.energies()
    gone = before.strain - after.strain
    assert gone > 0.05 * before.strain
    for name in ("plastic", "projection", "integrator"):
        assert after[name] == pytest.approx(before[name], abs=1e-9 * gone)
    assert before.initial - after.initial == pytest.approx(gone, rel=1e-2)
    # a checkpoint between the change and the next step knows it
    problem.save(tmp_path / "state")
    problem.step(0.011)
    ended = problem.energies()
    assert abs(ended["plastic"]) < 1e-2 * gone
    assert ended.initial == pytest.approx(after.initial, rel=1e-12)
    other = column(kind)
    other.load(tmp_path / "state")
    other.step(0.011)
    assert other.energies().initial == pytest.approx(ended.initial, rel=1e-12)
    assert other.energies()["integrator"] == pytest.approx(ended["integrator"], abs=1e-9 * gone)


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.Explicit])
def test_what_comes_gives_its_energy(kind):
    problem = column(kind)
    grid = problem.points.grid
    other = mpm.fill(grid, mpm.Box((0, 1.5), (0.5, 2.0)), 2, 1e3)
    problem.points.remove(lambda x: x[1] > 1.4)
    before = problem.energies()
    for name in ("be", "velocity"):
        other.add_field(name, problem.points[name].shape[1:], "")
    other["be"] = [1.1, 1.1, 1.1, 0.0, 0.0, 0.0]
    other["velocity"] = [0.5, 0.5]
    problem.points.add(other)
    after = problem.energies()
    given = after.kinetic + after.strain - before.kinetic - before.strain
    assert given > 0.125 * 1e3 * 0.25
    assert after.initial - before.initial == pytest.approx(given, rel=1e-2)
    assert after["integrator"] == pytest.approx(before["integrator"], abs=1e-9 * given)


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.Explicit])
def test_a_merge_by_the_user_has_its_name(kind):
    problem = column(kind)
    mpm.split(problem.points, lambda x: x[1] < 1.0)
    problem.points["velocity"] += 0.3 * np.sin(9 * problem.points["x"])
    problem.step(0.011)
    before = problem.energies()
    assert mpm.merge(problem.points, 0.5).count > 0
    after = problem.energies()
    lost = before.kinetic + before.strain - after.kinetic - after.strain
    assert abs(lost) > 1e-6 * before.strain
    assert after["merging"] - before["merging"] == pytest.approx(lost, rel=1e-6)
    for name in ("plastic", "projection", "integrator"):
        assert after[name] == pytest.approx(before[name], abs=1e-6 * abs(lost))
    assert after.initial == pytest.approx(before.initial, rel=1e-12)


def pressed(kind):
    """A block that a rigid body presses, with friction."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 2, 9), np.linspace(0, 2, 9)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1e3)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    plate = mpm.RigidBody(mpm.Box((0.5, 1.0), (1.5, 1.5)), velocity=(0.0, -0.1), name="plate")
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.2), points, u, v)
    F += mpm.contact(plate, points, u, v, friction=0.3)
    return kind(F, u, points, mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right"))


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.Explicit])
@pytest.mark.parametrize("change", ["remove", "split"])
def test_contact_stores_energy_at_points_that_change(kind, change, tmp_path):
    """Half of the energy of the penalty went, and had counted as a loss of the steps."""
    problem = pressed(kind)
    for k in range(8):
        problem.step(0.02 * (k + 1))
    before = problem.energies()
    assert before.contact > 1.0

    def which(x):
        return (x[1] > 0.8) & (x[0] > 1.0)

    if change == "remove":
        problem.points.remove(which)
        after = problem.energies()
        gone = before.contact - after.contact
        assert gone == pytest.approx(0.5 * before.contact, rel=0.05)
        whole = before.kinetic + before.strain + before.contact
        whole -= after.kinetic + after.strain + after.contact
        assert before.initial - after.initial == pytest.approx(whole, rel=1e-3)
    else:
        assert mpm.split(problem.points, which).count > 0
    problem.save(tmp_path / "state")
    problem.step(0.162)
    ended = problem.energies()
    # explicit velocities are half a step behind: what is sudden is seen to first order
    share = {mpm.Newmark: 0.005, mpm.Explicit: 0.1}[kind]
    assert ended["integrator"] == pytest.approx(before["integrator"], abs=share * before.contact)
    other = pressed(kind)
    other.load(tmp_path / "state")
    other.step(0.162)
    again = other.energies()
    assert again.initial == pytest.approx(ended.initial, rel=1e-12, abs=1e-12)
    assert again["integrator"] == pytest.approx(ended["integrator"], abs=1e-9 * before.contact)
