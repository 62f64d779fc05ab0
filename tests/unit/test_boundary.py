"""Markers of boundaries: where they are, how large, whose state they have, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    CheckpointError,
    PointsOutsideGridError,
)
from dolfinmpm.body.contours import contour, inside, kuhn
from dolfinmpm.body.markerstate import take_state

LAW = mpm.materials.Hencky(E=10.0, nu=0.3)


def scene(kind="quadrilateral", n=4, box=((0.1, 0.1), (0.9, 0.8)), basis="linear"):
    grid = unit_grid(kind, n)
    points = mpm.fill(grid, mpm.Box(*box), 2, 1.0)
    return grid, points, mpm.Space(grid, basis)


@pytest.mark.parametrize("kind", ["quadrilateral", "triangle", "distorted quadrilateral"])
def test_markers_of_a_polygon(kind):
    """They integrate what is linear along it exactly, with normals that point outwards."""
    _, points, _ = scene(kind)
    corners = np.array([(0.13, 0.12), (0.87, 0.2), (0.71, 0.77), (0.2, 0.66)])
    boundary = mpm.Boundary.from_polygon(points, corners)
    x, area = boundary.markers["x"], boundary.markers["area"]
    ends = np.roll(corners, -1, axis=0)
    length = np.linalg.norm(ends - corners, axis=1)
    assert boundary.total_area == pytest.approx(length.sum(), rel=1e-12)
    size = np.linalg.norm(area, axis=1)
    np.testing.assert_allclose(size @ x, length @ (corners + ends) / 2, rtol=1e-8)
    # Gauss's theorem: ∫ n = 0, and ∫ x·n is twice the area
    cross = corners[:, 0] * ends[:, 1] - corners[:, 1] * ends[:, 0]
    np.testing.assert_allclose(area.sum(axis=0), 0.0, atol=1e-12)
    assert np.sum(x * area) == pytest.approx(cross.sum(), rel=1e-8)
    assert boundary.follows
    assert boundary.activates


@pytest.mark.parametrize("d", [2, 3])
def test_markers_of_a_level_set(d):
    kind = {2: "quadrilateral", 3: "hexahedron"}[d]
    grid = unit_grid(kind, 5)
    points = mpm.fill(grid, mpm.Ball((0.5,) * 3, 0.3) if d == 3 else mpm.Disc((0.5, 0.5), 0.3), 2,
                      1.0)  # fmt: skip
    exact = {2: 2 * np.pi * 0.3, 3: 4 * np.pi * 0.09}[d]
    errors = []
    for parts in (1, 3):
        ball = mpm.Boundary.from_level_set(
            points, lambda x: np.linalg.norm(x.T - 0.5, axis=1) - 0.3, subdivisions=parts
        )
        errors.append(abs(ball.total_area / exact - 1))
        markers = ball.markers
        outward = np.sum((markers["x"] - 0.5) * markers["area"], axis=1)
        assert (outward > 0).all()
        assert np.abs(np.linalg.norm(markers["x"] - 0.5, axis=1) - 0.3).max() < 0.05 / parts**2
    assert errors[0] < 0.15
    assert errors[1] < errors[0] / 4


def test_contours_and_insides_of_simplices_share_their_edges():
    rng = np.random.default_rng(3)
    for d in (2, 3):
        cube = np.array(list(np.ndindex(*(2,) * d)), float)[kuhn(d)]
        for _ in range(20):
            n = rng.normal(size=d)
            values = cube @ n - n.sum() * 0.5 + 0.1
            pieces = contour(cube, values)
            np.testing.assert_allclose(pieces @ n, n.sum() * 0.5 - 0.1, atol=1e-12)
            if d == 2:
                for side in (1, -1):
                    part = inside(cube, side * values)
                    assert (side * (part @ n - n.sum() * 0.5 + 0.1) < 1e-12).all()
                both = [np.abs(np.linalg.det(p[:, 1:] - p[:, :1])).sum() / 2
                        for p in (inside(cube, values), inside(cube, -values))]  # fmt: skip
                assert sum(both) == pytest.approx(1.0)


def test_markers_at_a_side():
    _, points, _ = scene("hexahedron", 3, ((0,) * 3, (1,) * 3))
    for side, n in (("left", (-1, 0, 0)), ("back", (0, 1, 0)), ("top", (0, 0, 1))):
        wall = mpm.Boundary.from_side(points, side)
        assert wall.name == side
        assert not wall.follows
        assert not wall.activates
        assert wall.total_area == pytest.approx(1.0)
        normal = wall.markers["area"] / wall.markers["V"][:, None]
        np.testing.assert_allclose(normal, np.broadcast_to(n, normal.shape))


def test_markers_have_the_state_of_the_nearest_point():
    _, points, _ = scene()
    field = points.add_field("heat", (2,), "K", lambda x: np.stack([x[0], 3 * x[1]], axis=1))
    assert field.ufl_shape == (2,)
    points["tag"] = (points["x"][:, 0] > 0.5).astype(np.int32)
    boundary = mpm.Boundary.from_polygon(points, [(0.1, 0.1), (0.9, 0.1)], closed=False)
    points["F"] = points["F"] * 1.01
    take_state(boundary)
    markers = boundary.markers
    apart = np.linalg.norm(points["x"][None] - markers["x"][:, None], axis=2)
    nearest = np.argmin(apart, axis=1)
    for name in ("heat", "tag", "F"):
        np.testing.assert_array_equal(markers[name], points[name][nearest])
    np.testing.assert_array_equal(markers["V"], markers["V0"])


def test_cells_of_a_body_s_boundary_are_active_and_those_of_walls_are_not():
    # the body ends a little before a grid line, its boundary lies a little behind it
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0.25, 0.25), (0.5, 0.5)), 2, 1.0)
    V = mpm.Space(grid, "linear")
    F = mpm.momentum(LAW, points, V.increment, V.test)
    plain = mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost")
    cells = [plain.activate().active_cells]
    for follows in (True, False):
        line = mpm.Boundary.from_polygon(
            points, [(0.501, 0.3), (0.501, 0.45)], closed=False, follows=follows
        )
        whole = F + mpm.dirichlet(line, V.increment, V.test, law=LAW, penalty=10.0)
        problem = mpm.QuasiStatic(whole, V.increment, points, stabilisation="ghost")
        cells.append(problem.activate().active_cells)
    assert cells[1] > cells[0] == cells[2]


def test_pressure_on_a_boundary_is_that_on_faces():
    """An inflated block; the same forces as by a surface whose faces are those of points."""
    states = []
    for kind in ("surface", "boundary"):
        grid = unit_grid("quadrilateral", 4)
        points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.75)), 2, 1.0)
        V = mpm.Space(grid, "gimp")
        u, v = V.increment, V.test
        p = fem.Constant(grid, 0.3)
        F = mpm.momentum(LAW, points, u, v)
        if kind == "surface":
            top = mpm.Surface(points, lambda x: x[1] > 0.74, (0, 1))
        else:
            top = mpm.Boundary.from_polygon(points, [(1.0, 0.75), (0.0, 0.75)], closed=False)
        F += top.pressure(p, u, v)
        bcs = mpm.rollers(V, "left", "right", "bottom")
        mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost").step()
        states.append(points["stress"][:, 1, 1].mean())
    np.testing.assert_allclose(states, -0.3, rtol=1e-3)


def test_nothing_is_kept_of_a_step_that_fails():
    grid, points, V = scene()
    boundary = mpm.Boundary.from_polygon(points, [(0.9, 0.1), (0.1, 0.1)][::-1], closed=False)
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(LAW, points, V.increment, V.test)
    F += mpm.dirichlet(boundary, V.increment, V.test, g, law=LAW)
    problem = mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost", max_halvings=0)
    g.value[1] = 0.01
    problem.step()
    before = {name: values.copy() for name, values in boundary.markers.fields.items()}
    g.value[1] = -0.5
    with pytest.raises((PointsOutsideGridError, mpm.errors.ConvergenceError)):
        problem.step()
    for name in ("x", "area", "V", "dirichlet1_gap", "dirichlet1_reached", "dirichlet1_force"):
        np.testing.assert_array_equal(boundary.markers[name], before[name], err_msg=name)
    g.value[1] = 0.02
    problem.step()
    np.testing.assert_allclose(boundary.markers["x"][:, 1], 0.12, atol=1e-6)


def test_a_checkpoint_knows_its_boundaries(tmp_path):
    _, points, V = scene()
    F = mpm.momentum(LAW, points, V.increment, V.test)
    boundary = mpm.Boundary.from_polygon(points, [(0.1, 0.1), (0.9, 0.1)], closed=False)
    held = F + mpm.dirichlet(boundary, V.increment, V.test, law=LAW)
    problem = mpm.QuasiStatic(held, V.increment, points, stabilisation="ghost")
    problem.step()
    problem.save(tmp_path / "a.npz")
    other = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"), stabilisation="ghost")
    with pytest.raises(CheckpointError, match="its boundaries is"):
        other.load(tmp_path / "a.npz")


@pytest.mark.parametrize("configuration", ["updated", "total"])
def test_a_run_goes_on_from_a_checkpoint(tmp_path, configuration):
    """Bit for bit, with what the markers and a wall in space keep."""

    def build():
        grid, points, _ = scene(n=5, box=((0.1, 0.1), (0.7, 0.8)))
        V = mpm.Space(grid, "gimp", configuration=configuration)
        u, v = V.increment, V.test
        side = mpm.Boundary.from_polygon(points, [(0.1, 0.8), (0.1, 0.1)], closed=False)
        ends = [(0.73, 0.0), (0.78, 1.0)]
        wall = mpm.Boundary.from_polygon(points, ends, closed=False, follows=False)
        way = fem.Constant(grid, (0.0, 0.0))
        F = mpm.momentum(LAW, points, u, v) + mpm.dirichlet(side, u, v, way, law=LAW)
        F += mpm.signorini(wall, u, v, law=LAW, friction=0.3)
        problem = mpm.QuasiStatic(F, u, points, stabilisation="ghost")

        def to(steps):
            while len(problem.history) < steps:
                way.value[:] = 0.02 * (len(problem.history) + 1), 0.005 * len(problem.history)
                problem.step()
            return problem, points, wall

        return to

    _, points, wall = build()(4)
    half, *_ = build()(2)
    half.save(tmp_path / "half.npz")
    again = build()
    again(0)[0].load(tmp_path / "half.npz")
    _, others, other = again(4)
    assert wall.force()[0] < -0.1
    for name in ("x", "F", "stress"):
        np.testing.assert_array_equal(others[name], points[name], err_msg=name)
    np.testing.assert_array_equal(other.force(), wall.force())


def test_an_updated_run_does_not_tell_where_boundaries_were_at_first(tmp_path):
    def build(configuration):
        grid, points, _ = scene()
        V = mpm.Space(grid, "linear", configuration=configuration)
        line = mpm.Boundary.from_polygon(points, [(0.1, 0.1), (0.9, 0.1)], closed=False)
        F = mpm.momentum(LAW, points, V.increment, V.test)
        F += mpm.dirichlet(line, V.increment, V.test, law=LAW)
        return mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost")

    first = build("updated")
    first.step()
    first.save(tmp_path / "updated.npz")
    with pytest.raises(CheckpointError, match="where boundaries were at first"):
        build("total").load(tmp_path / "updated.npz")
    total = build("total")
    total.step()
    total.save(tmp_path / "total.npz")
    build("updated").load(tmp_path / "total.npz")


def test_arc_length_under_a_weak_condition():
    grid, points, V = scene()
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, -0.5))
    base = mpm.Boundary.from_polygon(points, [(0.1, 0.1), (0.9, 0.1)], closed=False)
    F = mpm.momentum(LAW, points, u, v) + mpm.dirichlet(base, u, v, law=LAW)
    F -= ufl.inner(g, v) * points.dX
    problem = mpm.ArcLength(F, u, points, load=g, length=2e-3, stabilisation="ghost")
    for _ in range(3):
        problem.step()
    force = problem.path.factor * -0.5 * points["V0"].sum()
    np.testing.assert_allclose(base.force(), (0.0, -force), atol=1e-5)


def test_a_boundary_between_nodes_that_are_fixed():
    """No unknown is near its markers, and the matrix for Nitsche's constants was empty."""
    grid, points, V = scene(box=((0.1, 0.1), (0.9, 0.8)), basis="gimp")
    u, v = V.increment, V.test
    base = mpm.Boundary.from_polygon(points, [(0.1, 0.1), (0.9, 0.1)], closed=False)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 0.8), normal=(0, 1))
    F = mpm.momentum(LAW, points, u, v) + mpm.dirichlet(base, u, v, law=LAW)
    F += top.traction(fem.Constant(grid, (0.0, -0.1)), v)
    held = mpm.fixed(V, lambda x: x[1] < 0.3)
    problem = mpm.QuasiStatic(F, u, points, held, stabilisation="ghost")
    problem.step()
    assert base.force()[1] + mpm.reaction(problem, held)[1] == pytest.approx(0.08, rel=1e-6)


