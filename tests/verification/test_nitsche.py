"""Dirichlet conditions on boundaries that do not fit the grid, against exact solutions."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM, dense
from cutcells import boxes, cut_body
from dolfinx import fem, mesh

import dolfinmpm as mpm

E, NU = 100.0, 0.3
M = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
A = np.array([[-0.05, 0.02, 0.01], [0.015, -0.04, 0.02], [0.01, -0.02, 0.03]])


def lattice(d, n):
    """A grid of n² or n³ cells around [0, 1]^d and one more to each side, and its lines."""
    h = 1 / n
    low, high, count = [-h] * d, [1 + h] * d, [n + 2] * d
    if d == 2:
        grid = mesh.create_rectangle(COMM, [low, high], count, mesh.CellType.quadrilateral)
    else:
        grid = mesh.create_box(COMM, [low, high], count, mesh.CellType.hexahedron)
    return grid, [np.linspace(-h, 1 + h, n + 3)] * d


def skin(points, low, high):
    """The surface of a box."""
    if points.gdim == 2:
        (a, b), (c, d) = low, high
        return mpm.Boundary.from_polygon(points, [(a, b), (c, b), (c, d), (a, d)])
    corner = np.array(list(np.ndindex(2, 2, 2)))
    x, faces = low + corner * (high - low), []
    for axis in range(3):
        for side in (0, 1):
            p, q, r, s = np.flatnonzero(corner[:, axis] == side)
            for face in ((p, q, s), (p, s, r)):
                n = np.cross(x[face[1]] - x[face[0]], x[face[2]] - x[face[0]])
                faces.append(face if n[axis] * (side - 0.5) > 0 else face[::-1])
    return mpm.Boundary.from_triangles(points, x, faces)


def patch(cut, d=2, n=4, basis="linear", law=None, stabilisation="ghost", **options):
    """A box whose faces lie by a share of a cell behind grid lines moves linearly."""
    grid, lines = lattice(d, n)
    low, high = np.full(d, (1 - cut) / n), np.full(d, 1 - (1 - cut) / n)
    x, half = boxes(lines, low, high)
    points = mpm.MaterialPoints.from_arrays(grid, x, np.prod(2 * half, axis=1), 1.0,
                                            half_length=half)  # fmt: skip
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    law = law or mpm.materials.Hencky(E, NU)
    boundary = skin(points, low, high)
    strain = options.get("strain", "large")
    F = mpm.momentum(law, points, u, v, strain=strain)
    F += mpm.dirichlet(boundary, u, v, lambda x: (A[:d, :d] @ x).T, law=law, **options)
    problem = mpm.QuasiStatic(F, u, points, stabilisation=stabilisation)
    record = problem.step()
    return points, boundary, record


@pytest.mark.parametrize("cut", [1e-6, 0.4, 1 - 1e-6])
@pytest.mark.parametrize("method", ["nitsche", "skew"])
def test_patch(cut, method):
    points, boundary, record = patch(cut, method=method)
    exact = np.eye(2) + A[:2, :2]
    np.testing.assert_allclose(points["F"], np.broadcast_to(exact, points["F"].shape), atol=1e-10)
    moved = boundary.markers["x0"] @ exact.T
    np.testing.assert_allclose(boundary.markers["x"], moved, atol=1e-10)
    assert record.iterations <= 2
    # the stress is that of the law, so forces on the whole surface cancel
    assert np.abs(points["stress"]).max() > 1.0
    np.testing.assert_allclose(boundary.force(), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    "options",
    [
        {"basis": "gimp"},
        {"basis": "bspline2"},
        {"stabilisation": "aggregation"},
        {"stabilisation": "weak-aggregation"},
        {"strain": "small"},
        {"strain": "jaumann"},
        {"law": mpm.materials.NeoHookean(E, NU)},
        {"d": 3, "n": 3},
    ],
    ids=lambda options: "-".join(str(v).split("(")[0] for v in options.values()),
)
def test_patch_of_every_kind(options):
    points, _, _ = patch(1e-6, **options)
    d = points.gdim
    exact = np.broadcast_to(np.eye(d) + A[:d, :d], points["F"].shape)
    np.testing.assert_allclose(points["F"], exact, atol=1e-10)


def test_a_penalty_leaves_a_gap_that_is_as_stiff_as_it_is():
    gaps = []
    for penalty in (1e3, 1e4):
        _, boundary, _ = patch(0.4, method="penalty", penalty=penalty)
        gaps.append(np.abs(boundary.markers["dirichlet1_gap"]).max())
        assert 0 < gaps[-1] < 0.1 / penalty
    assert 8 < gaps[0] / gaps[1] < 12


def ring(n, offset=0.0, stabilisation="ghost", scale=1e-6, **options):
    """The ring of radii 1 and 2 whose hole is widened, free outside; small strains."""
    a, b, h = 1.0, 2.0, 1.0 / n
    count = 2 * n + 2
    L = count * h
    grid = mesh.create_rectangle(COMM, [(-L, -L), (L, L)], (2 * count, 2 * count),
                                 mesh.CellType.quadrilateral)  # fmt: skip
    middle = h * offset * np.array([1.0, 0.7])

    def radius(x):
        return np.linalg.norm(x - middle, axis=-1)

    lines = [np.linspace(-L, L, 2 * count + 1)] * 2
    points = cut_body(grid, lines, [lambda x: a - radius(x), lambda x: radius(x) - b], 2)
    law = mpm.materials.Hencky(1.0, NU)
    A1 = 1 / (1 + b**2 / (1 - 2 * NU))
    A2 = 1 - A1

    def exact(x):
        r = x.T - middle
        square = np.sum(r**2, axis=1)
        return scale * (A1 + A2 / square)[:, None] * r

    V = mpm.Space(grid, "linear")
    u, v = V.increment, V.test
    hole = mpm.Boundary.from_level_set(points, lambda x: a - radius(x.T), subdivisions=4)
    F = mpm.momentum(law, points, u, v, strain="small")
    F += mpm.dirichlet(hole, u, v, exact, law=law, strain="small", **options)
    problem = mpm.QuasiStatic(F, u, points, stabilisation=stabilisation)
    return problem, exact, hole


def error_of(problem, exact, scale=1e-6):
    problem.step()
    points = problem.points
    wrong = points["x"] - points["x0"] - exact(points["x0"].T)
    volume = points["V0"]
    return np.sqrt(volume @ np.sum(wrong**2, axis=1) / volume.sum()) / scale


@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation"])
def test_ring_is_of_second_order(stabilisation):
    errors = []
    for n in (2, 4, 8):
        problem, exact, hole = ring(n, 0.3, stabilisation)
        errors.append(error_of(problem, exact))
    assert np.log2(errors[0] / errors[2]) / 2 > 1.9
    assert errors[2] < 1.2e-3
    # Lamé's pressure on the hole, 0.524476 E u/a, is what the boundary pushes with
    markers = hole.markers
    radial = -np.sum(markers["dirichlet1_force"] * markers["area"], axis=1) / markers["V"]
    pressure = radial.sum() / hole.total_area
    assert pressure == pytest.approx(0.524476e-6, rel=0.02)


def positions(count):
    shares = 10.0 ** -np.arange(1, 9)
    return [1e-6, *np.random.default_rng(5).random(count), *shares, *(1 - shares)][:count]


@pytest.mark.parametrize("count", [4, pytest.param(40, marks=pytest.mark.long)])
def test_conditioning_is_bounded_wherever_the_boundary_lies(count):
    largest = {"ghost": 2.5e4, "aggregation": 2e3}
    for stabilisation, bound in largest.items():
        for offset in positions(count):
            problem, _, _ = ring(2, offset, stabilisation)
            K = dense(problem.stiffness())
            values = np.linalg.eigvalsh(0.5 * (K + K.T))
            assert values[0] > 0
            assert values[-1] / values[0] < bound


def test_a_fixed_factor_is_not_enough():
    """With β = 4 the tangent is indefinite where the ghost penalty alone holds a cell."""
    least = []
    for offset in (1e-3, 1e-4, 1e-5):
        K = dense(ring(2, offset, penalty=4.0)[0].stiffness())
        least.append(np.linalg.eigvalsh(0.5 * (K + K.T))[0])
    assert min(least) < 0


@pytest.mark.parametrize("angle", [0.0, 30.0, 77.0])
def test_rollers_at_any_angle(angle):
    """A block between three smooth planes at an angle is compressed uniformly."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    R, middle, half = np.array([[c, -s], [s, c]]), np.array([1.0, 1.0]), np.array([0.43, 0.27])
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (12, 12), mesh.CellType.quadrilateral)
    lines = [np.linspace(0, 2, 13)] * 2
    levels = [
        lambda x, k=k, sign=sign: sign * ((x - middle) @ R)[:, k] - half[k]
        for k in (0, 1)
        for sign in (-1.0, 1.0)
    ]
    points = cut_body(grid, lines, levels)
    corners = middle + (np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half) @ R.T
    V = mpm.Space(grid, "linear")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E, NU)
    top = fem.Constant(grid, 0.0)
    sides = mpm.Boundary.from_polygon(points, corners[[3, 0, 1]], closed=False)
    lid = mpm.Boundary.from_polygon(points, corners[[2, 3]], closed=False)
    F = mpm.momentum(law, points, u, v, strain="small")
    F += mpm.dirichlet(sides, u, v, law=law, direction="normal", strain="small")
    F += mpm.dirichlet(lid, u, v, top, law=law, direction=R[:, 1], strain="small")
    problem = mpm.QuasiStatic(F, u, points, stabilisation="ghost")
    top.value = -1e-3
    problem.step()
    strain = -1e-3 / (2 * half[1])
    found = R.T @ points["stress"][:, :2, :2] @ R
    exact = np.diag([0.0, E / (1 - NU**2) * strain])
    np.testing.assert_allclose(found, np.broadcast_to(exact, found.shape), atol=1e-10)
    force = 2 * half[0] * E / (1 - NU**2) * strain
    np.testing.assert_allclose(lid.force(), force * R[:, 1], rtol=1e-8, atol=1e-10)


