"""Contact of a boundary of the body: faces that do not follow the grid begin without a pressure."""

import warnings

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.body.facesofboundary import faces_of

E, PENALTY, STRAIN = 1e6, 100.0, 0.01
SQUARE = 0.5 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


def turned(angle):
    """Rotation by an angle (°), shape (2, 2)."""
    a = np.radians(angle)
    return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])


def square(angle, n=8, kind="lattice", **options):
    """A square of 1 m by 1 m that is turned by an angle, and its corners."""
    h = 1 / n
    lines = h * np.arange(-1.25 * n, 1.25 * n + 1)
    grid = mpm.create_lattice(MPI.COMM_WORLD, [lines, lines])
    if kind == "triangle":
        from dolfinx import mesh

        cells = [(-1.25, -1.25), (1.25, 1.25)], (20, 20), mesh.CellType.triangle
        grid = mesh.create_rectangle(MPI.COMM_WORLD, *cells)
    corners = SQUARE @ turned(angle).T
    return mpm.fill(grid, mpm.Polygon(corners), 2, 2000.0, **options), corners


@pytest.mark.parametrize(
    ("basis", "angle"), [("gimp", 0), ("gimp", 30), ("gimp", 45), ("bspline2", 20), ("linear", 15)]
)
def test_a_turned_block_between_two_plates(basis, angle):
    """With ν = 0 the force per area is E ln λ/λ, whatever the angle; corners of domains: +372 %."""
    points, corners = square(angle, exact=True)
    up = turned(angle)[:, 1]
    V = mpm.Space(points.grid, basis)
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E, 0.0), points, u, v)
    edge = mpm.Boundary.from_polygon(points, corners)
    top = mpm.RigidBody(mpm.Plane(0.5 * up, -up), increment=tuple(-STRAIN / 2 * up), name="top")
    bottom = mpm.RigidBody(mpm.Plane(-0.5 * up, up), increment=(0.0, 0.0), name="bottom")
    for plate in (top, bottom):
        F += mpm.contact(plate, points, u, v, friction=0.5, penalty=PENALTY, surface=edge)
    problem = mpm.QuasiStatic(F, u, points, [], stabilisation="ghost")
    for _ in range(2):
        record = problem.step()
        assert record.iterations <= 8
        assert record.halvings == 0
    # the penalties take a share of the motion: κ = 100 E/h on both sides
    compliance = 1 + 2 / (PENALTY * 8)
    exact = -np.log1p(-STRAIN) / (1 - STRAIN) * E / compliance
    assert top.force @ up == pytest.approx(exact, rel=0.015)
    np.testing.assert_allclose(bottom.force, -top.force, atol=1e-6 * exact)


@pytest.mark.parametrize("axisymmetric", [False, True])
@pytest.mark.parametrize(("basis", "levels"), [("gimp", 0), ("gimp", 1), ("bspline2", 0)])
def test_a_face_that_passes_a_grid_line_leaves_the_stress_uniform(basis, levels, axisymmetric):
    """Value and gradient at the points had stresses beside the plate that were off by 32 %."""
    h, top, way = 0.25, 1.1, 0.1
    grid = mpm.create_lattice(MPI.COMM_WORLD, [h * np.arange(7)] * 2)
    refined = {"refine": lambda x: np.full(x.shape[1], h / 2), "levels": 1} if levels else {}
    V = mpm.Space(grid, basis, **refined)
    box = mpm.Box((0, 0), (1, top))
    leaves = {"refine": V} if levels else {}
    points = mpm.fill(grid, box, 2, 2000.0, axisymmetric=axisymmetric, **leaves)
    u, v = V.increment, V.test
    face = mpm.Boundary.from_polygon(points, [(1, top), (0, top)], closed=False, spacing=h / 4)
    plate = mpm.RigidBody(mpm.Plane((0, top), (0, -1)), increment=(0.0, -way / 8), name="plate")
    F = mpm.momentum(mpm.materials.Hencky(E, 0.0), points, u, v)
    F += mpm.contact(plate, points, u, v, penalty=PENALTY, surface=face)
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "bottom"), stabilisation="ghost")
    area = np.pi if axisymmetric else 1.0
    for _ in range(8):
        problem.step()
        pressure = -plate.force[1] / area
        np.testing.assert_allclose(points["stress"][:, 1, 1], pressure, rtol=1e-5)