@pytest.mark.parametrize("basis", ["linear", "bspline2"])
@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation"])
def test_a_side_that_only_markers_reach_holds_nothing(stabilisation, basis):
    """The body ends beyond the cells with its points, half a metre before the side."""
    found = []
    for held in (False, True):
        grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 4, 9), np.linspace(0, 4, 9)])
        V = mpm.Space(grid, basis)
        corners = [(0.48, 0.0), (3.0, 0.0), (3.0, 2.2), (0.48, 2.2)]
        points = mpm.fill(grid, mpm.Polygon(corners), per_cell=2, density=1000.0)
        u, v = V.increment, V.test
        F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
        F += mpm.Boundary.from_polygon(points, corners).pressure(1e3, u, v)
        bcs = mpm.fixed(V, "bottom") + (mpm.rollers(V, "left") if held else [])
        problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation)
        if held:
            with pytest.warns(mpm.errors.IdleConditionWarning, match="left"):
                problem.step()
        else:
            problem.step()
        # markers at the bottom stay there, where the body is held
        assert points["x"][:, 1].min() > 0.1
        assert mpm.study.condition_number(problem.stiffness()) < 1e6
        found.append(points["x"])
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2", "bspline3"])
@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation"])
def test_uniform_pressure_on_a_face_inside_cells(basis, stabilisation):
    """The stress is uniform."""
    size, top, p = 4.0, 4.3, 1e3
    for kind in ("boundary", "surface"):
        grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(7.0)] * 2)
        points = mpm.fill(grid, mpm.Box((0, 0), (size, top)), 2, 1.0)
        V = mpm.Space(grid, basis)
        u, v = V.increment, V.test
        if kind == "boundary":
            face = mpm.Boundary.from_polygon(points, [(size, top), (0, top)], closed=False)
        else:
            face = mpm.Surface(points, lambda x: np.isclose(x[1], top), (0, 1))
        F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v, strain="small")
        F += face.traction((0.0, -p), v)
        bcs = mpm.rollers(V, "left", "bottom")
        mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation).step()
        error = np.abs(points["stress"][:, 1, 1] + p).max() / p
        assert error < 1e-10
