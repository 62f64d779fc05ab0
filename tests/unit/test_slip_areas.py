"""Areas on which a limit of the shear stress acts, beside oblique and round bodies."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.contact.cornerareas import part_areas, slip_parts
from dolfinmpm.contact.sharedsurface import TouchingCorners, shared_areas


def stairs(normal, half):
    """Areas of the corners of one point on a surface with this normal; one corner just touches."""
    normal, d = np.asarray(normal) / np.linalg.norm(normal), len(normal)
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=d)))
    gap = signs @ (np.asarray(half) * normal)
    touches = gap < gap.min() + 1e-12
    edges, normal = np.tile(np.diag(half), (len(signs), 1, 1)), np.tile(normal, (len(signs), 1))
    at = np.ones_like(signs)
    return part_areas(slip_parts(edges, normal, signs, at, gap - gap.min())[1])[touches]


@pytest.mark.parametrize(
    ("normal", "half", "corners", "area"),
    [
        ((0.0, 1.0), (0.1, 0.2), 2, 0.2),
        ((-1.0, 1.0), (0.1, 0.1), 1, 0.2 * np.sqrt(2)),
        # steps of 0.2 m by 0.4 m: each column ends a little above the one before
        ((1.0, 2.0), (0.1, 0.2), 1, 0.2 * np.sqrt(5) / 2),
        ((3.0, -1.0), (0.1, 0.1), 1, 0.2 * np.sqrt(10) / 3),
        ((0.0, 0.0, 1.0), (0.1, 0.2, 0.3), 4, 0.08),
        ((0.0, 1.0, 1.0), (0.1, 0.2, 0.2), 2, 0.08 * np.sqrt(2)),
    ],
)
def test_a_column_of_points_covers_its_part_of_the_surface(normal, half, corners, area):
    areas = stairs(normal, half)
    assert len(areas) == corners
    np.testing.assert_allclose(areas, area / corners, rtol=1e-6)


def test_corners_that_touch_both_share_the_face():
    """One corner is 2 mm inside, its neighbour 1 mm."""
    signs, normal = np.array([[-1.0, -1.0], [1.0, -1.0]]), np.array([[0.01, 1.0]] * 2)
    edges, at = np.tile(np.diag([0.05, 0.1]), (2, 1, 1)), np.ones((2, 2))
    middles, parts = slip_parts(edges, normal, signs, at, np.array([-2e-3, -1e-3]))
    np.testing.assert_allclose(part_areas(parts), [0.075, 0.025], rtol=1e-4)
    # from the corners at ∓0.05: the middles of [-0.05, 0.025] and [0.025, 0.05]
    np.testing.assert_allclose(middles[:, 0], [0.0375, -0.0125], rtol=1e-9)


class Here:
    """A body on this rank alone."""

    comm, axisymmetric = MPI.COMM_SELF, False


def on_a_plane(places, sizes, forces=None):
    """Areas of corners on the plane x_d = 0, whose parts of it are boxes of these half edges."""
    places = np.asarray(places, float)
    m, d = places.shape
    parts = np.zeros((m, d - 1, d))
    parts[:, range(d - 1), range(d - 1)] = sizes
    forces = np.ones(m) if forces is None else np.asarray(forces)
    sides = np.full(m, 0.1)
    own = TouchingCorners(places, np.tile(np.eye(d)[-1], (m, 1)), parts, sides, forces)
    return shared_areas(own, Here())


def test_equal_corners_have_the_area_of_their_faces():
    row = [(0.05 * k, 0.0) for k in range(8)]
    np.testing.assert_allclose(on_a_plane(row, 0.025), 0.05)
    sheet = [(0.05 * i, 0.08 * k, 0.0) for i in range(6) for k in range(5)]
    np.testing.assert_allclose(on_a_plane(sheet, (0.025, 0.04)), 0.05 * 0.08, rtol=3e-3)


def test_corners_cover_the_gaps_between_them():
    """Every second column of points touches; nothing is covered further away."""
    row = [(0.2 * k, 0.0) for k in range(6)]
    assert on_a_plane(row, 0.05).sum() == pytest.approx(5 * 0.2 + 2 * 0.05)
    far = [(0.0, 0.0), (0.5, 0.0)]
    np.testing.assert_allclose(on_a_plane(far, 0.05), 0.1)
    sheet = [(0.2 * i, 0.2 * k, 0.0) for i in range(5) for k in range(5)]
    total = on_a_plane(sheet, (0.05, 0.05)).sum()
    # corners at the edge cover 0.05 m outwards, beside each other up to 0.1 m
    assert 0.9**2 < total < 0.9**2 + 4 * 0.8 * 0.025


def test_corners_share_the_surface_by_their_forces():
    row = [(0.05 * k, 0.0) for k in range(8)]
    forces = np.array([1.0, 3.0] * 4)
    areas = on_a_plane(row, 0.025, forces)
    assert areas.sum() == pytest.approx(8 * 0.05)
    np.testing.assert_allclose(areas[3:5], [0.075, 0.025], rtol=0.02)


def test_a_corner_behind_others_may_cover_nothing():
    np.testing.assert_array_equal(on_a_plane([(0.0, 0.0)], 0.0), 0.0)
    assert on_a_plane([(0.0, 0.0), (0.02, 0.0)], 0.0).sum() == pytest.approx(0.02)


def test_two_corners_at_one_place_share_its_area():
    row = [(0.05 * k, 0.0) for k in range(8) for _ in range(2)]
    np.testing.assert_allclose(on_a_plane(row, 0.025), 0.025)


@pytest.mark.parametrize(
    ("angle", "faces", "within"),
    [(30, False, 0.03), (45, False, 0.02), (30, True, 1e-3), (45, True, 1e-3)],
)
def test_a_rough_plate_on_an_elastic_slope(angle, faces, within):
    """Some columns of points do not reach it, and yet the shear force is τ times the length.

    By corners it is 0.97 to 1.0 times as large, by the place of the slope in the grid.
    """
    h, limit, length, depth = 0.1, 1e4, 2.0, 1.2
    a = np.radians(angle)
    along, out = np.array([np.cos(a), np.sin(a)]), np.array([-np.sin(a), np.cos(a)])
    middle = np.array([2.0, 2.0])
    line = np.arange(0.0, 4.0 + h / 2, h)
    grid = mpm.create_lattice(MPI.COMM_WORLD, [line, line])
    ends = [middle - along * length / 2, middle + along * length / 2]
    corners = [ends[0], ends[0] - out * depth, ends[1] - out * depth, ends[1]]
    points = mpm.fill(grid, mpm.Polygon(corners), 2, 1800.0, exact=True)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test

    def way(t):
        return tuple(0.05 * max(0.0, t - 2.0) * along - 0.01 * min(t, 2.0) * out)

    plate = mpm.RigidBody(mpm.Plane(middle, -out), displacement=way)
    table = mpm.RigidBody(mpm.Plane(middle - out * depth, out))
    F = mpm.momentum(mpm.materials.Hencky(1e7, 0.0), points, u, v)
    skin = {"surface": mpm.Boundary.from_polygon(points, corners)} if faces else {}
    F += mpm.contact(plate, points, u, v, friction=1.0, shear_limit=limit, penalty=20.0, **skin)
    F += mpm.contact(table, points, u, v, friction=2.0, penalty=20.0, **skin)
    problem = mpm.QuasiStatic(F, u, points, [], stabilisation="ghost", tolerance=1e-6)
    for _ in range(5):
        problem.step()
    found = abs(plate.force @ along) / (limit * length)
    assert found == pytest.approx(1.0, abs=within)


def torque(shape, size, h, ratio, exact, steps=4):
    """Torque of a rough round body that turns in ground under the pressure p, over the exact one.

    In 3D half of the ground above the plane x_2 = 0 is computed.
    """
    young, d = 1e6, len(size)
    line = np.arange(-size[0], size[0] + h / 2, h)
    lines = [line, line] + [line[line > -h / 2]] * (d - 2)
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    low = -np.asarray(size)
    low[2:] = 0.0
    points = mpm.fill(grid, mpm.Box(low, size) - shape, 2, 1.0, exact=True)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    soil, pressure = mpm.materials.Hencky(young, 0.3), ratio * young
    mpm.set_stress(soil, points, -pressure * np.eye(3))
    turn = 0.5 if d == 2 else (0, 0, 0.5)
    body = mpm.RigidBody(shape, rotation_increment=turn)
    F = mpm.momentum(soil, points, u, v)
    F += mpm.contact(body, points, u, v, friction=1.0, shear_limit=0.2 * pressure)
    sides = (
        ["left", "right", "bottom", "top"] if d == 2 else ["left", "right", "front", "back", "top"]
    )
    bcs = mpm.fixed(V, *sides) + (mpm.rollers(V, "bottom") if d == 3 else [])
    ghost = mpm.Stabilisation("ghost", factor=0.1)
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=ghost, tolerance=1e-5)
    for _ in range(steps):
        problem.step()
    return abs(body.moment[-1]) / (0.2 * pressure * exact)


@pytest.mark.parametrize(("h", "ratio", "steps"), [(0.1, 0.02, 3), (0.05, 0.02, 3), (0.1, 0.1, 5)])
def test_a_rough_disc_that_turns_in_deep_ground(h, ratio, steps):
    """The torque had been 0.63, 0.80 and 0.92 of 2π R² τ."""
    found = torque(mpm.Disc((0, 0), 0.5), (1.5, 1.5), h, ratio, 2 * np.pi * 0.5**2, steps)
    assert found == pytest.approx(1.0, abs=0.015)


def test_a_rough_ball_that_turns_in_deep_ground():
    """The torque had been 0.79 of π² R³ τ."""
    exact = 0.5 * np.pi**2 * 0.5**3
    found = torque(mpm.Ball((0, 0, 0), 0.5), (1.25, 1.25, 1.25), 0.125, 0.02, exact)
    assert found == pytest.approx(1.0, abs=0.015)


def load_of_a_disc(adhesion):
    """Load over D c of a disc in deep clay; the limit of the shear stress is adhesion · c."""
    cohesion, radius, h, size = 1e3, 0.5, 0.125, 2.5
    line = np.arange(0.0, size + h / 2, h)
    grid = mpm.create_lattice(MPI.COMM_WORLD, [line, np.arange(-size, size + h / 2, h)])
    disc = mpm.Disc((0, 0), radius)
    points = mpm.fill(grid, mpm.Box((0, -size), (size, size)) - disc, 3, 1.0, exact=True)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    clay = mpm.materials.Tresca(600 * cohesion, 0.49, cohesion=cohesion)
    mpm.set_stress(clay, points, lambda x: np.tile(-20 * cohesion * np.eye(3), (x.shape[1], 1, 1)))
    body = mpm.RigidBody(disc, increment=(0, -0.01))
    options = {"friction": 1.0, "shear_limit": adhesion * cohesion} if adhesion else {}
    F = mpm.momentum(clay, points, u, v, fbar=True) + mpm.contact(body, points, u, v, **options)
    bcs = mpm.rollers(V, "left", "bottom", "top") + mpm.fixed(V, "right")
    ghost = mpm.Stabilisation("ghost", factor=0.1)
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=ghost, tolerance=1e-5)
    for _ in range(3):
        problem.step()
    return 2 * body.force[1] / (2 * radius * cohesion)


def test_a_disc_with_adhesion_in_deep_clay():
    """Randolph & Houlsby 1984, doi 10.1680/geot.1984.34.4.613."""
    loads = [load_of_a_disc(adhesion) for adhesion in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(loads, [9.14, 10.82, 11.94], rtol=0.02)
    assert loads[0] == pytest.approx(9.14, rel=0.005)
