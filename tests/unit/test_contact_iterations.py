"""Contact and what it costs: linear iterations in 3D, corners that are looked at."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.solve import method
from dolfinmpm.solve.initialguess import InitialGuess


def pressed(touches: bool, friction: float = 0.3):
    """A block that a ball is pressed into aslant, or whose top is moved in its place."""
    grid = unit_grid("hexahedron", 6)
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 2 / 3)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.3), points, u, v)
    bcs = mpm.fixed(V, "bottom")
    body = mpm.RigidBody(mpm.Ball((0.5, 0.45, 2 / 3 + 0.5), 0.5), increment=(0.01, 0, -0.03))
    if touches:
        F += mpm.contact(body, points, u, v, friction=friction, penalty=50 / 7)
    else:
        middle = lambda x: (abs(x[2] - 2 / 3) < 1e-6) & (np.hypot(x[0] - 0.5, x[1] - 0.5) < 0.2)  # noqa: E731
        bcs += mpm.prescribed(V, middle, 2, increment=-0.02)
    return mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost"), body


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_multigrid_takes_contact(monkeypatch, friction):
    """Rigid modes and point smoothers serve as well where corners stick and slip."""
    for name in ("_CROSSOVER", "_CROSSOVER_OF_WIDE"):
        monkeypatch.setattr(method, name, {1: 10**9, 2: 20, 3: 20})
    few = {1: {1: 10**9, 2: 20, 3: 20}}
    monkeypatch.setattr(method, "_CROSSOVER_ON_LATTICE", few)
    means = []
    for touches in (False, True):
        problem, body = pressed(touches, friction)
        for _ in range(2):
            record = problem.step()
            assert record.halvings == 0
        assert problem.newton.linear.method.pc == "mg"
        counts = [n for record in problem.history for n in record.linear_iterations]
        means.append(np.mean(counts))
    assert body.force[2] > 0
    assert means[1] < 1.5 * means[0]
    assert max(record.iterations for record in problem.history) <= 8
    force = body.force.copy()
    monkeypatch.undo()
    problem, body = pressed(True, friction)
    for _ in range(2):
        problem.step()
    assert problem.newton.linear.method.pc == ("lu" if friction else "cholesky")
    np.testing.assert_allclose(body.force, force, rtol=1e-6, atol=1e-6 * force[2])


def test_corners_that_cannot_have_come_so_far_are_not_looked_at(monkeypatch):
    """The gap changes by no more than a corner moves, so that most of them cost nothing."""
    problem, body = pressed(True)
    problem.step()
    operator = problem.operator()
    body.begin(1.0)
    body.put(1.0)
    (contact,) = problem.bodies.acting(operator)
    asked, probe = [], body.surface.probe

    def counted(x):
        asked.append(len(x))
        return probe(x)

    monkeypatch.setattr(body.surface, "probe", counted)
    u = np.random.default_rng(0).uniform(-3e-3, 3e-3, operator.increments[0].shape)
    contact.touch([u], 1.0)
    assert 0 < sum(asked) < 0.5 * len(contact.x)
    kept = contact.forces.copy(), contact.now.normal.copy(), contact.states.copy()
    assert kept[1].max() > 0
    # all of them, as if any might have come near
    contact.start.gap[:] = -1.0
    contact.touch([u], 1.0)
    assert asked[-1] == len(contact.x)
    for before, now in zip(kept, (contact.forces, contact.now.normal, contact.states)):
        np.testing.assert_array_equal(before, now)
    assert isinstance(contact, ActiveRigidContact)


def wedged(**options):
    """A wedge that is pressed into clay."""
    ends = [(0.0, -1.5), (4.0, 0.5)]
    grid = mesh.create_rectangle(MPI.COMM_WORLD, ends, (16, 8), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, -1.5), (4, 0)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    tool = mpm.RigidBody(mpm.Wedge((2.03, 0), np.degrees(0.6), 3.0), increment=(0.0, -0.03))
    F = mpm.momentum(mpm.materials.Tresca(5e6, 0.33, 1e4), points, u, v)
    F += mpm.contact(tool, points, u, v, corners="material", penalty=12.5)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", **options), tool


def test_what_flows_past_a_tool_takes_few_iterations():
    """From the last increments, and to where others come too."""
    problem, tool = wedged()
    for _ in range(10):
        problem.step()
    counts = [record.iterations for record in problem.history]
    assert max(counts) <= 8
    # as fast at the end as Newton's method is with fresh factors
    last = problem.history[-1].residuals
    assert last[-1] < max(1e-2 * last[-2], 1e-12)
    other, same = wedged(petsc_options={"snes_linesearch_type": "cp"})
    for _ in range(10):
        other.newton.guess = InitialGuess()
        other.step()
    assert same.force[1] > 1e4
    np.testing.assert_allclose(tool.force, same.force, rtol=1e-6, atol=1e-6 * same.force[1])
    assert sum(counts) < 0.8 * sum(record.iterations for record in other.history)


@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_ground_that_only_meets_what_it_lies_on_comes_to_rest_at_once(friction):
    """No other support holds it, and the plates have not pressed it before the first step."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 3.1, 0.25), np.arange(-0.5, 2.6, 0.25)])
    points = mpm.fill(grid, mpm.Box((0, 0), (3, 2)), 2, 1600.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    sand = mpm.materials.MohrCoulomb(20e6, 0.3, cohesion=100.0, friction_angle=30.0)
    mpm.set_stress(sand, points, mpm.geostatic_stress(2.0, 16e3, 0.5))
    F = mpm.momentum(sand, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), v) * points.dX
    plates = [mpm.RigidBody(mpm.Box((a, -3), (b, 0))) for a, b in ((-0.5, 0.5), (0.5, 4.0))]
    for plate in plates:
        F += mpm.contact(plate, points, u, v, friction=friction, penalty=25.0)
    bcs = mpm.rollers(V, "left", "right")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-6)
    record = problem.step()
    assert record.halvings == 0
    assert record.iterations <= 4
    np.testing.assert_allclose(sum(plate.force[1] for plate in plates), -96e3, rtol=1e-5)
    assert np.abs(points["x"] - points["x0"]).max(initial=0.0) < 1e-4


def test_a_free_footing_that_begins_at_the_surface_carries_its_load():
    """Its own equations had no stiffness before anything pressed it."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(-2, 2.1, 0.5), np.arange(-1, 0.6, 0.5)])
    points = mpm.fill(grid, mpm.Box((-2, -1), (2, 0)), 2, 1700.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    free = (False, True, False)
    footing = mpm.RigidBody(mpm.Box((-1, 0), (1, 0.5)), free=free, force=(0.0, -5e3))
    F = mpm.momentum(mpm.materials.Hencky(50e6, 0.3), points, u, v)
    F += mpm.contact(footing, points, u, v)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    record = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost").step()
    assert record.halvings == 0
    np.testing.assert_allclose(footing.force[1], 5e3, rtol=1e-6)
    assert 0.24 < footing.position[1] < 0.25
