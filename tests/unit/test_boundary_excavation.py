"""Boundaries of a body from which points are removed: they end where the body is taken away."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from mpi4py import MPI

import dolfinmpm as mpm

UNIT_WEIGHT = 1800 * 9.81
LAW = mpm.materials.Hencky(50e6, 0.3)


def pit(follows, method="nitsche", stabilisation="ghost"):
    """Ground on both sides of a stiff wall, and the faces of the wall: the problem, both faces."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 6.1, 0.5), np.arange(0, 4.6, 0.5)])
    slot = mpm.Box((2.63, 2.0), (3.23, 4.0))
    ground = mpm.Box((0.0, 0.0), (6.0, 4.0)) - slot
    points = mpm.fill(grid, ground, 2, 1800.0, exact=True)
    mpm.set_stress(LAW, points, mpm.geostatic_stress(4.0, UNIT_WEIGHT, 0.5))
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(LAW, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), v) * points.dX
    faces = []
    chains = [(2.63, 2.0), (2.63, 4.0)], [(3.23, 4.0), (3.23, 2.0)], [(3.23, 2.0), (2.63, 2.0)]
    for chain in chains:
        face = mpm.Boundary.from_polygon(points, chain, closed=False, follows=follows)
        F += mpm.dirichlet(face, u, v, law=LAW, direction="normal", method=method)
        faces.append(face)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation), *faces[:2]


def dig(problem, depth):
    """Take the uppermost part of the ground left of the wall away, and take a step."""
    points = problem.points
    points.remove((points["x0"][:, 0] < 2.63) & (points["x0"][:, 1] > 4.0 - depth))
    return problem.step()


@pytest.mark.parametrize("method", ["nitsche", "penalty"])
def test_thrusts_beside_an_excavation_are_those_of_a_wall_that_stays_in_space(method):
    """Faces without ground had the state of that behind the wall: 1.8 kN/m for 17.9 kN/m."""
    forces = {}
    for follows in (True, False):
        problem, front, back = pit(follows, method)
        problem.step()
        for depth in (1.0, 1.5):
            dig(problem, depth)
        forces[follows] = [front.force()[0], back.force()[0]]
    assert forces[False][1] > 0.25 * UNIT_WEIGHT * 2.0**2 * 0.8
    np.testing.assert_allclose(forces[True], forces[False], atol=0.03 * forces[False][1])


def test_a_boundary_without_a_body_has_no_force():
    """It kept the force of a gap."""
    problem, front, back = pit(follows=True)
    problem.step()
    assert front.force()[0] < -0.2 * UNIT_WEIGHT * 2.0**2
    dig(problem, 2.0)
    assert np.all(front.force() == 0.0)
    assert not front.present().any()
    assert back.present().all()


def test_aggregation_finds_no_cells_of_a_boundary_without_a_body():
    """Its forces had not been finite: the step ended with a ConvergenceError."""
    problem, _, back = pit(follows=True, stabilisation="aggregation")
    problem.step()
    for depth in (0.5, 1.0, 1.5):
        assert dig(problem, depth).halvings == 0
    assert np.isfinite(back.force()).all()


def test_a_restart_knows_the_boundary_that_is_gone(tmp_path):
    """The markers that are gone are in the checkpoint."""
    problem, front, back = pit(follows=True)
    problem.step()
    dig(problem, 1.0)
    problem.save(tmp_path / "pit.npz")
    problem.step()
    again, front_again, back_again = pit(follows=True)
    again.load(tmp_path / "pit.npz")
    assert front_again.present().sum() == front.present().sum() < len(front.markers)
    again.step()
    np.testing.assert_array_equal(back_again.force(), back.force())
    np.testing.assert_array_equal(front_again.force(), front.force())


def block(body, *corners, **options):
    """A block of soil, and a boundary along a chain: points, space, boundary."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 4.1, 0.5), np.arange(0, 3.1, 0.5)])
    points = mpm.fill(grid, body, 2, 1800.0, exact=True)
    face = mpm.Boundary.from_polygon(points, corners, closed=False, **options)
    return points, mpm.Space(grid, "gimp"), face


def test_a_boundary_of_a_body_lies_at_the_body():
    """With aggregation it had held the body through empty cells: 8.7 kN/m at 0.9 m from it."""
    beside = (3.3, 0.0), (3.3, 2.0)
    with pytest.raises(mpm.errors.ParameterError, match=r"away from the body: .* follows=False"):
        block(mpm.Box((0, 0), (2.4, 2)), *beside)
    assert block(mpm.Box((0, 0), (2.4, 2)), *beside, follows=False)[2].present().all()


def test_markers_above_a_body_do_not_act():
    """A wall that is higher than the ground: empty cells had no stiffness for Nitsche's method."""
    forces = []
    for top in (2.0, 3.0):
        corners = (3.3, 0.0), (3.3, top)
        if top > 2.0:
            with pytest.warns(mpm.errors.IdleConditionWarning, match="do not act"):
                points, V, face = block(mpm.Box((0, 0), (3.3, 2)), *corners)
        else:
            points, V, face = block(mpm.Box((0, 0), (3.3, 2)), *corners)
        F = mpm.momentum(LAW, points, V.increment, V.test)
        F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), V.test) * points.dX
        F += mpm.dirichlet(face, V.increment, V.test, law=LAW, direction="normal")
        bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
        mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost").step()
        forces.append(face.force()[0])
    assert forces[1] == pytest.approx(forces[0], rel=0.02)


def test_nitsche_refuses_a_boundary_through_the_body():
    """It had taken the traction of one side only: -8.7 kN/m on a plane with no force."""
    points, V, face = block(mpm.Box((0, 0), (4, 2)), (1.3, 0.0), (1.3, 2.0))
    u, v = V.increment, V.test
    for method in ("nitsche", "skew"):
        with pytest.raises(mpm.errors.ParameterError, match=r'run through the body.*"penalty"'):
            mpm.dirichlet(face, u, v, law=LAW, direction="normal", method=method)
    F = mpm.momentum(LAW, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), v) * points.dX
    F += mpm.dirichlet(face, u, v, law=LAW, direction="normal", method="penalty")
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")
    problem.step()
    assert abs(face.force()[0]) < 1e-3 * UNIT_WEIGHT
