"""A body with points or domains that end on grid lines is the same on either side of rounding."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import COMM
from dolfinx import mesh

import dolfinmpm as mpm
from dolfinmpm.dynamics.nodalmass import Mass

SHIFTS = [sign * size for size in (5e-11, 1e-12, 1e-14, 1e-16) for sign in (1, -1)]
BASES = [
    ("linear", {}, 25),
    ("gimp", {}, 25),
    ("bspline2", {}, 36),
    ("bspline3", {}, 49),
    ("bspline2", {"averaged": False}, 36),
    ("bspline3", {"averaged": False}, 49),
]


def block(basis, options, lower, shift):
    """Four cells wide; points without domains are at half cells, from or up to a grid line."""
    grid = mesh.create_rectangle(COMM, [(-4, -4), (4, 4)], (8, 8), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((-2, -2), (2, 2)), 2, 1.0)
    V = mpm.Space(grid, basis, **options)
    if not V.basis.averaged:
        points["x"] += -0.25 if lower else 0.25
    points["x"] += shift
    points.locate()
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.2), points, V.increment, V.test)
    return mpm.Explicit(F, V.increment, points, mass="consistent")


def figures(problem):
    here = problem.activate()
    lumped = Mass(problem.terms, here).lumped
    cells = np.flatnonzero(here.fields[0].cells)
    step = problem.critical_step(exact=True)
    return here.fields[0].active, cells, here.ghost_facets, lumped, step


@pytest.mark.parametrize(("basis", "options", "nodes"), BASES)
@pytest.mark.parametrize("lower", [True, False])
def test_rounding_on_grid_lines_makes_nothing_active(basis, options, nodes, lower):
    active, cells, facets, lumped, step = figures(block(basis, options, lower, 0.0))
    assert active.size == nodes
    assert cells.size == 16
    assert facets > 0
    for shift in SHIFTS:
        found = figures(block(basis, options, lower, shift))
        np.testing.assert_array_equal(found[0], active)
        np.testing.assert_array_equal(found[1], cells)
        assert found[2] == facets
        np.testing.assert_allclose(found[3], lumped, atol=1e-9)
        assert found[4] == pytest.approx(step, rel=1e-8)


@pytest.mark.parametrize("basis", ["linear", "bspline2", "bspline3"])
def test_points_on_grid_lines_see_linear_fields(basis):
    problem = block(basis, {"averaged": False}, False, 0.0)
    s = problem.activate().fields[0].stencils
    x = problem.fields[0].space.basis.node_coordinates()[:, :2]
    for p in range(len(problem.points)):
        nodes, N, dN = s.row(p)
        np.testing.assert_allclose(N @ x[nodes], problem.points["x"][p], atol=1e-14)
        np.testing.assert_allclose(dN.T @ x[nodes], np.eye(2), atol=1e-13)