@pytest.mark.parametrize("kind", ["lattice", "triangle"])
def test_faces_lie_on_the_sides(kind):
    """Faces fill the boundary, and each has one of its normals, also beside a corner."""
    points, corners = square(25, kind=kind, exact=kind == "lattice")
    edge = mpm.Boundary.from_polygon(points, corners)
    surface = mpm.Surface.from_boundary(edge, name="skin")
    offset, area = points["skin_offset"], points["skin_area"]
    on = area.any(axis=1)
    assert surface.total_area == pytest.approx(4.0, rel=1e-12)
    np.testing.assert_allclose(area.sum(axis=0), 0.0, atol=1e-12)
    assert not offset[~on].any()
    turn = turned(25)
    normal = area[on] / np.linalg.norm(area[on], axis=1)[:, None]
    np.testing.assert_allclose(
        np.sort(np.abs(normal @ turn), axis=1), [(0, 1)] * on.sum(), atol=1e-9
    )
    face = (points["x"] + offset)[on]
    np.testing.assert_allclose(np.sum(face * normal, axis=1), 0.5, atol=1e-9)
    # each face is near its point
    assert np.linalg.norm(offset, axis=1).max() < 1.5 / 8


def test_a_block_at_rest_has_no_pressure():
    """A plate at the face of a body of triangles does not press it (domains of squares do)."""
    forces = []
    for surfaced in (True, False):
        points, corners = square(0, kind="triangle")
        V = mpm.Space(points.grid, "linear")
        u, v = V.increment, V.test
        edge = mpm.Boundary.from_polygon(points, corners[2:], closed=False)
        plate = mpm.RigidBody(mpm.Plane((0, 0.5), (0, -1)), increment=(0.0, 0.0), name="plate")
        F = mpm.momentum(mpm.materials.Hencky(E, 0.0), points, u, v)
        F += mpm.contact(plate, points, u, v, surface=edge if surfaced else None)
        held = mpm.fixed(V, lambda x: x[1] < -0.3)
        mpm.QuasiStatic(F, u, points, held, stabilisation="ghost").step()
        forces.append(plate.force[1])
    assert abs(forces[0]) < 1e-9 * E
    assert forces[1] > 1e-4 * E


def test_a_ball_between_two_plates():
    """Axisymmetric: F = 4/3 E* √R δ^1.5 (Hertz); corners of domains: +20 % in these cells."""
    R, nu, motion, h = 1.0, 0.3, 0.01, 1 / 16
    lines = [h * np.arange(20), h * np.arange(-19, 20)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    ball = mpm.Disc((0, 0.01), R) & mpm.Box((0, -1.2), (1.2, 1.2))
    points = mpm.fill(grid, ball, 2, 2000.0, axisymmetric=True, exact=True)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E, nu), points, u, v)
    t = np.linspace(-np.pi / 2, np.pi / 2, 200)
    meridian = np.column_stack([np.abs(np.cos(t)), 0.01 + np.sin(t)])
    edge = mpm.Boundary.from_polygon(points, meridian, closed=False)
    plates = []
    for name, side in (("top", 1), ("bottom", -1)):
        plane = mpm.Plane((0, 0.01 + side * R), (0, -side))
        plates.append(mpm.RigidBody(plane, increment=(0, -side * motion / 2), name=name))
        F += mpm.contact(plates[-1], points, u, v, penalty=PENALTY, surface=edge)
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left"), stabilisation="ghost")
    for _ in range(2):
        assert problem.step().iterations <= 8
    exact = 4 / 3 * E / (1 - nu**2) * np.sqrt(R) * motion**1.5
    assert plates[0].force[1] == pytest.approx(exact, rel=0.07)


def test_oblique_faces_stay_in_their_plane_where_points_split():
    points, corners = square(30, exact=True)
    edge = mpm.Boundary.from_polygon(points, corners)
    surface = mpm.Surface.from_boundary(edge, name="skin")
    moment = points["skin_area"].T @ (points["x"] + points["skin_offset"])
    mpm.split(points, points["x"][:, 0] > 0.0)
    area, face = points["skin_area"], points["x"] + points["skin_offset"]
    on = area.any(axis=1)
    assert np.linalg.norm(area, axis=1).sum() == pytest.approx(surface.total_area, rel=1e-12)
    normal = area[on] / np.linalg.norm(area[on], axis=1)[:, None]
    np.testing.assert_allclose(np.sum(face[on] * normal, axis=1), 0.5, atol=1e-9)
    np.testing.assert_allclose(area.T @ face, moment, atol=1e-12)


