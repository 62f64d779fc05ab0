"""Reactions of supports balance what acts on the body."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

HENCKY = {"E": 1e6, "nu": 0.3}
WEIGHT = 2.1 * 0.9 * 2000.0 * 10.0


def column(basis="gimp", stabilisation="ghost", kind=mpm.QuasiStatic, refine=None, **options):
    """A block between the left and the bottom of the grid, which cuts its last cells."""
    lines = [np.linspace(0, 4, 9), np.linspace(0, 2, 5)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    refined = {} if refine is None else {"refine": refine, "levels": 1}
    V = mpm.Space(grid, basis, **refined)
    whole = {} if refine is None else {"refine": V}
    axisymmetric = options.pop("axisymmetric", False)
    points = mpm.fill(
        grid, mpm.Box((0, 0), (2.1, 0.9)), 3, 2000.0, axisymmetric=axisymmetric, **whole
    )
    F = mpm.momentum(mpm.materials.Hencky(**HENCKY), points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector([0.0, -10.0]), V.test) * points.dX
    bottom, left = mpm.fixed(V, "bottom"), mpm.rollers(V, "left")
    problem = kind(F, V.increment, points, bottom + left, stabilisation=stabilisation, **options)
    return problem, bottom, left


@pytest.mark.parametrize(
    ("basis", "stabilisation"),
    [("gimp", "ghost"), ("linear", "none"), ("bspline2", "ghost"), ("linear", "aggregation"),
     ("bspline2", "extended"), ("gimp", "soft")],
)  # fmt: skip
def test_the_bottom_carries_the_weight(basis, stabilisation):
    problem, bottom, left = column(basis, stabilisation)
    problem.step()
    force = mpm.reaction(problem, bottom)
    np.testing.assert_allclose(force[1], WEIGHT, rtol=1e-8)
    # the corner is held to the side by both, and counts once
    both = mpm.reaction(problem, bottom + left)
    np.testing.assert_allclose(both, (0.0, WEIGHT), rtol=1e-8, atol=1e-8 * WEIGHT)
    assert mpm.reaction(problem, left)[0] != 0.0
    assert mpm.reaction(problem, left)[1] == 0.0


def test_on_leaves():
    problem, bottom, left = column(refine=lambda x: np.where(x[0] < 1.0, 0.25, 0.5))
    problem.step()
    both = mpm.reaction(problem, bottom + left)
    np.testing.assert_allclose(both, (0.0, WEIGHT), rtol=1e-8, atol=1e-8 * WEIGHT)


def test_around_an_axis():
    problem, bottom, _ = column(axisymmetric=True)
    problem.step()
    weight = np.pi * 2.1**2 * 0.9 * 2000.0 * 10.0
    np.testing.assert_allclose(mpm.reaction(problem, bottom)[1], weight, rtol=1e-8)


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.GeneralisedAlpha])
def test_steps_in_time_balance_inertia_too(kind):
    """The whole momentum comes from the weight and the reaction."""
    problem, bottom, left = column(kind=kind)
    before, impulse = 0.0, 0.0
    for k in range(1, 6):
        problem.step(1e-3 * k)
        impulse += 1e-3 * (mpm.reaction(problem, bottom + left)[1] - WEIGHT)
    after = float(problem.momentum()[1])
    # the reaction is that at the end of a step, or within it: the sum is of first order
    assert after < before
    np.testing.assert_allclose(impulse, after - before, rtol=0.2)


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
def test_contact_counts_once_in_steps_in_time(mass):
    """A stamp presses a layer one cell high, whose nodes at the bottom it reaches."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 4, 9), np.linspace(0, 2, 5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 0.45)), 3, 1.0)
    V = mpm.Space(grid, "gimp")
    stamp = mpm.RigidBody(mpm.Box((0.6, 0.45), (1.2, 0.85)), velocity=(0.0, -0.3), name="stamp")
    F = mpm.momentum(mpm.materials.Hencky(1e3, 0.3), points, V.increment, V.test)
    F += mpm.contact(stamp, points, V.increment, V.test)
    bottom = mpm.fixed(V, "bottom")
    problem = mpm.Newmark(F, V.increment, points, bottom, stabilisation="ghost", mass=mass)
    needed, means, before, momentum = [], [], 0.0, 0.0
    for k in range(1, 21):
        problem.step(0.005 * k)
        after, now = mpm.reaction(problem, bottom)[1], problem.momentum()[1]
        needed.append((now - momentum) / 0.005 + stamp.force[1])
        means.append(0.5 * (before + after))
        before, momentum = after, now
    # the force of contact changes from step to step: both are equal to first order
    np.testing.assert_allclose(means, needed, rtol=0, atol=0.04 * max(needed))


