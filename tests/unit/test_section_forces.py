"""Forces and moments in sections of bodies."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError

COMM = MPI.COMM_WORLD
LONG, THICK = 10.0, 1.0


def beam(basis, cells, stabilisation, d=2):
    """A cantilever under its weight, and a force of 300 N along and 500 N across at its end."""
    h = THICK / cells
    across = (np.arange(cells + 5) - 2) * h
    wide = [np.arange(2) * THICK] * (d - 2)
    grid = mpm.create_lattice(COMM, [np.arange(int(LONG / h) + 3) * h, *wide, across])
    low = (0.0,) * (d - 1) + (0.3 * h,)
    high = (LONG,) + (THICK,) * (d - 2) + (THICK + 0.3 * h,)
    points = mpm.fill(grid, mpm.Box(low, high), 2, 1000.0)
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(1e9, 0.2), points, V.increment, V.test)
    weight, end = fem.Constant(grid, (0.0,) * (d - 1) + (-1.0,)), (1,) + (0,) * (d - 1)
    F -= ufl.inner(points.density * weight, V.test) * points.dX
    tip = mpm.Surface(points, lambda x: x[0] > LONG - 1e-6, end)
    load = (300.0,) + (0.0,) * (d - 2) + (500.0,)
    F += tip.traction(fem.Constant(grid, load), V.test)
    bcs = mpm.fixed(V, "left")
    mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation).step()
    return points


def exact(x):
    """Normal force, shear force and moment of the beam at x."""
    rest = LONG - x
    q = -1000.0 * THICK
    return np.array([300.0, 500.0 + q * rest, 500.0 * rest + 0.5 * q * rest**2])


@pytest.mark.parametrize(
    ("basis", "cells", "stabilisation", "d", "error"),
    [
        ("bspline2", 4, "aggregation", 2, 3e-3),
        ("bspline2", 4, "ghost", 2, 6e-3),
        ("gimp", 4, "none", 2, 0.02),
        ("gimp", 8, "ghost", 2, 6e-3),
        ("bspline2", 2, "aggregation", 3, 4e-3),
    ],
)
def test_a_cantilever(basis, cells, stabilisation, d, error):
    points = beam(basis, cells, stabilisation, d)
    along = np.eye(d)[0]
    for x in (2.5, 5.13):
        found = mpm.section_forces(points, x * along, 2 * along)
        moment = found.moment[0] if d == 2 else -found.moment[1]
        assert found.area == pytest.approx(THICK, rel=1e-4)
        assert found.centre[0] == pytest.approx(x)
        N, Q, M = exact(x)
        assert found.force[0] == pytest.approx(N, rel=error, abs=1e-3 * abs(Q))
        assert found.force[-1] == pytest.approx(Q, rel=error)
        assert moment == pytest.approx(M, rel=error)
    # the other side pulls back
    back = mpm.section_forces(points, x * along, -along)
    assert back.force == pytest.approx(-found.force)
    assert back.moment == pytest.approx(-found.moment)


def test_an_oblique_section_of_a_uniform_stress():
    grid = mpm.create_lattice(COMM, [np.arange(9) * 0.5, np.arange(9) * 0.5])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 4)), 2, 1000.0)
    stress = np.array([[-3.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 5.0]])
    points["stress"] = stress[:2, :2] if points["stress"].shape[1] == 2 else stress
    n = np.array([1.0, 1.0]) / np.sqrt(2)
    found = mpm.section_forces(points, (2.0, 2.0), (1, 1), width=0.5)
    # 4 √2 in the diagonal, less by twice the distance beside it
    assert found.area == pytest.approx(4 * np.sqrt(2) - 2 * 0.5 / 3, rel=0.01)
    assert found.force == pytest.approx(found.area * stress[:2, :2] @ n)
    assert found.moment[0] == pytest.approx(0.0, abs=1e-9)


def test_a_section_in_fine_cells_of_a_graded_grid():
    """The slab is as wide as the cells at the section: the grid's largest one had smeared it."""
    lines = np.concatenate([np.arange(0, 4, 0.25), np.arange(4, 13, 2.0)])
    grid = mpm.create_lattice(COMM, [lines, np.arange(6) * 0.25])
    points = mpm.fill(grid, mpm.Box((0, 0), (12, 1)), 2, 1000.0)
    x, y = points["x"].T
    points["stress"][:, 0, 0] = (y - 0.5) * (x - 2.0) ** 2
    # s² has the mean w²/6 over the hat of the slab
    of_points = (1 - 0.125**2) / 12
    for at, w in ((2.0, 0.25), (8.5, 2.0)):
        found = mpm.section_forces(points, (at, 0.5), (1, 0))
        mean = (at - 2) ** 2 + w**2 / 6
        assert abs(found.moment[0]) == pytest.approx(mean * of_points, rel=0.15)


def test_points_of_a_tag_count():
    grid = mpm.create_lattice(COMM, [range(7), range(7)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 5)), 2, 1000.0, tag=3)
    points = points + mpm.fill(grid, mpm.Box((2, 0), (6, 5)), 2, 1000.0, tag=4)
    points["stress"][:, 1, 1] = -1000.0
    wall = mpm.section_forces(points, (0, 2.5), (0, 1), tag=3)
    assert wall.force == pytest.approx([0.0, -2000.0])
    assert wall.centre == pytest.approx([1.0, 2.5])
    both = mpm.section_forces(points, (0, 2.5), (0, 1))
    assert both.force == pytest.approx([0.0, -6000.0])


def test_an_axisymmetric_pile_has_the_force_of_the_circumference():
    grid = mpm.create_lattice(COMM, [range(5), range(7)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 5)), 2, 1000.0, axisymmetric=True)
    points["stress"][:, 1, 1] = -1000.0
    found = mpm.section_forces(points, (0, 2.5), (0, 1))
    assert found.area == pytest.approx(4 * np.pi)
    assert found.force == pytest.approx([0.0, -4000.0 * np.pi])


def test_bad_sections_are_refused():
    grid = mpm.create_lattice(COMM, [range(5), range(7)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 5)), 2, 1000.0)
    for arguments, options, text in (
        (((0, 9), (0, 1)), {}, "no point is in the section .* lie between 0.25 and 4.75 m"),
        (((0, 2), (0, 1)), {"tag": 7}, "the points of tag 7 do not exist"),
        (((0, 2), (0, 0)), {}, "normal = .* must not be zero"),
        (((0, 2), (0, 1, 0)), {}, "normal = .* must be 2 finite numbers"),
        (((0,), (0, 1)), {}, "place = .* must be 2 finite numbers"),
        (((0, 2), (0, 1)), {"width": 0.0}, "width = 0 m must be above 0"),
    ):
        with pytest.raises(ParameterError, match=text):
            mpm.section_forces(points, *arguments, **options)


def test_a_section_at_the_end_of_a_beam():
    """At a clamped end half of the moment is missing: it had been so without a message."""
    points = beam("bspline2", 4, "ghost")
    with pytest.warns(mpm.errors.SectionAtEndWarning, match="50 % is beyond the end"):
        end = mpm.section_forces(points, (0.0, 0.5), (1, 0))
    assert end.area == pytest.approx(0.5 * THICK, rel=1e-4)
    first, second = (mpm.section_forces(points, (x, 0.5), (1, 0)).moment[0] for x in (0.25, 0.5))
    # what the message says: continue the line
    assert 2 * first - second == pytest.approx(exact(0.0)[2], rel=0.03)
    with pytest.raises(ParameterError, match="at least the length of the points' domains"):
        mpm.section_forces(points, (5.0, 0.5), (1, 0), width=0.05)