def test_a_disc_bounces_in_fused_steps():
    """Momentum along an oblique plane stays, and the fused loops take the faces."""
    h, up = 1 / 4, turned(30)[:, 1]
    grid = mpm.create_lattice(MPI.COMM_WORLD, [h * np.arange(-8, 9)] * 2)
    points = mpm.fill(grid, mpm.Disc((0.013, 0.021), 1.0), 2, 1000.0, exact=True)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    t = 2 * np.pi * np.arange(100) / 100
    circle = np.array([0.013, 0.021]) + np.column_stack([np.cos(t), np.sin(t)])
    edge = mpm.Boundary.from_polygon(points, circle)
    wall = mpm.RigidBody(mpm.Plane((0.013, 0.021) - 1.1 * up, up), name="wall")
    F = mpm.momentum(mpm.materials.Hencky(E, 0.3), points, u, v)
    F += mpm.contact(wall, points, u, v, penalty=20.0, surface=edge)
    problem = mpm.Explicit(F, u, points, [])
    assert not problem.unfused
    points["velocity"] = np.tile(-2.0 * up, (len(points), 1))
    before = problem.energies().kinetic
    problem.step(0.3)
    m = points["density"] * points["V0"]
    velocity = m @ points["velocity"] / m.sum()
    assert 0.85 < velocity @ up / 2.0 < 1.0
    assert abs(velocity @ turned(30)[:, 0]) < 5e-3
    energies = problem.energies()
    assert abs(energies.losses["integrator"]) < 0.01 * before


def test_wrong_boundaries():
    points, corners = square(30)
    others, _ = square(30)
    V = mpm.Space(points.grid, "gimp")
    u, v = V.increment, V.test
    plate = mpm.RigidBody(mpm.Plane((0, 1), (0, -1)), name="plate")
    wall = mpm.Boundary.from_polygon(points, corners, follows=False, name="wall")
    with pytest.raises(mpm.errors.ParameterError, match="'wall' is a wall, and no surface"):
        mpm.contact(plate, points, u, v, surface=wall)
    with pytest.raises(mpm.errors.ParameterError, match="of other points"):
        mpm.contact(plate, points, u, v, surface=mpm.Boundary.from_polygon(others, corners))
    with pytest.raises(mpm.errors.ParameterError, match="or give a Boundary"):
        mpm.contact(plate, points, u, v, surface=corners)
    edge = mpm.Boundary.from_polygon(points, corners)
    with pytest.raises(mpm.errors.ParameterError, match="corners = 'domains' would do nothing"):
        mpm.contact(plate, points, u, v, surface=edge, corners="domains")
    edge = mpm.Boundary.from_polygon(points, corners)
    points["x"] = points["x"] + 0.01
    with pytest.raises(mpm.errors.ParameterError, match="before the first step"):
        faces_of(edge)