def test_what_a_moved_side_takes():
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(3), range(3)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1.0)
    V = mpm.Space(grid, "linear")
    F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.0), points, V.increment, V.test)
    bottom, top = mpm.fixed(V, "bottom"), mpm.prescribed(V, "top", 1, increment=-0.02)
    problem = mpm.QuasiStatic(F, V.increment, points, bottom + top)
    problem.step()
    pushed = mpm.reaction(problem, top)
    # the Kirchhoff stress E ln F is the first Piola–Kirchhoff stress times F = 0.99
    np.testing.assert_allclose(pushed[1], 2.0 * 1e6 * np.log(0.99) / 0.99, rtol=1e-8)
    np.testing.assert_allclose(mpm.reaction(problem, bottom)[1], -pushed[1], rtol=1e-8)


def test_a_load_factor_counts():
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(3), range(3)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1.0)
    V, load = mpm.Space(grid, "linear"), fem.Constant(grid, (0.0, -1e3))
    F = mpm.momentum(mpm.materials.Hencky(**HENCKY), points, V.increment, V.test)
    F -= ufl.inner(load, V.test) * points.dX
    bottom = mpm.fixed(V, "bottom")
    problem = mpm.ArcLength(F, V.increment, points, bottom, load=load, first=1.0)
    for _ in range(3):
        problem.step()
    force = mpm.reaction(problem, bottom)
    assert problem.factor > 1.0
    np.testing.assert_allclose(force[1], 4e3 * problem.factor, rtol=1e-6)


def test_nodes_that_follow_a_place():
    """The support grows by a row of nodes, and the given conditions know their nodes then."""
    problem, _, _ = column()
    V, steps = problem.form.spaces[0], []
    held = [
        condition
        for k in range(2)
        for condition in mpm.prescribed(V, lambda x: x[1] < 0.1 + 0.5 * len(steps), k, follows=True)
    ]
    own = mpm.QuasiStatic(
        problem.form.given, V.increment, problem.points, held, stabilisation="ghost"
    )
    for _ in range(2):
        own.step()
        steps.append(own)
        np.testing.assert_allclose(mpm.reaction(own, held)[1], WEIGHT, rtol=1e-8)


