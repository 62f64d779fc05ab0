"""Loads on faces that Nitsche's method holds."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import ufl
from mpi4py import MPI

import dolfinmpm as mpm

LOW, LAW = 0.08, mpm.materials.Hencky(1e6, 0.0)


def base_of(points, gdim, end=1.0):
    if gdim == 2:
        return mpm.Boundary.from_polygon(points, [(0, LOW), (end, LOW)], closed=False)
    corners = [(0, 0, LOW), (1, 0, LOW), (1, 1, LOW), (0, 1, LOW)]
    return mpm.Boundary.from_triangles(points, corners, [(0, 2, 1), (0, 3, 2)])


def warnings_of(load, gdim=2, axisymmetric=False, **condition):
    """Messages of a problem whose lower face, within cells, is held and loaded."""
    lines = [0.25 * np.arange(5)] * (gdim - 1) + [0.25 * np.arange(-1, 7)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    box = mpm.Box((0,) * (gdim - 1) + (LOW,), (1.0,) * (gdim - 1) + (LOW + 1,))
    points = mpm.fill(grid, box, 2, 1e3, exact=True, axisymmetric=axisymmetric)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    base = base_of(points, gdim)
    F = mpm.momentum(LAW, points, u, v)
    F += mpm.dirichlet(base, u, v, law=LAW, **condition) + load(points, base, u, v)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mpm.QuasiStatic(F, u, points, stabilisation="ghost")
    return [str(w.message) for w in told if w.category is mpm.errors.HeldLoadWarning]


def face(points, height, normal):
    axis = (0,) * (points.gdim - 1) + (normal,)
    return mpm.Surface(points, lambda x: np.isclose(x[-1], LOW + height), axis, name="face")


def same(points, base, u, v):
    return base.pressure(1e3, u, v)


def own_ufl(points, base, u, v):
    return 1e3 * ufl.dot(base.normal, v) * base.ds


def surface(points, base, u, v):
    return face(points, 0.0, -1).pressure(1e3, u, v)


def part(points, base, u, v):
    return base_of(points, 2, end=0.4).pressure(1e3, u, v)


def along(points, base, u, v):
    return base.traction((1e3, 0.0), v)


def top(points, base, u, v):
    return face(points, 1.0, 1).pressure(1e3, u, v)


def side(points, base, u, v):
    """A face that ends where the held face begins."""
    right = mpm.Surface(points, lambda x: np.isclose(x[0], 1.0), (1, 0))
    return right.pressure(1e3, u, v)


@pytest.mark.parametrize("load", [same, own_ufl, surface, part, along])
@pytest.mark.parametrize("method", ["nitsche", "skew"])
def test_a_load_that_the_penalty_alone_carries_is_told(load, method):
    (message,) = warnings_of(load, method=method)
    assert f'method="{method}" balances the traction of the body' in message


@pytest.mark.parametrize("load", [same, surface])
@pytest.mark.parametrize("more", [{"gdim": 3}, {"axisymmetric": True}], ids=str)
def test_it_is_told_of_bodies_of_all_kinds(load, more):
    assert len(warnings_of(load, direction="normal", **more)) == 1


@pytest.mark.parametrize("load", [top, side])
def test_loads_on_other_faces_are_not_told(load):
    assert not warnings_of(load)


def test_loads_along_free_components_are_not_told():
    assert not warnings_of(along, direction="normal")
    assert not warnings_of(same, direction=(1.0, 0.0))
    assert len(warnings_of(same, direction=(0.0, 2.0))) == 1


def test_a_penalty_alone_takes_loads():
    assert not warnings_of(same, method="penalty")
