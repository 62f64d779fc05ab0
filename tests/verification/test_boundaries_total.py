"""Boundaries that do not fit the grid, under total Lagrangian bases."""

from __future__ import annotations

import numpy as np
import pytest
import test_boundaries_of_revolution as revolution
import test_nitsche as nitsche
import ufl
from conftest import COMM
from cutcells import boxes
from dolfinx import fem, mesh

import dolfinmpm as mpm

SIDES = mesh.CellType.quadrilateral
TURN = np.array([[0.9, -0.5], [0.55, 0.8]])


@pytest.mark.parametrize("cut", [1e-6, 0.4, 1 - 1e-6])
@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2"])
@pytest.mark.parametrize("method", ["nitsche", "skew"])
def test_patch_in_steps(cut, basis, method):
    """An affine motion with strains of a half and a turn by 30°, in four steps."""
    points, boundary = turned(cut, basis, method=method)
    np.testing.assert_allclose(points["F"], np.broadcast_to(TURN, points["F"].shape), atol=1e-10)
    markers = boundary.markers
    np.testing.assert_allclose(markers["x"], markers["x0"] @ TURN.T, atol=1e-10)
    area = np.linalg.det(TURN) * markers["area0"] @ np.linalg.inv(TURN)
    np.testing.assert_allclose(markers["area"], area, atol=1e-10)
    assert np.abs(points["stress"]).max() > 1.0
    np.testing.assert_allclose(boundary.force(), 0.0, atol=1e-8)


def turned(cut, basis="linear", steps=4, stabilisation="ghost", law=None, **options):
    n = 4
    grid, lines = nitsche.lattice(2, n)
    low, high = np.full(2, (1 - cut) / n), np.full(2, 1 - (1 - cut) / n)
    x, half = boxes(lines, low, high)
    points = mpm.MaterialPoints.from_arrays(grid, x, np.prod(2 * half, axis=1), 1.0,
                                            half_length=half)  # fmt: skip
    V = mpm.Space(grid, basis, configuration="total")
    u, v = V.increment, V.test
    law = law or mpm.materials.Hencky(100.0, 0.3)
    boundary = nitsche.skin(points, low, high)
    share = fem.Constant(grid, 0.0)
    way = boundary.markers.add_field("way", (2,), "m", lambda x: ((TURN - np.eye(2)) @ x).T)
    F = mpm.momentum(law, points, u, v) + mpm.dirichlet(
        boundary, u, v, share * way, law=law, **options
    )
    problem = mpm.QuasiStatic(F, u, points, stabilisation=stabilisation, tolerance=1e-13)
    for k in range(steps):
        share.value = (k + 1) / steps
        problem.step()
    return points, boundary


@pytest.mark.parametrize("options", [
    {"stabilisation": "aggregation"}, {"law": mpm.materials.NeoHookean(100.0, 0.3)},
], ids=["aggregation", "energy"])  # fmt: skip
def test_patch_of_every_kind(options):
    points, _ = turned(1e-6, **options)
    np.testing.assert_allclose(points["F"], np.broadcast_to(TURN, points["F"].shape), atol=1e-10)


def test_patch_of_rings():
    points, _, slopes = revolution.patch(1e-6, True, steps=3, space={"configuration": "total"})
    exact = np.diag(1 + slopes)
    np.testing.assert_allclose(points["F"], np.broadcast_to(exact, points["F"].shape), atol=1e-10)


