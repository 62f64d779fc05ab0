"""A stress that the points have before they move is that of the law, or is refused aloud."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import COMM
from dolfinx import mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError, StateError
from dolfinmpm.body.pointchecks import OF_STRAIN
from dolfinmpm.kinematics.strainhistory import MARKS, UMAT

LAW = mpm.materials.Hencky(1e4, 0.3)
CLAY = mpm.materials.CamClay(
    swelling=0.018,
    compression=0.13,
    M=1.05,
    mu0=5.4e6,
    alpha=0.0,
    reference_pressure=2e4,
    preconsolidation=2e5,
)
SIGMA = np.diag([-40.0, -60.0, -50.0])
SIGMA[0, 1] = SIGMA[1, 0] = 7.0


def body(tag=0):
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (4, 4), mesh.CellType.quadrilateral)
    return mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1.0, tag=tag)


def held(V):
    return [c for side in ("left", "right", "bottom", "top") for c in mpm.fixed(V, side)]


def problem_of(points, law=LAW, kind=mpm.QuasiStatic, strain="large", tag=None, **options):
    V = mpm.Space(points.grid)
    F = mpm.momentum(law, points, V.increment, V.test, strain=strain, tag=tag)
    return kind(F, V.increment, points, held(V), **options)


def take(problem):
    return problem.step(*(() if type(problem) is mpm.QuasiStatic else (1e-3,)))


@pytest.mark.parametrize("when", ["before", "after", "arrays"])
@pytest.mark.parametrize(
    ("kind", "strain"),
    [
        (mpm.QuasiStatic, "large"),
        (mpm.QuasiStatic, "small"),
        (mpm.QuasiStatic, "jaumann"),
        (mpm.Newmark, "large"),
        (mpm.Explicit, "large"),
    ],
)
def test_what_is_written_is_the_initial_stress(kind, strain, when):
    points = body()
    sigma = np.broadcast_to(SIGMA, (len(points), 3, 3))
    if when == "arrays":
        points = mpm.MaterialPoints.from_arrays(
            points.grid, points["x"], points["V"], 1.0, half_length=points["l"],
            fields={"stress": sigma},
        )  # fmt: skip
    elif when == "before":
        points["stress"][:] = sigma
    problem = problem_of(points, kind=kind, strain=strain)
    if when == "after":
        points["stress"] = SIGMA
    take(problem)
    # it is in balance, and nothing moves
    np.testing.assert_allclose(points["stress"], sigma, rtol=1e-9, atol=1e-9)
    assert np.abs(points["x"] - points["x0"]).max() < 1e-12
    # as set_stress does it
    other = body()
    mpm.set_stress(LAW, other, SIGMA, strain=strain)
    state = "be" if strain == "large" else "elastic_strain"
    np.testing.assert_allclose(points[state], other[state][: len(points)], rtol=1e-8, atol=1e-12)


def test_it_is_written_for_the_points_that_have_one():
    points = body()
    upper = points["x"][:, 1] > 1
    points["tag"] = upper
    points["stress"][upper] = SIGMA
    V = mpm.Space(points.grid)
    F = mpm.momentum(LAW, points, V.increment, V.test, tag=0)
    F += mpm.momentum(mpm.materials.Hencky(3e4, 0.2), points, V.increment, V.test, tag=1)
    mpm.QuasiStatic(F, V.increment, points, held(V))
    np.testing.assert_array_equal(points["be"][~upper], [[1, 1, 1, 0, 0, 0]] * (~upper).sum())
    assert np.ptp(points["be"][upper], axis=0).max() == 0.0
    assert abs(points["be"][upper][0, 3]) > 1e-5


def test_what_no_law_can_have_is_refused():
    points = body()
    points["stress"] = SIGMA
    with pytest.raises(StateError, match=r"VonMises: .*lie outside the yield surface"):
        problem_of(points, mpm.materials.VonMises(1e4, 0.3, radius=1.0))
    with pytest.raises(ParameterError, match=r"NeoHookean.* only from the deformation.*-40"):
        problem_of(points, mpm.materials.NeoHookean(1e4, 0.3))
    points["stress"] = np.array([[0, 1.0, 0], [0, 0, 0], [0, 0, 0]])
    with pytest.raises(ParameterError, match="must be symmetric"):
        problem_of(points)
    points["stress"] = 0.0 * SIGMA
    problem_of(points, mpm.materials.NeoHookean(1e4, 0.3)).step()


@pytest.mark.parametrize("strain", ["large", "jaumann"])
def test_a_stress_near_zero_belongs_to_its_law(strain):
    """Such as in the tail of a pulse: its strain is rounded as a difference from 1."""
    points = body()
    size = np.logspace(-25, 0, len(points))
    mpm.set_stress(LAW, points, size[:, None, None] * SIGMA, strain=strain)
    problem_of(points, strain=strain).step()


@pytest.mark.parametrize("kind", [mpm.QuasiStatic, mpm.Newmark, mpm.Explicit])
def test_another_law_than_the_problem_s_is_named(kind):
    points = body()
    mpm.set_stress(mpm.materials.Hencky(2e4, 0.3), points, SIGMA)
    match = r"Hencky\(E=10000.*: the stress \[\[-40\.0.*was set by mpm\.set_stress with another law"
    with pytest.raises(ParameterError, match=match):
        problem_of(points, kind=kind)
    mpm.set_stress(LAW, points, SIGMA)
    problem = problem_of(points, kind=kind)
    # and when the problem is there
    mpm.set_stress(mpm.materials.Hencky(2e4, 0.3), points, SIGMA)
    for _ in range(2):
        with pytest.raises(ParameterError, match=match):
            take(problem)
    mpm.set_stress(LAW, points, SIGMA)
    take(problem)
    np.testing.assert_allclose(points["stress"], [SIGMA] * len(points), rtol=1e-9, atol=1e-9)
    # what has moved may go on under another law, which takes the elastic strain over
    problem_of(points, mpm.materials.Hencky(2e4, 0.3), kind=kind)


@pytest.mark.parametrize("kind", [mpm.QuasiStatic, mpm.Explicit])
def test_another_formulation_than_the_problem_s_is_named(kind):
    points = body()
    problem = problem_of(points, kind=kind)
    mpm.set_stress(LAW, points, SIGMA, strain="small")
    with pytest.raises(StateError, match=r'have moved \d+ under strain="small".* strain="large"'):
        take(problem)
    mpm.set_stress(LAW, points, SIGMA)
    take(problem)
    mpm.set_stress(LAW, points, SIGMA, strain="jaumann")
    with pytest.raises(StateError, match='strain="jaumann"'):
        problem.step(*(() if kind is mpm.QuasiStatic else (2e-3,)))


def test_a_stress_changed_after_it_was_set_is_named():
    points = body()
    mpm.set_stress(LAW, points, SIGMA)
    points["stress"] *= 2
    with pytest.raises(ParameterError, match="or changed since"):
        problem_of(points)


@pytest.mark.parametrize(
    "law",
    [
        mpm.materials.MohrCoulomb(1e4, 0.3, 100.0, 30.0),
        mpm.materials.VonMises(1e4, 0.3, radius=3.0),
    ],
)
def test_strength_may_differ_but_not_elasticity(law):
    """Reduced strength begins with a stress that it may not bear."""
    points = body()
    mpm.set_stress(LAW, points, SIGMA)
    problem_of(points, law)


def test_exponential_elasticity():
    points = body()
    mpm.set_stress(CLAY, points, 1e3 * SIGMA)
    problem_of(points, CLAY).step()
    points = body()
    mpm.set_stress(CLAY, points, 1e3 * SIGMA)
    other = mpm.materials.CamClay(
        swelling=0.02,
        compression=0.13,
        M=1.05,
        mu0=5.4e6,
        alpha=0.0,
        reference_pressure=2e4,
        preconsolidation=2e5,
    )
    with pytest.raises(ParameterError, match="another law"):
        problem_of(points, other)


def test_points_know_which_marks_are_of_strains():
    """The folder of the points cannot import the marks of the formulations."""
    assert {mark for name, mark in MARKS.items() if name != UMAT} == set(OF_STRAIN)