def sheet(per_cell):
    """A level sheet that is one cell thick, and its corners."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(11.0), np.arange(4.0)])
    corners = np.array([(1.2, 1.0), (8.8, 1.0), (8.8, 2.0), (1.2, 2.0)])
    return mpm.fill(grid, mpm.Polygon(corners), per_cell, 2000.0, exact=True), corners


def test_sheets_of_one_point_have_no_two_faces():
    """The faces of both sides cancelled: two plates pressed the sheet without a force."""
    points, corners = sheet(1)
    edge = mpm.Boundary.from_polygon(points, corners, name="skin")
    with pytest.raises(mpm.errors.ParameterError, match="two sides of 'skin' share the point"):
        mpm.Surface.from_boundary(edge)
    for side in (corners[:2], corners[2:]):
        chain = mpm.Boundary.from_polygon(points, side, closed=False)
        assert mpm.Surface.from_boundary(chain).total_area == pytest.approx(7.6)
    points, corners = sheet(2)
    edge = mpm.Boundary.from_polygon(points, corners)
    assert mpm.Surface.from_boundary(edge).total_area == pytest.approx(17.2)


def test_markers_go_with_points_removed_before_the_first_step():
    """Their area had gone to points 0.28 m away."""
    points, corners = square(0, exact=True)
    edge = mpm.Boundary.from_polygon(points, corners)
    points.remove(points["x"][:, 1] > 0.25)
    surface = mpm.Surface.from_boundary(edge, name="skin")
    assert surface.total_area == pytest.approx(4.0 - 1.5)
    assert np.abs(points["skin_offset"]).max() < 1 / 16


def test_points_without_a_face_that_enter_a_body_are_told():
    """A chain along a part of the face alone touches: the other points go through the plate."""
    for count in (1, 2):
        points, corners = square(0, exact=True)
        V = mpm.Space(points.grid, "gimp")
        u, v = V.increment, V.test
        plate = mpm.RigidBody(mpm.Plane((0, 0.5), (0, -1)), increment=(0.0, -0.1), name="plate")
        F = mpm.momentum(mpm.materials.Hencky(E, 0.0), points, u, v)
        middle = (0.0, 0.5)
        for part in ((corners[2], middle), (middle, corners[3]))[:count]:
            chain = mpm.Boundary.from_polygon(points, part, closed=False)
            F += mpm.contact(plate, points, u, v, penalty=PENALTY, surface=chain)
        bcs = mpm.fixed(V, lambda x: x[1] < -0.3)
        problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            for _ in range(2):
                problem.step()
        # once, and not of points that touch with the other surface
        found = [w for w in told if "points without a face of" in str(w.message)]
        assert [w.category for w in found] == [mpm.errors.OverlapWarning] * (count == 1)


def test_explicit_steps_bound_no_penetration():
    """The multipliers had added up from step to step, until an InstabilityError."""
    points, _ = square(30)
    V = mpm.Space(points.grid, "gimp")
    u, v = V.increment, V.test
    plate = mpm.RigidBody(mpm.Plane((0, 1), (0, -1)), name="plate")
    F = mpm.momentum(mpm.materials.Hencky(E, 0.3), points, u, v)
    F += mpm.contact(plate, points, u, v, penetration=1e-4)
    with pytest.raises(mpm.errors.FormError, match="give a larger penalty="):
        mpm.Explicit(F, u, points, [])


def test_a_free_body_may_wait_for_an_impact():
    """Nothing acted on it, and its own equations divided by zero: Newmark's steps had failed."""
    points, _ = square(0)
    V = mpm.Space(points.grid, "gimp")
    u, v = V.increment, V.test
    block = mpm.RigidBody(mpm.Box((-1.1, -1.0), (1.1, -0.6)), mass=1e3, inertia=500.0)
    F = mpm.momentum(mpm.materials.Hencky(E, 0.3), points, u, v)
    F += mpm.contact(block, points, u, v)
    problem = mpm.Newmark(F, u, points, [])
    points["velocity"] = np.tile((0.0, -1.0), (len(points), 1))
    for k in range(16):
        problem.step(0.01 * (k + 1))
    m = points["density"] * points["V0"]
    assert m @ points["velocity"][:, 1] > -0.9 * m.sum()
    total = m @ points["velocity"] + 1000.0 * block.free_motion.velocity[:2]
    np.testing.assert_allclose(total, (0.0, -m.sum()), atol=1e-6 * m.sum())


@pytest.mark.parametrize("method", ["nitsche", "penalty"])
def test_a_free_block_on_ground_that_a_boundary_holds(method):
    """Its weight is the only load, and no side of the grid has a reaction: the step had failed."""
    lines = [np.arange(-2.0375, 2.1, 0.125), np.arange(-1.0875, 0.4, 0.125)]
    points = mpm.fill(mpm.create_lattice(MPI.COMM_WORLD, lines), mpm.Box((-2, -1), (2, 0)), 2, 1.0)
    law, V = mpm.materials.Hencky(1e7, 0.3), mpm.Space(points.grid, "gimp")
    u, v = V.increment, V.test
    base = mpm.Boundary.from_polygon(points, [(-2, -1), (2, -1)], closed=False)
    face = mpm.Boundary.from_polygon(points, [(1.5, 0), (-1.5, 0)], closed=False)
    load = fem.Constant(points.grid, (0.0, -2e3))
    block = mpm.RigidBody(mpm.Box((-1, 0), (1, 1)), free=(False, True, False), force=load)
    F = mpm.momentum(law, points, u, v) + mpm.dirichlet(base, u, v, law=law, method=method)
    F += mpm.contact(block, points, u, v, penalty=PENALTY, surface=face)
    problem = mpm.QuasiStatic(F, u, points, [], stabilisation="ghost", tolerance=1e-8)
    record = problem.step()
    assert record.iterations <= 10
    assert record.halvings == 0
    assert block.force[1] == pytest.approx(2e3, rel=1e-7)
    assert base.force()[1] == pytest.approx(2e3, rel=1e-6)
