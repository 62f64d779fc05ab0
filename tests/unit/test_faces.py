"""Loads at the faces of points that have moved: uniform stress, footings, stencils, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError, FormError
from dolfinmpm.basis.facestencils import _ends, at_faces
from dolfinmpm.basis.stencils import selected
from dolfinmpm.materials import Hencky, NeoHookean

PRESSURE = 3e5


def column(d=2, n=8, refined=False, axisymmetric=False, **space):
    """A column of height 1 m with its top in the grid, held at its sides, and a load on its top."""
    lines = [*[np.linspace(0, 2 / n, 3)] * (d - 1), np.linspace(0, 1.25, 5 * n // 4 + 1)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    shape = mpm.Box((0,) * d, (2 / n,) * (d - 1) + (1.0,))
    points = mpm.fill(grid, shape, 2, 1000.0, axisymmetric=axisymmetric)
    if refined:
        space |= {"refine": lambda x: np.where(x[1] > 0.7, 0.05, 0.2), "levels": 2}
    V = mpm.Space(grid, space.pop("basis", "gimp"), **space)
    top = mpm.Surface(points, lambda x: x[d - 1] > 1 - 1e-9, (0,) * (d - 1) + (1,))
    sides = ("bottom", "left", "right", *(("front", "back") if d == 3 else ()))
    F = mpm.momentum(NeoHookean(1e6, 0.0), points, V.increment, V.test)
    return points, V, top, F, mpm.rollers(V, *sides)


@pytest.mark.parametrize("basis", ["gimp", "bspline2", "bspline3"])
@pytest.mark.parametrize("stabilisation", ["none", "ghost", "aggregation"])
def test_stress_is_uniform_under_a_face_that_passes_cells(basis, stabilisation):
    points, V, top, F, bcs = column(basis=basis)
    p = fem.Constant(points.grid, 0.0)
    F += top.pressure(p, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)
    for k in range(1, 6):
        p.value = PRESSURE * k / 5
        problem.step()
        assert np.abs(points["stress"][:, 1, 1] / p.value + 1).max() < 1e-8
    # through a cell and a half
    assert top.mean_displacement()[1] < -0.2


@pytest.mark.parametrize(
    "options",
    [{"d": 3, "n": 4}, {"configuration": "total"}, {"axisymmetric": True}, {"refined": True}],
    ids=["3D", "total", "axisymmetric", "leaves"],
)
def test_stress_is_uniform_under_a_traction(options):
    points, V, top, F, bcs = column(**options)
    d = points.gdim
    t = fem.Constant(points.grid, (0.0,) * d)
    F += top.traction(t, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    for k in range(1, 6):
        t.value[d - 1] = -PRESSURE * k / 5
        problem.step()
        # NeoHookean with ν = 0: the stress of the section that stays as wide as it was
        assert np.abs(points["stress"][:, d - 1, d - 1] / t.value[d - 1] - 1).max() < 1e-8


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_stress_is_uniform_under_a_footing(basis):
    points, V, top, F, bcs = column(basis=basis)
    settlement = fem.Constant(points.grid, 0.0)
    footing = mpm.RigidFooting(top, settlement, E=1e6)
    F += footing.contact(V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    for k in range(1, 6):
        settlement.value = 0.05 * k
        problem.step()
    stress = points["stress"][:, 1, 1]
    assert np.ptp(stress) < 1e-10 * abs(stress.mean())
    assert footing.load() == pytest.approx(-0.25 * stress.mean(), rel=1e-9)


@pytest.mark.parametrize("refined", [False, True], ids=["cells", "leaves"])
@pytest.mark.parametrize("corners", ["domains", "material"])
@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_stress_is_uniform_between_rigid_plates(basis, corners, refined):
    """Between smooth plates anywhere in the cells, with domains that grid lines cut."""
    lines = [np.arange(-4, 21) / 8 + 0.04, np.linspace(-0.125, 0.75, 8)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 0.5)), 2, 1000.0, aligned="body")
    # the same cells, as leaves
    space = {"refine": lambda x: np.full(x.shape[1], 0.125), "levels": 1} if refined else {}
    V = mpm.Space(grid, basis, **space)
    u, v = V.increment, V.test
    F = mpm.momentum(NeoHookean(1e6, 0.3), points, u, v)
    # rigid motions along the plates are held softly
    F += 1e-3 * ufl.inner(u, v) * points.dX
    plate = mpm.RigidBody(mpm.Box((-0.3, 0.5), (2.3, 0.7)), increment=(0, -0.02))
    F += mpm.contact(plate, points, u, v, corners=corners)
    base = mpm.RigidBody(mpm.Box((-0.3, -0.1), (2.3, 0.0)), increment=(0, 0))
    F += mpm.contact(base, points, u, v, corners=corners)
    problem = mpm.QuasiStatic(F, u, points, [], stabilisation="ghost")
    for _ in range(4):
        problem.step()
        stress = points["stress"][:, 1, 1]
        assert np.ptp(stress) < 1e-7 * abs(stress.mean())
    assert plate.force[1] == pytest.approx(-base.force[1], rel=1e-6)


@pytest.mark.parametrize("stabilisation", ["none", "soft", "ghost"])
def test_equal_pulls_move_the_end_of_a_row_equally(stabilisation):
    """With F-bar, a thin part beyond a grid line has no volumetric stiffness of its own."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 4.01, 0.25), [0, 0.25, 0.5]])
    points = mpm.fill(grid, mpm.Box((1, 0), (3, 0.5)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    load = fem.Constant(grid, (0.0, 0.0))
    clay = Hencky(1e7, 0.45)
    F = mpm.momentum(clay, points, V.increment, V.test, strain="small", fbar=True)
    end = mpm.Surface(points, lambda x: np.isclose(x[0], 3), (1, 0))
    F += end.traction(load, V.test)
    bcs = mpm.rollers(V, "bottom", "top") + mpm.prescribed(V, lambda x: np.isclose(x[0], 1), 0)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)
    moved = [0.0]
    for k in (1, 2):
        load.value[0] = k * 2e4
        problem.step()
        moved.append(end.mean_displacement()[0])
    first, second = np.diff(moved)
    assert second == pytest.approx(first, rel=5e-3)


# no body is left at the sides
@pytest.mark.filterwarnings("ignore::dolfinmpm._platform.errors.IdleConditionWarning")
@pytest.mark.parametrize("refined", [False, True], ids=["cells", "leaves"])
@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2"])
def test_stencils_at_faces_have_unit_sums_and_the_places_of_the_faces(basis, refined):
    points, V, top, F, bcs = column(basis=basis, refined=refined, n=4)
    # domains that stay in the grid
    keep = np.abs(points["x"][:, 0] - 0.25) < 0.13
    points.remove(~keep)
    # faces that pass grid lines, and points that are sheared and turned
    points["x"] += (0.0, 0.03)
    points["F"] = np.array([[0.9, 0.3], [-0.25, 1.1]])
    points["l"] = 1.05 * points["l0"]
    here = mpm.QuasiStatic(F, V.increment, points, bcs).operator().here
    (field,) = here.fields
    reach = np.einsum("pij,pj->pi", points["F"], points[top.offset.name])
    rows = np.flatnonzero(np.any(reach, axis=1))
    own = selected(field.full_stencils, np.any(reach, axis=1))
    faces = at_faces(field.basis, own, here.where, reach)
    x = field.basis.node_coordinates()[:, :2]
    for p in rows:
        nodes, N, _ = faces.row(p)
        assert N.sum() == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(N @ x[nodes], points["x"][p] + reach[p], atol=1e-10)


def test_faces_see_the_linear_functions_at_the_ends_of_their_domains():
    points, V, top, F, bcs = column()
    points["x"] += (0.0, 0.04)
    here = mpm.QuasiStatic(F, V.increment, points, bcs).operator().here
    (field,) = here.fields
    reach = points[top.offset.name]
    chosen = np.any(reach, axis=1)
    faces = at_faces(field.basis, selected(field.full_stencils, chosen), here.where, reach)
    y = field.basis.node_coordinates()[:, 1]
    for p in np.flatnonzero(chosen):
        nodes, N, _ = faces.row(p)
        for height in np.unique(y[nodes]):
            there = max(0.0, 1 - abs(1.04 - height) * 8)
            assert N[y[nodes] == height].sum() == pytest.approx(there, abs=1e-12)


def test_points_without_a_length_in_a_direction_have_faces_across_the_other():
    """The axis of the face had been that without a length, by 0/0."""
    x, half, reach = np.zeros((1, 2)), np.array([[0.0, 0.1]]), np.array([[0.0, 0.1]])
    to, left = _ends(x, half, reach)
    np.testing.assert_array_equal(to, reach)
    np.testing.assert_array_equal(left, 0.0)


def test_a_load_that_is_not_finite_names_its_point():
    points, V, top, F, bcs = column()
    load = points.add_field("load", (), "Pa")
    points["load"][-1] = np.nan
    F += top.pressure(load, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, max_halvings=0)
    with pytest.raises(ConvergenceError, match=r"point \d+ at .* a term of the form is not finite"):
        problem.step()


def test_the_stress_of_a_law_at_faces_is_refused():
    points, V, top, F, bcs = column()
    u, v = V.increment, V.test
    law = Hencky(1e6, 0.0)
    F, stress = mpm.momentum(law, points, u, v), mpm.stress(law, points, u)
    F += top.density * ufl.dot(ufl.dot(stress, top.area), v) * top.dX
    with pytest.raises(FormError, match=r"integrate over points\.dX"):
        mpm.QuasiStatic(F, u, points, bcs)