def pressed(m):
    """Soil that yields under a strip which is pressed into it."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 3, 7), np.linspace(0, 2, 5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2.1, 1.0)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    law = mpm.materials.VonMises(E=m["E"], nu=0.3, yield_stress=m["strength"])
    F = mpm.momentum(law, points, V.increment, V.test)
    strip = mpm.prescribed(
        V, lambda x: (np.abs(x[1] - 1.0) < 1e-9) & (x[0] < 1.1), 1, increment=-0.01
    )
    problem = mpm.QuasiStatic(
        F, V.increment, points, mpm.fixed(V, "bottom") + strip, stabilisation="ghost",
        tolerance=1e-12,
    )  # fmt: skip
    return problem, lambda: mpm.reaction(problem, strip)[1]


def test_derivatives_of_a_reaction():
    m = {"E": 1e6, "strength": 2e4}

    def scene(m):
        problem, force = pressed(m)
        return mpm.study.Run(problem, [problem.step] * 3, {"force": force})

    def last(m):
        problem, force = pressed(m)
        for _ in range(3):
            problem.step()
        return force()

    found = mpm.study.differentiate(scene, m)
    assert found.figures["force"][-1] == pytest.approx(last(m), rel=1e-10)
    for name, value in m.items():
        up, down = (last({**m, name: value * (1 + h)}) for h in (1e-4, -1e-4))
        by_log = (up - down) / 2e-4
        assert found.derivatives["force"][name][-1] == pytest.approx(by_log, rel=1e-6)


def test_a_restored_state_has_its_reaction(tmp_path):
    problem, force = pressed({"E": 1e6, "strength": 2e4})
    problem.step()
    first = force()
    problem.save(tmp_path / "one")
    problem.step()
    assert force() < 1.5 * first < 0.0
    problem.load(tmp_path / "one")
    assert force() == first
    # a new problem does not know the nodes of the step
    other, force = pressed({"E": 1e6, "strength": 2e4})
    other.load(tmp_path / "one")
    with pytest.raises(mpm.errors.ParameterError, match="take a step first"):
        force()


def test_forces_of_another_run_are_not_taken_without_supports():
    """As on a rank without prescribed nodes that restores the state of another number of ranks."""
    problem, _, _ = column()
    V = problem.form.spaces[0]
    F = problem.form.given + 1e6 * ufl.inner(V.increment, V.test) * problem.points.dX
    free = mpm.QuasiStatic(F, V.increment, problem.points, stabilisation="ghost")
    free.step()
    conditions = free.essential_conditions
    assert conditions.has_forces
    conditions.set_forces(conditions.forces())
    assert conditions.has_forces
    conditions.set_forces({})
    assert not conditions.has_forces


def test_what_has_no_reaction_is_told():
    problem, bottom, _ = column()
    with pytest.raises(mpm.errors.ParameterError, match="take a step first"):
        mpm.reaction(problem, bottom)
    problem.step()
    _, its, _ = column()
    with pytest.raises(mpm.errors.ParameterError, match="no condition of this problem"):
        mpm.reaction(problem, its)
    with pytest.raises(mpm.errors.ParameterError, match="must be a list"):
        mpm.reaction(problem, bottom[0])
    with pytest.raises(mpm.errors.ParameterError, match="QuasiStatic"):
        mpm.reaction(bottom, bottom)
    explicit, its, _ = column(kind=mpm.Explicit, stabilisation="none")
    with pytest.raises(mpm.errors.ParameterError, match="keeps no reactions"):
        mpm.reaction(explicit, its)


def wet(prescribed, load=0.0):
    """A wet column of 2 m by 4 m, with conditions of the pressure at its ends."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 2, 5), np.linspace(0, 4, 9)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 4)), 2, 2000.0)
    V, Q = mpm.Space(grid), mpm.Space(grid, shape=())
    u, p = V.increment, Q.increment
    clay = mpm.materials.Hencky(1e7, 0.3)
    F = mpm.poromechanics(clay, points, (u, p), (V.test, Q.test), permeability=1e-5, porosity=0.4)
    F += mpm.Surface(points, lambda x: x[1] > 3.9, (0, 1)).pressure(load, u, V.test)
    ends = prescribed(Q)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right") + [c for e in ends for c in e]
    return mpm.Transient(F, [u, p], points, bcs), ends, bcs


def test_flow_of_water_through_a_column():
    """Darcy: k i A, in at the bottom and out at the top."""
    problem, (top, bottom), bcs = wet(
        lambda Q: (mpm.fixed(Q, "top"), mpm.prescribed(Q, "bottom", 0, value=2e3))
    )
    problem.step(1e6)
    with pytest.raises(mpm.errors.ParameterError, match="2 fields, whose forces and flows have no"):
        mpm.reaction(problem, bcs)
    flow = 1e-5 * 2e3 / (9810.0 * 4.0) * 2.0
    np.testing.assert_allclose(mpm.reaction(problem, bottom), [flow], rtol=1e-3)
    np.testing.assert_allclose(mpm.reaction(problem, top), [-flow], rtol=1e-3)


def test_water_that_leaves_makes_the_body_smaller():
    problem, (bottom,), _ = wet(lambda Q: (mpm.fixed(Q, "bottom"),), load=1e4)
    volume = problem.points["V"].sum()
    for t in (1.0, 20.0):
        dt = t - problem.time
        problem.step(t)
        change, volume = problem.points["V"].sum() - volume, problem.points["V"].sum()
        assert change < -1e-4
        np.testing.assert_allclose(mpm.reaction(problem, bottom) * dt, [change], rtol=1e-6)
