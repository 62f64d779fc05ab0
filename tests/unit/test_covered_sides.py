"""Absorbing sides act on the part of them that the body covers."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm.dynamics.facesatnodes import Faces

LAW = mpm.materials.Hencky(E=1.0, nu=0.0)
WAYS = {
    "newmark": functools.partial(mpm.Newmark, stabilisation="ghost"),
    "alpha": functools.partial(mpm.GeneralisedAlpha, stabilisation="ghost"),
    "explicit": mpm.Explicit,
    "general": functools.partial(mpm.Explicit, fused=False),
}


@pytest.mark.parametrize(
    ("way", "low", "width", "most"),
    [
        # of cells that are full, and of cut cells
        ("newmark", 2.0, 2.0, 1e-4),
        ("newmark", 2.25, 1.5, 5e-3),
        pytest.param("alpha", 2.25, 1.5, 5e-3, marks=pytest.mark.long),
        ("explicit", 2.0, 1.0, 2e-2),
        pytest.param("explicit", 2.25, 1.5, 3e-2, marks=pytest.mark.long),
        ("general", 2.25, 1.5, 3e-2),
    ],
)
def test_a_side_wider_than_the_body_lets_a_wave_out(way, low, width, most):
    """With dashpots of the whole side, 2 to 15 % of the energy had come back."""
    grid = mpm.create_lattice(COMM, [np.arange(17.0), np.arange(7.0)])
    points = mpm.fill(grid, mpm.Box((0, low), (16, low + width)), 2, 1.0)
    V = mpm.Space(grid, "gimp" if way in ("explicit", "general") else "bspline2")
    F = mpm.momentum(LAW, points, V.increment, V.test)
    side = mpm.absorbing(V, "left", density=1.0, p_speed=1.0)
    problem = WAYS[way](F, V.increment, points, side)

    def wave(x):
        return 1e-4 * np.exp(-(((x - 8.0) / 2.5) ** 2))

    def stress(x):
        found = np.zeros((x.shape[1], 3, 3))
        found[:, 0, 0] = wave(x[0])
        return found

    # a wave to the left: its stress is ρ c v
    points["velocity"][:, 0] = wave(points["x"][:, 0])
    mpm.set_stress(LAW, points, stress)
    first = problem.energies()
    for t in mpm.times(16.0, dt=0.1):
        problem.step(t)
    last = problem.energies()
    assert last.kinetic + last.strain < most * (first.kinetic + first.strain)


@pytest.mark.parametrize("basis", ["gimp", "bspline2", "bspline3"])
def test_dashpots_have_the_area_of_the_body(basis):
    lines = [np.arange(7.0), [0.0, 1.0, 1.5, 2.0, 3.0, 4.0], np.arange(5.0)]
    grid = mpm.create_lattice(COMM, lines)
    V = mpm.Space(grid, basis)
    body = mpm.Box((0, 1.25, 0), (3, 2.5, 1.5))
    points = mpm.fill(grid, body, 4, 1.0)
    sides = mpm.absorbing(V, "left", density=2.0, p_speed=5.0, s_speed=3.0)
    faces = Faces(sides, V.basis, 3)
    assert faces.cover(points)
    owned = faces.dashpots[: V.basis.nodes.owned]
    found = COMM.allreduce(owned.sum(axis=0))
    assert found == pytest.approx(np.array([10.0, 6.0, 6.0]) * 1.25 * 1.5, rel=1e-9)
    assert not faces.cover(points)
    # what goes up along the side takes its dashpots with it
    points["x"] += (0.0, 0.0, 1.25)
    assert faces.cover(points)
    again = faces.dashpots[: V.basis.nodes.owned]
    assert COMM.allreduce(again.sum(axis=0)) == pytest.approx(found, rel=1e-9)
    assert np.abs(again - owned).max() > 0.1
    # a body that is away from the side has the whole side before it
    points["x"] += (3.0, 0.0, 0.0)
    assert faces.cover(points)
    whole = COMM.allreduce(faces.dashpots[: V.basis.nodes.owned, 0].sum())
    assert whole == pytest.approx(10.0 * 16.0, rel=1e-12)


def test_domains_that_do_not_tile_the_body_cover_it():
    """Points of a mesh have domains with gaps and overlaps."""
    grid = mpm.create_lattice(COMM, [np.arange(9.0), np.arange(9.0)])
    V = mpm.Space(grid, "gimp")
    x, y = np.meshgrid(0.35 + 0.7 * np.arange(10), 0.2 + 0.4 * np.arange(5))
    place = np.column_stack([x.ravel(), y.ravel()])
    points = mpm.MaterialPoints.from_arrays(grid, place, 0.28, 1.0)
    faces = Faces(mpm.absorbing(V, "bottom", density=1.0, p_speed=1.0), V.basis, 2)
    assert faces.cover(points)
    area = COMM.allreduce(faces.dashpots[: V.basis.nodes.owned, 1].sum())
    assert area == pytest.approx(7.0, rel=0.02)


@pytest.mark.parametrize("moved", [0.0, 0.5])
def test_ground_that_repeats_itself_covers_the_whole_side(moved):
    grid = mpm.create_lattice(COMM, [np.arange(7.0), np.arange(5.0), np.arange(5.0)])
    V = mpm.Space(grid, "bspline2")
    points = mpm.fill(grid, mpm.Box((3, 0, 0), (4, 1.5, 4)), 2, 1.0)
    points["x"] += (moved, 0.0, 0.0)
    side = mpm.absorbing(V, "front", density=1.0, p_speed=1.0)
    faces = Faces(side, V.basis, 3, repeated={0: 1})
    assert faces.cover(points)
    area = COMM.allreduce(faces.dashpots[: V.basis.nodes.owned].sum())
    assert area == pytest.approx(6.0 * 4.0)
    side = mpm.absorbing(V, "bottom", density=1.0, p_speed=1.0)
    faces = Faces(side, V.basis, 3, repeated={0: 1})
    assert faces.cover(points)
    area = COMM.allreduce(faces.dashpots[: V.basis.nodes.owned].sum())
    assert area == pytest.approx(6.0 * 1.5)


def test_dashpots_have_the_area_of_a_ring():
    grid = mpm.create_lattice(COMM, [np.arange(7.0), np.arange(5.0)])
    V = mpm.Space(grid, "gimp")
    points = mpm.fill(grid, mpm.Box((1, 0), (4, 2)), 2, 1.0, axisymmetric=True)
    faces = Faces(mpm.absorbing(V, "bottom", density=1.0, p_speed=1.0), V.basis, 2, True)
    assert faces.cover(points)
    area = COMM.allreduce(faces.dashpots[: V.basis.nodes.owned, 1].sum())
    assert area == pytest.approx(np.pi * (16.0 - 1.0), rel=0.02)