def bent(configuration, n=6, steps=8):
    """A block is held at its unfitted foot, turned at its unfitted head, and pressed aside."""
    grid = mesh.create_rectangle(COMM, [(-1, -0.5), (2, 2.5)], (3 * n, 3 * n), SIDES)
    low, high = np.array([0.03, 0.04]), np.array([0.97, 1.96])
    x, half = boxes([np.linspace(-1, 2, 3 * n + 1), np.linspace(-0.5, 2.5, 3 * n + 1)], low, high)
    points = mpm.MaterialPoints.from_arrays(grid, x, np.prod(2 * half, axis=1), 1.0,
                                            half_length=half)  # fmt: skip
    V = mpm.Space(grid, "gimp", configuration=configuration)
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(100.0, 0.3)
    (a, b), (c, d) = low, high
    foot = mpm.Boundary.from_polygon(points, [(a, b), (c, b)], closed=False)
    head = mpm.Boundary.from_polygon(points, [(c, d), (a, d)], closed=False)
    side = mpm.Boundary.from_polygon(points, [(a, d), (a, b)], closed=False)
    angle, p = fem.Constant(grid, 0.0), fem.Constant(grid, 0.0)
    r = head.x0 - ufl.as_vector((0.5, d))
    R = ufl.as_tensor([[ufl.cos(angle), ufl.sin(angle)], [-ufl.sin(angle), ufl.cos(angle)]])
    way = ufl.dot(R, r) - r + ufl.as_vector((0.4 * angle, -0.2 * angle))
    F = mpm.momentum(law, points, u, v) + side.pressure(p, u, v)
    F += mpm.dirichlet(foot, u, v, law=law) + mpm.dirichlet(head, u, v, way, law=law)
    problem = mpm.QuasiStatic(F, u, points, stabilisation="ghost")
    for k in range(steps):
        angle.value, p.value = 0.7 * (k + 1) / steps, 4.0 * (k + 1) / steps
        problem.step()
    return points, foot, head, side


def test_large_deformation_is_that_of_the_updated_configuration():
    ends = {}
    for configuration in ("updated", "total"):
        points, foot, head, side = bent(configuration)
        order = np.lexsort(points["x0"].T)
        ends[configuration] = points["x"][order], foot.force(), head.force(), side.total_area
        np.testing.assert_allclose(foot.markers["x"], foot.markers["x0"], atol=3e-3)
    (x, foot, head, area), (x_total, foot_total, head_total, area_total) = ends.values()
    moved = np.linalg.norm(x - np.sort(points["x0"], axis=0).mean(axis=0), axis=1).max()
    assert moved > 0.5
    assert np.sqrt(np.mean(np.sum((x - x_total) ** 2, axis=1))) < 0.01
    np.testing.assert_allclose(foot_total, foot, rtol=0.05, atol=0.3)
    np.testing.assert_allclose(head_total, head, rtol=0.05, atol=0.3)
    assert area_total == pytest.approx(area, rel=0.01)


def pushed(configuration):
    """A block beside a wall, on lines of the grid: pressed, sheared, lifted off and pressed."""
    n = 4
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (2 * n, 2 * n), SIDES)
    points = mpm.fill(grid, mpm.Box((0.75, 0.5), (1.75, 1.5)), 2, 1.0)
    V = mpm.Space(grid, "gimp", configuration=configuration)
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=100.0, nu=0.0)
    wall = mpm.Boundary.from_polygon(points, [(1.8, 0), (1.8, 2)], closed=False, follows=False)
    face = mpm.Boundary.from_polygon(points, [(0.75, 1.5), (0.75, 0.5)], closed=False)
    way = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, u, v) + mpm.signorini(wall, u, v, law=law, friction=0.3)
    F += mpm.dirichlet(face, u, v, way, law=law)
    problem = mpm.QuasiStatic(F, u, points, stabilisation="ghost")
    forces = []
    for x, y in ((0.045, 0), (0.07, 0), (0.07, 0.04), (0.07, 0.1), (0.03, 0.1), (0.07, 0.1)):
        way.value[:] = x, y
        problem.step()
        forces.append(wall.force())
    return np.array(forces)


def test_a_wall_in_space():
    """It pushes from where it stands, slides along the body and lets it go."""
    total, updated = pushed("total"), pushed("updated")
    exact = 100 * np.log(0.98) / 0.98
    np.testing.assert_array_equal(total[[0, 4]], 0.0)
    assert total[1, 0] == pytest.approx(exact, rel=0.02)
    assert abs(total[1, 1]) < 1e-6
    assert total[3, 1] == pytest.approx(0.3 * total[3, 0], rel=0.02)
    np.testing.assert_allclose(total[:5], updated[:5], atol=0.02 * abs(exact))
    # it has been rubbed crooked, and meets the wall with its lower half first
    assert total[5, 0] == pytest.approx(exact, rel=0.1)
    assert total[5, 0] == pytest.approx(updated[5, 0], rel=0.05)
