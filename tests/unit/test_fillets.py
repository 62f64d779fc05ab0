"""Sharp edges of surface meshes made round."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from mpi4py import MPI
from scipy.spatial import ConvexHull

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError, ParameterError
from dolfinmpm.contact.shapesurface import surface_of


def hull(x):
    """The closed surface around positions, of triangles that look outwards."""
    x = np.asarray(x, float)
    found = ConvexHull(x)
    a, b, c = (x[found.simplices[:, k]] for k in range(3))
    inward = np.sum(np.cross(b - a, c - a) * (a - x.mean(axis=0)), axis=1) < 0
    triangles = np.where(inward[:, None], found.simplices[:, ::-1], found.simplices)
    return meshio.Mesh(x, [("triangle", triangles)])


BOX = [(i, 2 * j, 3 * k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
# a share: a wedge in front of a box
SHARE = [(x, y, z) for z in (-1, 1) for x, y in ((0, 0), (-1, 1), (-2, 1), (-2, -1), (-1, -1))]
PYRAMID = [(1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0), (0, 0, 1)]


def test_a_box_of_triangles_is_that_which_is_a_shape(tmp_path):
    hull(BOX).write(tmp_path / "box.stl")
    x = np.random.default_rng(0).uniform(-1, 4, (2000, 3))
    found = surface_of(str(tmp_path / "box.stl"), 0.2).probe(x)
    exact = surface_of(mpm.Box((0, 0, 0), (1, 2, 3)), 0.2).probe(x)
    np.testing.assert_allclose(found[0], exact[0], atol=1e-6)
    outside = exact[0] > 1e-3
    np.testing.assert_allclose(found[1][outside], exact[1][outside], atol=1e-4)


@pytest.mark.parametrize("corners", [BOX, SHARE, PYRAMID], ids=["box", "share", "pyramid"])
@pytest.mark.parametrize("radius", [0.05, 0.1])
def test_a_body_stays_within_its_shape_and_keeps_its_faces(corners, radius):
    sharp, body = surface_of(hull(corners), 0.0), surface_of(hull(corners), radius)
    x = np.random.default_rng(1).uniform(-2.5, 3.5, (4000, 3))
    g, G = sharp.probe(x)[0], body.probe(x)[0]
    assert np.all(g - 1e-12 <= G)
    # the pyramid's corners lose most
    assert radius * 0.2 < (G - g).max() < 3 * radius
    middle = sharp.x[sharp.facets].mean(axis=1)
    np.testing.assert_allclose(body.probe(middle)[0], 0.0, atol=1e-12)
    # no jump of the normal where a corner slides around an edge
    near = x[np.abs(G) < 0.9 * radius]
    n = body.probe(near)[1]
    step = 1e-5 * np.random.default_rng(3).normal(size=near.shape)
    assert np.abs(body.probe(near + step)[1] - n).max() < 10 * 5e-5 / (0.1 * radius)


def test_concave_edges_stay():
    """Of an angle's section, in the plane; the fillet of the polygon is the same."""
    corners = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], float)
    ring = np.column_stack([np.arange(6), np.roll(np.arange(6), -1)])
    x = np.random.default_rng(4).uniform(-1, 3, (2000, 2))
    found = surface_of(meshio.Mesh(corners, [("line", ring)]), 0.1).probe(x)
    exact = surface_of(mpm.Polygon(corners), 0.1).probe(x)
    np.testing.assert_allclose(found[0], exact[0], atol=1e-12)


def test_a_smooth_mesh_hardly_changes():
    """The planes of many facets meet at its corners, next to each other in direction."""
    up, around = np.meshgrid(np.linspace(-1.4, 1.4, 15), np.linspace(0, 2 * np.pi, 24)[:-1])
    up, around = up.ravel(), around.ravel()
    ball = np.column_stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    sharp, body = surface_of(hull(ball), 0.0), surface_of(hull(ball), 0.05)
    np.testing.assert_allclose(body.probe(1.2 * ball)[0], sharp.probe(1.2 * ball)[0], atol=2e-3)


@pytest.mark.parametrize(
    ("corners", "radius", "text"),
    [
        (BOX, 0.6, "too large"),
        (SHARE, 1.5, "too large"),
        ([(1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0), (0.7, 0.2, 1), (0.7, 0.2, -0.2)], 0.1,
         "planes miss each other"),
        (BOX, -0.1, "fillet"),
    ],
)  # fmt: skip
def test_fillets_that_do_not_fit(corners, radius, text):
    with pytest.raises(ParameterError, match=text):
        mpm.RigidBody(hull(corners), fillet=radius)


@pytest.mark.parametrize(
    ("fillet", "friction", "told"), [(0, 0.5, True), (0.05, 0.5, False), (0, 0, False)]
)
def test_a_step_that_fails_names_the_fillet_as_a_remedy(fillet, friction, told):
    """The edges of a free footing are in line with corners of the points."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(-2, 2.1, 0.5), np.arange(-1, 0.6, 0.5)])
    points = mpm.fill(grid, mpm.Box((-2, -1), (2, 0)), 2, 1700.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    box = mpm.Box((-1, 0), (1, 0.5))
    footing = mpm.RigidBody(box, fillet=fillet, free=(False, True, False), force=(0.0, -5e4))
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F += mpm.contact(footing, points, u, v, friction=friction, corners="material")
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, max_iterations=1, max_halvings=0)
    with pytest.raises(ConvergenceError) as failed:
        problem.step()
    assert ("in line with corners of points, where the normal jumps" in str(failed.value)) == told
    assert ("round it, fillet=..." in str(failed.value)) == told


def test_a_footing_that_tilts_beside_its_edges_is_told_of_the_fillet():
    """A smooth footing that is free to tilt fails where corners are beside its edges."""
    half, c = 0.3, 4e3
    h = half / 4
    lines = [np.arange(-12, 13) * h, np.arange(-8, 3) * h]
    for fillet, told in ((0, True), (0.3 * h, False)):
        grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
        points = mpm.fill(grid, mpm.Box((-12 * h, -8 * h), (12 * h, 0)), 2, 1700.0)
        V = mpm.Space(grid, "gimp")
        u, v = V.increment, V.test
        box = mpm.Box((-half, 0), (half, 0.5))
        footing = mpm.RigidBody(
            box,
            centre=(0.05, 0.0),
            fillet=fillet,
            increment=(0.0, -0.02),
            free=(False, False, True),
        )
        F = mpm.momentum(mpm.materials.Hencky(1e3 * c, 0.3), points, u, v)
        F += mpm.contact(footing, points, u, v)
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        problem = mpm.QuasiStatic(F, u, points, bcs, max_iterations=1, max_halvings=0)
        with pytest.raises(ConvergenceError) as failed:
            problem.step()
        assert ("round it, fillet=..." in str(failed.value)) == told
