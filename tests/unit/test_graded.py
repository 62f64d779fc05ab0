"""Grids with a fine zone that moves: lines, and steps as on a grid that was made so."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM, unit_grid
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError, PointsOutsideGridError, UnsupportedGridError
from dolfinmpm.grid.graded import set_lines


def lines(middle, top=3.0):
    return [
        mpm.zoned_line(0, 4, (middle - 0.5, middle + 0.5), (5, 6, 7)),
        mpm.zoned_line(0, top, (1.4, 2.4), (4, 6, 2)),
    ]


def test_lines_of_a_zone():
    for middle in (0.8, 2.0, 3.3):
        line = mpm.zoned_line(0.0, 4.0, (middle - 0.5, middle + 0.5), (5, 10, 6))
        steps = np.diff(line)
        assert line.size == 22
        assert (line[0], line[-1]) == (0.0, 4.0)
        np.testing.assert_allclose(steps[5:15], 0.1)
        ratios = steps[1:] / steps[:-1]
        np.testing.assert_allclose(ratios[:4], ratios[0])
        np.testing.assert_allclose(ratios[15:], ratios[15])
        # the first cell outside differs by the same ratio
        assert steps[15] / 0.1 == pytest.approx(ratios[15])
        assert 0.1 / steps[4] == pytest.approx(ratios[0])
    # at an end of the grid nothing is on that side
    np.testing.assert_allclose(mpm.zoned_line(0, 1, (0, 1), (0, 4, 0)), np.linspace(0, 1, 5))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ((0, 4, (3.5, 4.5), (1, 1, 1)), "must lie within"),
        ((0, 4, (2.0, 1.0), (1, 1, 1)), "must lie within"),
        ((0, 4, (1.0, 2.0), (1, 0, 1)), "at least one cell"),
        ((0, 4, (0.0, 2.0), (1, 2, 1)), "room if there are cells"),
        ((0, 4, (1.0, 2.0), (0, 2, 4)), "cells if there is room"),
        ((0, 40, (1.0, 2.0), (1, 2, 1)), "give more cells"),
        ((0, 4, (0.3, 3.0), (9, 2, 4)), "give fewer cells"),
        ((0, 4, (1.0, "x"), (1, 2, 1)), "number"),
    ],
)
def test_lines_that_cannot_be(given, text):
    with pytest.raises(ParameterError, match=text):
        mpm.zoned_line(*given)


def test_a_grid_of_lines():
    grid = mpm.create_lattice(COMM, lines(1.0))
    volume = fem.assemble_scalar(fem.form(fem.Constant(grid, 1.0) * ufl.dx))
    assert COMM.allreduce(volume) == pytest.approx(12.0)
    h = mpm.cell_size(grid)
    before = h.x.array.copy()
    set_lines(grid, lines(2.0))
    assert mpm.cell_size(grid) is h
    assert np.abs(h.x.array - before).max() > 0.1
    np.testing.assert_allclose(np.unique(np.round(grid.geometry.x[:, 0], 12)), lines(2.0)[0])
    box = mpm.create_lattice(COMM, [[0, 1, 3], [0, 1, 2], [0, 0.5, 2]])
    assert box.geometry.x.max(axis=0).tolist() == [3, 2, 2]


def evenly(grid):
    """Points that are as dense everywhere as the finest cells need."""
    n = np.array([50, 28])
    h = np.array([4.0, 2.2]) / n
    places = np.meshgrid(*((np.arange(k) + 0.5) for k in n), indexing="ij")
    x = np.stack(places, axis=-1).reshape(-1, 2) * h
    return mpm.MaterialPoints.from_arrays(grid, x, h.prod(), 1000.0, half_length=h / 2)


def problem_on(grid, points, basis, stabilisation, fbar=False, kind=mpm.QuasiStatic):
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    law = mpm.materials.VonMises(E=1e5, nu=0.3, radius=3e3)
    g = fem.Constant(grid, (0.5, -2.0))
    F = mpm.momentum(law, points, u, v, fbar=fbar)
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    options = {"stabilisation": stabilisation, "tolerance": 1e-12}
    return kind(F, u, points, bcs, **options), g


@pytest.mark.parametrize(
    ("basis", "stabilisation", "fbar", "kind"),
    [
        ("linear", "ghost", False, mpm.QuasiStatic),
        ("gimp", "aggregation", True, mpm.QuasiStatic),
        ("bspline2", "ghost", True, mpm.QuasiStatic),
        ("bspline3", "ghost", False, mpm.QuasiStatic),
        ("gimp", "ghost", False, mpm.Newmark),
    ],
)
def test_a_step_is_that_on_a_grid_made_so(basis, stabilisation, fbar, kind):
    grid = mpm.create_lattice(COMM, lines(1.0))
    problem, g = problem_on(grid, evenly(grid), basis, stabilisation, fbar, kind)
    time = (0.01,) if kind is mpm.Newmark else ()
    problem.step(*time)
    mpm.regrid(problem, lines(2.2))
    fresh = mpm.create_lattice(COMM, lines(2.2))
    moved, points = evenly(fresh), problem.points
    other, f = problem_on(fresh, moved, basis, stabilisation, fbar, kind)
    order = np.argsort(points["id"])
    for name, values in points.fields.items():
        if name not in ("id", "cell"):
            moved.fields[name][np.argsort(moved["id"])] = values[order]
    moved.locate()
    if kind is mpm.Newmark:
        other.scheme.set_state(problem.scheme.state())
        other.loads.change = problem.loads.change
    other.loads.accept()
    time = (0.02,) if time else ()
    for load, one in ((g, problem), (f, other)):
        load.value[:] = 1.0, -4.0
        one.step(*time)
    assert np.abs(points["x"] - points["x0"]).max() > 1e-4
    new = np.argsort(moved["id"])
    np.testing.assert_allclose(points["x"][order], moved["x"][new], rtol=0, atol=1e-12)
    np.testing.assert_allclose(points["stress"][order], moved["stress"][new], atol=1e-6)


def test_a_zone_follows_what_presses():
    """Steps with a grid that is laid anew each time; the force goes on where it was."""
    grid = mpm.create_lattice(COMM, lines(1.0))
    points = evenly(grid)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=1e5, nu=0.3)
    base = mpm.Boundary.from_polygon(points, [(0.0, 0.0), (4.0, 0.0)], closed=False, follows=False)
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, u, v) + mpm.dirichlet(base, u, v, law=law)
    F -= ufl.inner(points.density * g, v) * points.dX
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "right"), stabilisation="ghost")
    g.value[1] = -1.0
    weight = 1000.0 * 4.0 * 2.2
    heights = []
    for middle in (0.8, 1.4, 2.0, 2.6):
        mpm.regrid(problem, lines(middle))
        problem.step()
        assert base.force()[1] == pytest.approx(weight, rel=1e-6)
        heights.append(points["x"][:, 1].max())
    # the same load on another grid moves next to nothing
    assert np.ptp(heights[1:]) < 0.02 * (points["x0"][:, 1].max() - heights[-1])


@pytest.mark.parametrize("kind", [mpm.QuasiStatic, mpm.Explicit])
def test_other_problems_on_the_grid_tell_that_its_lines_have_gone(kind):
    grid = mpm.create_lattice(COMM, lines(1.0))
    problem, g = problem_on(grid, evenly(grid), "gimp", "ghost")
    points = evenly(grid)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.3), points, V.increment, V.test)
    other = kind(F, V.increment, points, mpm.fixed(V, "bottom"))
    time = () if kind is mpm.QuasiStatic else (1e-4,)
    other.step(*time)
    mpm.regrid(problem, lines(2.2))
    with pytest.raises(ParameterError, match=r"for another problem, .* make a new Space and a new"):
        other.step(*(2 * t for t in time))
    g.value[:] = 0.5, -2.0
    problem.step()
    # what is made then goes on
    stale = points["cell"].copy()
    W = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.3), points, W.increment, W.test)
    fresh = kind(F, W.increment, points, mpm.fixed(W, "bottom"))
    assert (points["cell"] != stale).any()
    fresh.step(*time)
    problem.step()


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_leaves_are_those_of_the_new_lines(basis):
    """The same cells are split before and after; their lines are others."""

    def zoned(low):
        return [mpm.zoned_line(0, 6, (low, low + 1), (4, 4, 5)), range(5)]

    found = []
    for again in (False, True):
        grid = mpm.create_lattice(COMM, zoned(2))
        points = mpm.fill(grid, mpm.Box((0, 0), (6, 2.3)), per_cell=6, density=1e3)

        def loaded(grid=grid, points=points):
            options = {"refine": lambda x: np.where(x[1] > 1.4, 0.25, 9.0), "levels": 2}
            V = mpm.Space(grid, basis, per_cell=None, **options)
            u, v = V.increment, V.test
            F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.3), points, u, v)
            F -= ufl.inner(points.density * fem.Constant(grid, (0.5, -2.0)), v) * points.dX
            bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
            return mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-12)

        problem = loaded()
        problem.step()
        mpm.regrid(problem, zoned(3))
        problem = loaded() if again else problem
        problem.step()
        leaves = problem.form.spaces[0].refinement.leaves
        low = leaves.tree.corners(leaves.node)[0][leaves.size == 4, 0]
        assert np.isin(np.round(low, 9), np.round(zoned(3)[0], 9)).all()
        found.append(points["x"].copy())
    np.testing.assert_allclose(*found, atol=1e-12)


def test_what_cannot_be_laid_anew():
    grid = mpm.create_lattice(COMM, lines(1.0))
    problem, _ = problem_on(grid, evenly(grid), "gimp", "ghost")
    with pytest.raises(ParameterError, match="give the same number"):
        mpm.regrid(problem, [np.linspace(0, 4, 5), np.linspace(0, 3, 13)])
    with pytest.raises(ParameterError, match="increasing"):
        mpm.regrid(problem, [lines(1.0)[0][::-1], lines(1.0)[1]])
    with pytest.raises(ParameterError, match="two or three arrays"):
        mpm.create_lattice(COMM, [np.linspace(0, 1, 3)])
    with pytest.raises(PointsOutsideGridError):
        mpm.regrid(problem, [lines(1.0)[0], lines(1.0)[1] * 0.7])
    uniform = unit_grid("quadrilateral", 4)
    points = mpm.fill(uniform, mpm.Box((0, 0), (1, 0.6)), 2, 1.0)
    still, _ = problem_on(uniform, points, "gimp", "ghost")
    with pytest.raises(UnsupportedGridError, match="have one size"):
        set_lines(mpm.create_lattice(COMM, [np.linspace(0, 1, 4)] * 2), [np.linspace(0, 1, 4)] * 2)
    with pytest.raises((UnsupportedGridError, ParameterError)):
        mpm.regrid(still, [np.linspace(0, 1, 5), np.linspace(0, 1, 6)])
    with pytest.raises(ParameterError, match="QuasiStatic"):
        mpm.regrid(grid, lines(1.0))
