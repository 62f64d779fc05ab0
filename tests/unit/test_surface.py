"""Loads on faces: forces and moments, follower pressure and its tangent, footings, errors."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import Linearised, dense, unit_grid
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.optimize import brentq

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    FieldShapeError,
    ParameterError,
    UnsupportedGridError,
)
from dolfinmpm.materials.base import lame

COMM = MPI.COMM_WORLD
BASES = ("linear", "gimp", "bspline2", "bspline3")


def block(basis="gimp", high=(4.3, 2.6), cells=(6, 4), d=2, per_cell=2):
    """A block in the corner of a grid of unit cells that it does not fit."""
    if d == 2:
        kind = mesh.CellType.quadrilateral
        grid = mesh.create_rectangle(COMM, [(0, 0), cells], cells, kind)
    else:
        kind = mesh.CellType.hexahedron
        grid = mesh.create_box(COMM, [(0,) * 3, cells], cells, kind)
    points = mpm.fill(grid, mpm.Box((0.0,) * d, high), per_cell, 1.0)
    return grid, points, mpm.Space(grid, basis)


def face(points, axis, at, normal, **options):
    return mpm.Surface(points, lambda x: np.isclose(x[axis], at), normal, **options)


def problem_of(points, V, F, bcs=(), E=1e3, nu=0.3, **options):
    law = mpm.materials.Hencky(E=E, nu=nu)
    internal = mpm.momentum(law, points, V.increment, V.test)
    return mpm.QuasiStatic(internal + F, V.increment, points, bcs, **options)


def resultants(problem):
    """Force and moment about the origin of the nodal loads."""
    operator = problem.operator()
    f = -operator.external[0]
    x = operator.here.fields[0].basis.node_coordinates()[: len(f), : f.shape[1]]
    return f.sum(axis=0), np.einsum("ai,aj->ij", x, f)


@pytest.mark.parametrize("basis", BASES)
def test_force_and_moment_are_those_of_the_face(basis):
    grid, points, V = block(basis)
    # a body that is sheared and turned already carries its face along
    shear = np.array([[1.1, 0.2], [-0.1, 0.9]])
    points["F"] = shear
    right = face(points, 0, 4.3, (1, 0))
    assert right.total_area == pytest.approx(2.6)
    t = fem.Constant(grid, (3.0, -2.0))
    force, moment = resultants(problem_of(points, V, right.traction(t, V.test)))
    np.testing.assert_allclose(force, 2.6 * t.value, rtol=1e-12)
    at = points["x"] + right.offset.array @ shear.T
    size = np.linalg.norm(right.area.array, axis=1)
    exact = np.einsum("p,pi,j->ij", size, at, t.value)
    np.testing.assert_allclose(moment, exact, rtol=1e-12)


def test_force_is_spread_over_the_area():
    grid, points, V = block(high=(4.3, 2.6, 1.7), cells=(5, 3, 2), d=3)
    top = face(points, 2, 1.7, (0, 0, 1), name="top")
    assert top.total_area == pytest.approx(4.3 * 2.6)
    P = fem.Constant(grid, (1.0, 2.0, -5.0))
    force, moment = resultants(problem_of(points, V, top.force(P, V.test)))
    np.testing.assert_allclose(force, P.value, rtol=1e-12)
    np.testing.assert_allclose(moment, np.outer([2.15, 1.3, 1.7], P.value), rtol=1e-12)


def test_arrays_on_triangles():
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 4)], (4, 4))
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), 2, 1.0)
    V = mpm.Space(grid)
    top = points["x"][:, 1] > 1.6
    R = np.where(top[:, None], np.column_stack([0 * top, 2 - points["x"][:, 1]]), 0.0)
    A = np.where(top[:, None], np.array([0.0, 4 / top.sum()]), 0.0)
    surface = mpm.Surface.from_arrays(points, R, A)
    force, moment = resultants(problem_of(points, V, surface.traction((0, -1.0), V.test)))
    np.testing.assert_allclose(force, [0, -4.0], atol=1e-12)
    assert moment[1, 1] == pytest.approx(-8.0)


def test_uniform_dead_traction_is_exact():
    """Nominal stress M ln λ/λ of a column between smooth walls, in one large step."""
    grid, points, V = block(high=(6.0, 2.6))
    top = face(points, 1, 2.6, (0, 1))
    t = fem.Constant(grid, (0.0, -300.0))
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = problem_of(points, V, top.traction(t, V.test), bcs)
    problem.step()
    lmbda, mu = lame(1e3, 0.3)
    stretch = brentq(lambda s: (lmbda + 2 * mu) * np.log(s) / s + 300, 0.5, 1)
    np.testing.assert_allclose(points["F"][:, 1, 1], stretch, rtol=1e-8)
    np.testing.assert_allclose(top.mean_displacement(), [0, 2.6 * (stretch - 1)], atol=1e-7)


@pytest.mark.parametrize("basis", ["linear", "gimp"])
def test_follower_pressure_all_around_is_exact(basis):
    """A free body under pressure p has the Cauchy stress −p: the area shrinks with it."""
    grid, points, V = block(basis)
    p = fem.Constant(grid, 400.0)
    u, v = V.increment, V.test
    load = face(points, 0, 4.3, (1, 0)).pressure(p, u, v)
    load += face(points, 1, 2.6, (0, 1)).pressure(p, u, v)
    problem = problem_of(points, V, load, mpm.rollers(V, "left", "bottom"))
    problem.step()
    lmbda, mu = lame(1e3, 0.3)
    strain = brentq(lambda e: 2 * (lmbda + mu) * e + 400 * np.exp(2 * e), -1, 0)
    np.testing.assert_allclose(points["F"], np.exp(strain) * np.eye(2)[None].repeat(len(points), 0),
                               atol=1e-8)  # fmt: skip
    for i in (0, 1):
        np.testing.assert_allclose(points["stress"][:, i, i], -400, rtol=1e-7)


@pytest.mark.parametrize("basis", BASES)
def test_tangent_of_a_follower_pressure(basis):
    grid, points, V = block(basis, cells=(5, 3), per_cell=2)
    points["F"] = [[1.1, 0.2], [-0.1, 0.9]]
    u, v = V.increment, V.test
    surface = face(points, 0, 4.3, (1, 0))
    p = fem.Constant(grid, 200.0)
    # not constant in space either
    problem = problem_of(points, V, surface.pressure(p * surface.position(u)[1], u, v))
    linearised = Linearised(problem)
    rng = np.random.default_rng(1)
    at = 0.02 * rng.standard_normal(linearised.size)
    K = dense(linearised.tangent(at))
    residual = linearised.residual
    w = rng.standard_normal(at.size)
    step = 1e-6
    slope = (residual(at + step * w) - residual(at - step * w)) / (2 * step)
    np.testing.assert_allclose(K @ w, slope, atol=1e-6 * np.abs(slope).max())


# -- footings -----------------------------------------------------------------


def footing(stiffness=None, rough=True, width=6.0, basis="gimp", first=0.0, **options):
    grid, points, V = block(basis, high=(6.0, 2.6), cells=(6, 4), per_cell=2)
    s = fem.Constant(grid, first)
    under = mpm.Surface(points, lambda x: np.isclose(x[1], 2.6) & (x[0] < width), (0, 1))
    soft = {"E": 1e3} if stiffness is None else {"stiffness": stiffness}
    foot = mpm.RigidFooting(under, s, rough=rough, **soft)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    F = foot.contact(V.increment, V.test)
    return problem_of(points, V, F, bcs, **options), foot, s


def test_footing_over_the_whole_width_is_exact():
    problem, foot, s = footing(rough=False)
    s.value = 0.4
    problem.step()
    lmbda, mu = lame(1e3, 0.3)
    stretch = 1 + foot.surface.mean_displacement()[1] / 2.6
    nominal = -(lmbda + 2 * mu) * np.log(stretch) / stretch
    assert foot.load() == pytest.approx(6 * nominal, rel=1e-7)
    np.testing.assert_allclose(foot.reaction(), [0, -foot.load()], atol=1e-9 * foot.load())
    gap = np.abs(foot.gaps()).max()
    assert gap == pytest.approx(nominal / foot.stiffness, rel=1e-6)
    assert gap < 1e-4 * 0.4


def test_gaps_do_not_accumulate():
    one, a, s = footing(width=3.0)
    s.value = 0.05
    one.step()
    many, b, s = footing(width=3.0)
    for k in range(1, 21):
        s.value = 0.05 * k / 20
        many.step()
    assert b.load() == pytest.approx(a.load(), rel=5e-3)
    assert np.abs(b.gaps()).max() == pytest.approx(np.abs(a.gaps()).max(), rel=0.05)


@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2"])
def test_reaction_is_insensitive_to_the_stiffness(basis):
    loads = []
    for factor in (1e3, 1e4, 1e5):
        problem, foot, s = footing(factor * 1e3, width=3.0, basis=basis)
        for k in range(1, 5):
            s.value = 0.1 * k
            problem.step()
        loads.append(foot.load())
    assert footing(width=3.0)[1].stiffness == pytest.approx(1e7)
    assert loads[1] == pytest.approx(loads[2], rel=1e-3)
    assert abs(loads[1] - loads[2]) < abs(loads[0] - loads[2])


def test_rough_and_smooth():
    loads, sideways = [], []
    for rough in (True, False):
        problem, foot, s = footing(rough=rough, width=3.0)
        s.value = 0.3
        problem.step()
        loads.append(foot.load())
        sideways.append(np.abs(foot.surface.displacements()[:, 0] *
                               (foot.surface.area.array[:, 1] > 0)).max())  # fmt: skip
    assert loads[0] > 1.004 * loads[1]
    assert sideways[0] < 1e-3 < 0.01 < sideways[1]


def test_parts_of_a_step_scale_the_settlement():
    # relative to the forces of the stiff footing, which are 1e5 times those of the ground
    problem, foot, s = footing(width=3.0, tolerance=1e-13)
    problem.share = 0.25
    s.value = 0.2
    assert problem.step().parts == 3
    assert s.value == 0.2
    whole, other, s = footing(width=3.0, tolerance=1e-13)
    for share in (0.25, 0.75, 1.0):
        s.value = 0.2 * share
        whole.step()
    assert foot.load() == pytest.approx(other.load(), rel=1e-8)


def test_footing_on_what_has_settled_already():
    grid, points, V = block(high=(6.0, 2.6))
    top = face(points, 1, 2.6, (0, 1))
    t, s = fem.Constant(grid, (0.0, -100.0)), fem.Constant(grid, 0.0)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    u, v = V.increment, V.test
    problem_of(points, V, top.traction(t, v), bcs).step()
    foot = mpm.RigidFooting(top, s, E=1e3)
    assert np.abs(foot.gaps()).max() < 1e-14
    problem = problem_of(points, V, foot.contact(u, v) + top.traction(t, v), bcs)
    problem.step()
    assert abs(foot.load()) < 1.0


def test_a_second_footing_leaves_the_first_alone():
    problem, foot, s = footing(width=3.0)
    s.value = 0.1
    problem.step()
    load = foot.load()
    with pytest.raises(ParameterError, match=r"settlement = 0\.1 .* its own constant"):
        mpm.RigidFooting(foot.surface, s, E=1e3)
    second = mpm.RigidFooting(foot.surface, fem.Constant(problem.points.grid, 0.0), E=1e3)
    assert second.load() == pytest.approx(0.0, abs=1e-9)
    assert foot.load() == load > 1


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_what_a_settlement_holds_at_first_the_first_step_brings_about(share):
    """Also in parts of a step: 11 897 N and not 0."""
    loads = []
    for first in (0.2, 0.0):
        problem, foot, s = footing(width=3.0, first=first)
        problem.share = share
        s.value = 0.2
        problem.step()
        loads.append(foot.load())
    assert loads[0] == pytest.approx(loads[1], rel=1e-12)
    assert loads[0] > 10


@pytest.mark.parametrize("basis", ["linear", pytest.param("gimp", marks=pytest.mark.long)])
def test_follower_pressure_in_1d_and_3d(basis):
    lmbda, mu = lame(1e3, 0.3)
    grid = mesh.create_interval(COMM, 5, (0.0, 5.0))
    points = mpm.fill(grid, mpm.Box((0.0,), (3.7,)), 2, 1.0)
    V = mpm.Space(grid, basis)
    p = fem.Constant(grid, 300.0)
    load = face(points, 0, 3.7, (1.0,)).pressure(p, V.increment, V.test)
    problem_of(points, V, load, mpm.fixed(V, "left")).step()
    np.testing.assert_allclose(points["stress"][:, 0, 0], -300, rtol=1e-7)

    grid, points, V = block(basis, high=(2.0, 1.6, 1.3), cells=(2, 2, 2), d=3)
    p = fem.Constant(grid, 300.0)
    sides = [face(points, k, at, tuple(np.eye(3)[k])) for k, at in enumerate((2.0, 1.6, 1.3))]
    load = sum((s.pressure(p, V.increment, V.test) for s in sides[1:]),
               start=sides[0].pressure(p, V.increment, V.test))  # fmt: skip
    bcs = mpm.rollers(V, "left", "bottom", "front")
    problem_of(points, V, load, bcs).step()
    strain = brentq(lambda e: (3 * lmbda + 2 * mu) * e + 300 * np.exp(3 * e), -1, 0)
    expected = np.exp(strain) * np.eye(3)[None].repeat(len(points), 0)
    np.testing.assert_allclose(points["F"], expected, atol=1e-8)


def test_history(tmp_path):
    problem, foot, s = footing(width=3.0)
    history = mpm.History()
    for k in range(3):
        s.value = 0.02 * k
        problem.step()
        history.record(settlement=s.value, load=foot.load())
    assert len(history) == 3
    assert history.names == ("settlement", "load")
    np.testing.assert_allclose(history["settlement"], [0, 0.02, 0.04])
    for name in ("curve.csv", "curve.json"):
        history.write(tmp_path / name)
        rows = mpm.study.read_table(tmp_path / name)
        assert [row["load"] for row in rows] == list(history["load"])
    with pytest.raises(ParameterError, match="the first had settlement, load"):
        history.record(settlement=1.0)
    with pytest.raises(ParameterError, match="must be a single number, or an array of 2 or 3"):
        history.record(settlement=1.0, load=np.eye(2))
    forces = mpm.History()
    forces.record(force=foot.reaction(), moment=np.array([2.0]))
    assert forces.names == ("force_x", "force_y", "moment")
    assert forces["moment"].tolist() == [2.0]
    assert forces["force_y"].tolist() == [foot.reaction()[1]]
    assert repr(forces) == "History of 1 records: force_x, force_y, moment"
    with pytest.raises(KeyError, match="nothing is recorded as 'time'"):
        history["time"]
    with pytest.raises(ParameterError, match=r"\.csv or \.json"):
        history.write(tmp_path / "curve.txt")


# -- errors -------------------------------------------------------------------


def test_a_face_behind_a_sliver_is_inside_the_body():
    """A top that cuts the next cell by a millionth: both layers have faces next to it."""
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5 + 1e-7)), 2, 1.0, exact=True)
    with pytest.raises(ParameterError, match="8 of 16 chosen faces are inside the body"):
        mpm.Surface(points, lambda x: np.isclose(x[1], 0.5), (0, 1))
    top = mpm.Surface(points, lambda x: x[1] > 0.5 + 5e-8, (0, 1))
    assert top.total_area == pytest.approx(1.0)


def test_errors():
    _, points, _ = block()
    for normal in ((1, 1), (0, 2), (0, 0, 1), (0.0, 0.0), (0.6, 0.8)):
        with pytest.raises(ParameterError, match="must be an axis of 2D"):
            face(points, 0, 4.3, normal)
    with pytest.raises(EmptyShapeError, match=r"lie between 0\.\d+ and 4\.3 m"):
        face(points, 0, 4.2, (1, 0))
    with pytest.raises(ParameterError, match="27 of 36 chosen faces are inside the body"):
        mpm.Surface(points, lambda x: x[1] > 1.4, (0, 1))
    with pytest.raises(ParameterError, match="6 of 6 chosen faces are inside the body"):
        face(points, 0, 4.0, (1, 0))
    triangles = mesh.create_unit_square(COMM, 3, 3)
    with pytest.raises(UnsupportedGridError, match=r"Surface\.from_arrays"):
        face(mpm.fill(triangles, mpm.Box((0, 0), (1, 1)), 2, 1.0), 1, 1.0, (0, 1))
    with pytest.raises(ParameterError, match="should return"):
        mpm.Surface(points, lambda x: x[1], (0, 1))
    named = face(points, 0, 4.3, (1, 0), name="right")
    assert points.right_area is named.area
    with pytest.raises(ParameterError, match="'right' already"):
        face(points, 0, 4.3, (1, 0), name="right")
    zero = np.zeros((len(points), 2))
    with pytest.raises(FieldShapeError, match="area should have shape"):
        mpm.Surface.from_arrays(points, zero, zero[:, 0])
    with pytest.raises(EmptyShapeError, match="all areas"):
        mpm.Surface.from_arrays(points, zero, zero)
    with pytest.raises(ParameterError, match="must be finite"):
        mpm.Surface.from_arrays(points, zero + np.nan, zero)


def test_errors_of_footings():
    grid, points, _ = block()
    top = face(points, 1, 2.6, (0, 1))
    s = fem.Constant(grid, 0.0)
    with pytest.raises(ParameterError, match="needs the Young's modulus"):
        mpm.RigidFooting(top, s)
    with pytest.raises(ParameterError, match="stiffness = -1"):
        mpm.RigidFooting(top, s, stiffness=-1.0)
    with pytest.raises(ParameterError, match="scalar dolfinx"):
        mpm.RigidFooting(top, 0.3, E=1.0)
    with pytest.raises(ParameterError, match="scalar dolfinx"):
        mpm.RigidFooting(top, fem.Constant(grid, (0.0, 1.0)), E=1.0)
    arrays = mpm.Surface.from_arrays(points, top.offset.array, top.area.array)
    with pytest.raises(ParameterError, match="no single normal"):
        mpm.RigidFooting(arrays, s, E=1.0)
