"""Results of a step: forces in records calculate as vectors, footings tell the last step's load."""

from __future__ import annotations

import json

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.solve.bodyrecords import BodyRecords


def block():
    """A block, its space and its weak form without loads."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    V = mpm.Space(grid, "gimp")
    return points, V, mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)


def pressed():
    """A block under a plate that goes down."""
    points, V, F = block()
    plate = mpm.RigidBody(mpm.Plane((0, 2), (0, -1)), increment=(0, -0.01), name="plate")
    F += mpm.contact(plate, points, V.increment, V.test, penalty=100.0)
    return mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")), plate


def test_a_motion_that_changes_at_the_end_of_a_step():
    """Simpson's rule had taken a sixth of the step after the change from the motion before it."""
    points, V, F = block()
    stages = {"increment": lambda t: (0.0, -0.01) if t <= 2 else (0.02, 0.0)}
    ball = mpm.RigidBody(mpm.Disc((2, 3.5), 0.5), name="ball", **stages)
    F += mpm.contact(ball, points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    for _ in range(3):
        problem.step()
    np.testing.assert_allclose(ball.position, (2.02, 3.48), rtol=1e-14)


def test_forces_of_a_record_calculate_as_vectors(tmp_path):
    """Twice a force had been a list of both components repeated, so that [1] was half of it."""
    problem, plate = pressed()
    record = problem.step()
    force = record.bodies["plate"]["force"]
    assert force == plate.force.tolist()
    both = 2 * force
    np.testing.assert_array_equal(both, 2 * plate.force)
    np.testing.assert_array_equal(force + force, both)
    np.testing.assert_array_equal(-force / 2.0 - force, -1.5 * plate.force)
    np.testing.assert_array_equal(sum([force, force]), both)
    total = np.zeros(2)
    total += force * 0.5
    np.testing.assert_array_equal(total, 0.5 * plate.force)
    assert json.loads(json.dumps(force)) == plate.force.tolist()
    problem.save(tmp_path / "plate.npz")
    again, _ = pressed()
    again.load(tmp_path / "plate.npz")
    np.testing.assert_array_equal(2 * again.history[-1].bodies["plate"]["force"], both)


def test_a_record_names_its_bodies():
    """An unknown name had been a KeyError without the names that there are."""
    problem, _ = pressed()
    record = problem.step()
    with pytest.raises(mpm.errors.UnknownNameError, match=r"'wall'; there are 'plate'"):
        record.bodies["wall"]
    with pytest.raises(KeyError, match="there is none"):
        BodyRecords()["wall"]
    assert record.bodies.get("wall") is None


def test_the_load_of_a_footing_is_that_of_the_last_step(tmp_path):
    """A settlement that was set for the next step had counted already, with 1e4 times E."""

    def footing():
        points, V, F = block()
        top = mpm.Surface(points, lambda x: (x[1] > 1.9) & (x[0] < 2.0), normal=(0, 1))
        settlement = fem.Constant(points.grid, 0.01)
        foot = mpm.RigidFooting(top, settlement, E=1e6)
        F += foot.contact(V.increment, V.test)
        problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
        return problem, foot, settlement

    problem, foot, settlement = footing()
    assert foot.load() == 0.0
    problem.step()
    load = foot.load()
    assert load == pytest.approx(16000.0, rel=0.01)
    settlement.value = 0.02
    assert foot.load() == load
    problem.save(tmp_path / "footing.npz")
    again, other, _ = footing()
    again.load(tmp_path / "footing.npz")
    assert other.load() == load
    again.step()
    assert other.load() == pytest.approx(load, rel=1e-3)


def test_a_footing_whose_contact_was_forgotten_has_no_load():
    """It had given the penalty times the settlement, 2e9 N."""
    points, V, F = block()
    top = mpm.Surface(points, lambda x: x[1] > 1.9, normal=(0, 1))
    foot = mpm.RigidFooting(top, fem.Constant(points.grid, 0.01), E=1e6)
    mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()
    with pytest.raises(mpm.errors.ParameterError, match=r"F \+= footing.contact"):
        foot.load()
