"""Areas on which a limit of the shear stress acts, beside oblique and round bodies."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.contact.cornerareas import slip_areas


def stairs(normal, half):
    """Areas of the corners of one point on a surface with this normal; one corner just touches."""
    normal, d = np.asarray(normal) / np.linalg.norm(normal), len(normal)
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=d)))
    half, normal = np.tile(half, (len(signs), 1)), np.tile(normal, (len(signs), 1))
    gap = np.sum((signs * half) * normal, axis=1)
    touches = gap < gap.min() + 1e-12
    areas = slip_areas(half, normal, signs, 2 * np.abs(normal) * half, gap - gap.min())
    return areas[touches]


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
    ahead = np.array([[1e-3, 0.2]] * 2)
    areas = slip_areas(np.full((2, 2), 0.05), normal, signs, ahead, np.array([-2e-3, -1e-3]))
    np.testing.assert_allclose(areas, [0.075, 0.025])


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


@pytest.mark.filterwarnings("ignore::dolfinmpm._platform.errors.OverlapWarning")
def test_a_disc_with_adhesion_in_deep_clay():
    """Randolph & Houlsby 1984, doi 10.1680/geot.1984.34.4.613; adhesion acts on 0.9 of the disc."""
    loads = [load_of_a_disc(adhesion) for adhesion in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(loads, [9.14, 10.82, 11.94], rtol=0.04)
    assert loads[0] == pytest.approx(9.14, rel=0.005)
