"""Boundaries: what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI
from test_boundary import LAW, scene

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    FieldShapeError,
    FormError,
    ParameterError,
    PointsOutsideGridError,
    StateError,
    UnsupportedGridError,
)


def _bad():
    grid, points, V = scene()
    u, v = V.increment, V.test
    line = mpm.Boundary.from_polygon(points, [(0.1, 0.1), (0.9, 0.1)], closed=False)
    solid = scene("hexahedron", 2, ((0,) * 3, (1,) * 3))[1]
    other = scene()[1]
    B = mpm.Boundary

    def problem(form, kind=mpm.QuasiStatic, space=V, **options):
        return kind(form, space.increment, points, **options)

    F = mpm.momentum(LAW, points, u, v)
    wall = B.from_side(points, "left")
    total = mpm.Space(grid, "linear", configuration="total")
    lost = [(0.1, 1.5), (0.9, 1.5)]

    def of_total(where):
        form = mpm.momentum(LAW, where.points, total.increment, total.test)
        form += mpm.dirichlet(where, total.increment, total.test, law=LAW)
        return mpm.QuasiStatic(form, total.increment, where.points)

    def late():
        moved = mpm.fill(grid, mpm.Box((0.1, 0.1), (0.9, 0.8)), 2, 1.0)
        moved["x"] = moved["x"] + 0.01
        of_total(B.from_polygon(moved, [(0.1, 0.11), (0.9, 0.11)], closed=False))

    def of_space():
        ends = [(0.1, 0.1), (0.9, 0.1)]
        of_total(B.from_polygon(points, ends, closed=False, follows=False, activates=True))

    def empty_cell():
        corner = mpm.fill(grid, mpm.Box((0.0, 0.0), (0.2, 0.2)), 2, 1.0)
        ends = [(0.6, 0.6), (0.7, 0.6)]
        far = B.from_polygon(corner, ends, closed=False, follows=False, activates=True)
        form = mpm.momentum(LAW, corner, u, v) + mpm.dirichlet(far, u, v, law=LAW)
        mpm.QuasiStatic(form, u, corner).activate()

    return {
        "one corner": (lambda: B.from_polygon(points, [(0, 0)]), ParameterError, "3 or more"),
        "twice": (
            lambda: B.from_polygon(points, [(0, 0), (0, 0), (1, 1)]), ParameterError, "twice",
        ),
        "outside": (
            lambda: B.from_polygon(points, lost, closed=False), PointsOutsideGridError, "outside",
        ),
        "not finite": (
            lambda: B.from_polygon(points, [(0, np.nan), (1, 1), (1, 0)]), ParameterError, "finite",
        ),
        "words": (lambda: B.from_polygon(points, "abc"), FieldShapeError, "array of numbers"),
        "polygon in 3D": (
            lambda: B.from_polygon(solid, [(0, 0), (1, 0), (1, 1)]), UnsupportedGridError, "in 3D",
        ),
        "triangles in 2D": (
            lambda: B.from_triangles(points, [(0, 0, 0)], [[0, 0, 0]]), UnsupportedGridError, "2D",
        ),
        "no such vertex": (
            lambda: B.from_triangles(solid, np.eye(3), [[0, 1, 3]]), ParameterError, "0 ... 2",
        ),
        "triangles of floats": (
            lambda: B.from_triangles(solid, np.eye(3), [[0.0, 1, 2]]), FieldShapeError, "whole",
        ),
        "no level": (lambda: B.from_level_set(points, 3), ParameterError, "function of positions"),
        "nowhere": (
            lambda: B.from_level_set(points, lambda x: 1 + x[0]), EmptyShapeError, "sign nowhere",
        ),
        "level not finite": (
            lambda: B.from_level_set(points, lambda x: np.log(x[0] - 0.5)), ParameterError,
            "finite",
        ),
        "side": (lambda: B.from_side(points, "up"), ParameterError, "side"),
        "side of triangles": (
            lambda: B.from_side(scene("triangle")[1], "left"), UnsupportedGridError, "rectangular",
        ),
        "no area": (
            lambda: B(points, [(0.5, 0.5)], [(0.0, 0.0)]), ParameterError, "is zero",
        ),
        "rows": (
            lambda: B(points, [(0.5, 0.5)], np.ones((2, 2))), FieldShapeError, "1 rows and area 2",
        ),
        "no markers": (lambda: B(points, [], []), EmptyShapeError, "no markers"),
        "follows": (
            lambda: B(points, [(0.5, 0.5)], [(0, 1)], follows="yes"), ParameterError, "True or",
        ),
        "method": (
            lambda: mpm.dirichlet(line, u, v, law=LAW, method="lagrange"), ParameterError, "method",
        ),
        "no boundary": (
            lambda: mpm.dirichlet(points, u, v, law=LAW), ParameterError, r"Boundary\.from_polygon",
        ),
        "value": (
            lambda: mpm.dirichlet(line, u, v, (1.0, 2.0, 3.0), law=LAW),
            ParameterError, "a vector of",
        ),
        "scalar value": (
            lambda: mpm.dirichlet(line, u, v, (1.0, 2.0), law=LAW, direction="normal"),
            ParameterError, "a number along",
        ),
        "UFL value": (
            lambda: mpm.dirichlet(line, u, v, line.x0[0], law=LAW), ParameterError, "a vector of",
        ),
        "direction": (
            lambda: mpm.dirichlet(line, u, v, law=LAW, direction="up"), ParameterError, "direction",
        ),
        "no direction": (
            lambda: mpm.dirichlet(line, u, v, law=LAW, direction=(0, 0)),
            ParameterError, "2 component",
        ),
        "no law": (lambda: mpm.dirichlet(line, u, v), ParameterError, "law = None"),
        "both": (
            lambda: mpm.dirichlet(line, u, v, law=LAW, penalty=1.0, stiffness_per_area=1.0),
            ParameterError, "both",
        ),
        "penalty": (
            lambda: mpm.dirichlet(line, u, v, law=LAW, penalty=-1.0), ParameterError, "penalty",
        ),
        "wall of a body": (
            lambda: mpm.signorini(line, u, v, law=LAW), ParameterError, "belongs to a body",
        ),
        "friction": (
            lambda: mpm.signorini(wall, u, v, law=LAW, friction=-0.1), ParameterError, "friction",
        ),
        "wall without law": (
            lambda: mpm.signorini(wall, u, v), ParameterError, "needs a stiffness",
        ),
        "wall with two moduli": (
            lambda: mpm.signorini(wall, u, v, law=LAW, stiffness_per_area=1e3),
            ParameterError, "law = .* leave out stiffness_per_area",
        ),
        "other points": (
            lambda: problem(
                F + mpm.dirichlet(
                    B.from_polygon(other, [(0.1, 0.1), (0.9, 0.1)], closed=False),
                    u, v, law=LAW,
                )
            ), (FormError, ParameterError), "grid|points",
        ),
        "late": (late, ParameterError, "is unknown: the body had moved"),
        "total in space": (of_space, ParameterError, "stays in space and makes cells active"),
        "an empty cell": (empty_cell, StateError, "has no stiffness"),
    }  # fmt: skip


BAD = (
    "one corner", "twice", "outside", "not finite", "words", "polygon in 3D", "triangles in 2D",
    "no such vertex", "triangles of floats", "no level", "nowhere", "level not finite", "side",
    "side of triangles", "no area", "rows", "no markers", "follows", "method", "no boundary",
    "value", "scalar value", "UFL value", "direction", "no direction", "no law", "both", "penalty",
    "wall of a body", "friction", "wall without law", "wall with two moduli", "other points",
    "late", "total in space", "an empty cell",
)  # fmt: skip


@pytest.fixture(scope="module")
def bad():
    found = _bad()
    assert set(found) == set(BAD)
    return found


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_is_refused(bad, name):
    action, error, text = bad[name]
    with np.errstate(all="ignore"), pytest.raises(error, match=text):
        action()


def test_segments_that_cross_are_refused():
    """Their normals pointed out of the body on one side and into it on the other."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 1, 5)] * 2)
    points = mpm.fill(grid, mpm.Box((0.25, 0.25), (0.75, 0.75)), 2, 1.0)
    corners = [(0.2, 0.2), (0.8, 0.8), (0.8, 0.3), (0.2, 0.7)]
    with pytest.raises(ParameterError, match="segments 0 and 2 of the boundary cross at"):
        mpm.Boundary.from_polygon(points, corners)
    # the chain ends before it comes back
    chain = mpm.Boundary.from_polygon(points, corners[:3], closed=False)
    assert chain.total_area == pytest.approx(0.6 * 2**0.5 + 0.5)
    # two squares that touch at a corner, and a slit that is cut and comes back
    touching = [(0.2, 0.2), (0.5, 0.2), (0.5, 0.5), (0.8, 0.5), (0.8, 0.8), (0.5, 0.8), (0.5, 0.5),
                (0.2, 0.5)]  # fmt: skip
    assert mpm.Boundary.from_polygon(points, touching).total_area == pytest.approx(2.4)