def test_a_boundary_that_follows_and_one_that_stays():
    """A block is driven through the grid by its skin; a symmetry plane stays where it is."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (3, 2)], (12, 8), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0.6, 0.3), (1.6, 1.1)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E, NU)
    end = mpm.Boundary.from_polygon(points, [(0.6, 1.1), (0.6, 0.3)], closed=False)
    plane = mpm.Boundary.from_polygon(
        points, [(0.3, 0.3), (2.8, 0.3)], closed=False, follows=False, name="plane"
    )
    way = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, u, v)
    F += mpm.dirichlet(end, u, v, way[0], law=law, direction=(1, 0))
    F += mpm.dirichlet(plane, u, v, law=law, direction="normal", method="penalty")
    F -= ufl.inner(fem.Constant(grid, (0.0, -0.2)), v) * points.dX
    problem = mpm.QuasiStatic(F, u, points, stabilisation="ghost")
    for k in range(5):
        way.value[0] = 0.2 * (k + 1)
        problem.step()
    np.testing.assert_allclose(end.markers["x"][:, 0], 1.6, atol=2e-3)
    np.testing.assert_array_equal(plane.markers["x"], plane.markers["x0"])
    # nothing rubs: what bears the weight does not resist the way
    weight = 0.2 * points["V0"].sum()
    np.testing.assert_allclose(plane.force(), (0.0, weight), atol=1e-6 * weight)
    np.testing.assert_allclose(end.force(), 0.0, atol=1e-6 * weight)
    np.testing.assert_allclose(points["x"][:, 0] - points["x0"][:, 0], 1.0, atol=0.01)
    assert abs(points["x"][:, 1].min() - 0.3375) < 1e-3


@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation"])
def test_a_thick_cylinder_at_finite_strain(stabilisation):
    """Its hole is widened by half, in steps; the boundary follows. Hencky's law, exact values."""
    n, steps = 4, 5
    count = int(2.75 * n)
    grid = mesh.create_rectangle(COMM, [(0, 0), (2.75, 2.75)], (count, count),
                                 mesh.CellType.quadrilateral)  # fmt: skip
    shape = mpm.Where(lambda x: (np.hypot(*x) < 2) & (np.hypot(*x) > 1))
    points = mpm.fill(grid, shape, 3, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=1.0, nu=0.3)
    hole = mpm.Boundary.from_level_set(points, lambda x: 1 - np.hypot(*x), subdivisions=4)
    way = fem.Constant(grid, 0.0)
    outward = hole.x0 / ufl.sqrt(ufl.dot(hole.x0, hole.x0))
    F = mpm.momentum(law, points, u, v) + mpm.dirichlet(hole, u, v, way * outward, law=law)
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "bottom"),
                              stabilisation=stabilisation)  # fmt: skip
    for k in range(steps):
        way.value = 0.5 * (k + 1) / steps
        assert problem.step().iterations <= 8
    x, area = hole.markers["x"], hole.markers["V"]
    radius = np.linalg.norm(x, axis=1)
    np.testing.assert_allclose(radius, 1.5, rtol=2e-3)
    assert area.sum() == pytest.approx(1.5 * np.pi / 2, rel=1e-3)
    push = np.sum(hole.markers["dirichlet1_force"] * x, axis=1) / radius
    assert push.sum() / area.sum() == pytest.approx(0.130556, rel=5e-3)
    first, now = (np.linalg.norm(points[name], axis=1) for name in ("x0", "x"))
    outer = np.polyval(np.polyfit(first[first > 1.8], now[first > 1.8], 1), 2.0)
    assert outer == pytest.approx(2.360440, rel=1e-3)
