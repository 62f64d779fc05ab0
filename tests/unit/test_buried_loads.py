"""Loads on boundaries within the body are told; loads on faces and walls of cavities are not."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm

SOIL = mpm.materials.Hencky(1e7, 0.3)
HOLE = [(1.3, 1.3), (1.3, 2.7), (2.7, 2.7), (2.7, 1.3)]
MIDDLE, TOP = [(4, 2.0), (0, 2.0)], [(4, 4), (0, 4)]


def told(line, closed=False, kind="pressure", tags=False, hole=False):
    """Messages of a problem of a square block with a load on a line."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 4.1, 0.5), np.arange(0, 5.1, 0.5)])
    block = mpm.Box((0, 0), (4, 4)) - mpm.Polygon(HOLE) if hole else mpm.Box((0, 0), (4, 4))
    points = mpm.fill(grid, block, 2, 1800.0, exact=hole)
    if tags:
        points["tag"][:] = points["x"][:, 1] > 2.0
    V = mpm.Space(grid, "gimp", tag=0 if tags else None)
    u, v = V.increment, V.test
    face = mpm.Boundary.from_polygon(points, line, closed=closed, name="line")
    load = face.pressure(1e4, u, v) if kind == "pressure" else face.traction((0.0, -1e4), v)
    F = mpm.momentum(SOIL, points, u, v, tag=0 if tags else None) + load
    spaces = [V]
    if tags:
        spaces.append(mpm.Space(grid, "gimp", tag=1))
        F += mpm.momentum(SOIL, points, spaces[1].increment, spaces[1].test, tag=1)
    bcs = mpm.fixed(V, "bottom")
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        mpm.QuasiStatic(F, [one.increment for one in spaces], points, bcs)
    return [str(w.message) for w in found if w.category is mpm.errors.BuriedLoadWarning]


@pytest.mark.parametrize("kind", ["pressure", "traction"])
@pytest.mark.parametrize("line", [MIDDLE, MIDDLE[::-1], [(3, 1.7), (1, 1.7)]])
def test_a_load_within_the_body_is_told(kind, line):
    (text,) = told(line, kind=kind)
    assert f"the {kind} on 'line' acts within the body: 100 % of the boundary" in text
    assert "up to 20 %" in text
    assert "a body force over points.dX" in text


def test_a_load_around_ground_that_is_still_there_is_told():
    assert told(HOLE, closed=True)
    assert not told(HOLE, closed=True, hole=True)


def test_loads_on_faces_are_not_told():
    assert not told(TOP)
    assert not told(TOP, kind="traction")
    # the points above are of another field
    assert not told(MIDDLE, tags=True)