def test_triangles_that_disagree_are_refused():
    """A few that are turned had given forces the other way in silence."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(3)] * 3)
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (2, 2, 1)), 2, 1.0)
    corners = np.array([(0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)], float)
    good, bad = np.array([(0, 1, 2), (0, 2, 3)]), np.array([(0, 1, 2), (0, 3, 2)])
    make = mpm.Boundary.from_triangles
    assert make(points, corners, good).total_area == pytest.approx(4.0)
    # corners of their own, too
    for x, t in ((corners, bad), (corners[bad].reshape(-1, 3), np.arange(6).reshape(2, 3))):
        with pytest.raises(ParameterError, match=r"of 1 sides .* disagree, .* at \[1. 1. 1.\] m"):
            make(points, x, t)


def test_large_triangles_are_cut_on_any_grid():
    """Two triangles on a side of 4 by 4 cells had 12 markers, and pressed on few of them."""
    grid = mesh.create_unit_cube(MPI.COMM_WORLD, 4, 4, 4, mesh.CellType.tetrahedron)
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 0.5)), 2, 1.0)
    corners = np.array([(0, 0, 0.5), (1, 0, 0.5), (1, 1, 0.5), (0, 1, 0.5)])
    made = mpm.Boundary.from_triangles(points, corners, np.array([(0, 1, 2), (0, 2, 3)]))
    x = made.markers["x"]
    counts, *_ = np.histogram2d(x[:, 0], x[:, 1], bins=8, range=[(0, 1)] * 2)
    assert counts.min() > 0
    # a polynomial of degree 4
    weights = made.markers["area"][:, 2]
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ (x[:, 0] ** 2 * x[:, 1] ** 2) == pytest.approx(1 / 9)
