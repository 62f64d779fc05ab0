"""Ghost penalties in cells at the outer edge of the grid that the body barely reaches."""

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

h, LOAD = 0.125, 2e5
ELASTIC = mpm.materials.Hencky(1e6, 0.0)


def pressed(basis="gimp", rows=1, depth=1e-9, levels=0):
    """A column on a wall that lies a little above its base, and above `rows` rows of cells."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [h * np.arange(3), h * np.arange(-rows, 10)])
    fine = {"refine": lambda x: np.where(x[1] > 0.5, h / 2, h), "levels": levels} if levels else {}
    V = mpm.Space(grid, basis, **fine)
    u, v = V.increment, V.test
    box = mpm.Box((0.0, -depth * h), (2 * h, 1.0))
    points = mpm.fill(grid, box, 2, 1800.0, exact=True, refine=V if levels else None)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1.0), normal=(0, 1))
    base = mpm.Boundary.from_polygon(points, [(0, 0), (2 * h, 0)], closed=False, spacing=h / 4)
    load = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(ELASTIC, points, u, v) + top.traction(load, v)
    F += mpm.dirichlet(base, u, v, 0.0, law=ELASTIC, direction="normal")
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "right"), stabilisation="ghost")
    for share in (0.5, 1.0):
        load.value[1] = -LOAD * share
        problem.step()
    gap, largest = (
        MPI.COMM_WORLD.allreduce(abs(a).max(initial=0.0), MPI.MAX)
        for a in (base.markers["x"] - base.markers["x0"], u.x.array)
    )
    return gap, largest, -top.mean_displacement()[1]


@pytest.mark.parametrize(
    ("basis", "levels", "depth"),
    [("gimp", 0, 1e-9), ("gimp", 0, 1e-4), ("bspline2", 0, 1e-9), ("gimp", 1, 1e-9)],
)
def test_a_last_row_of_cells_acts_as_one_of_two(basis, levels, depth):
    """The nodes of such cells had moved by 1e7 m, and the base by a tenth of a cell."""
    gap, largest, settled = pressed(basis, 1, depth, levels)
    usual, most, expected = pressed(basis, 2, depth, levels)
    assert gap < max(1e-4 * settled, 1.01 * usual)
    assert largest < max(settled, 1.01 * most)
    assert settled == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("basis", "across", "held"),
    [("bspline3", 0.0, True), ("bspline3", 0.1, True), ("bspline3", 1.0, False),
     ("bspline2", 0.0, False)],
)  # fmt: skip
def test_a_row_of_points_along_a_side_in_cubic_splines(basis, across, held):
    """Cubic splines have two functions more there, which one row of points leaves nearly free."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [h * np.arange(5), h * np.arange(5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4 * h, 4 * h)), 2, 1800.0)
    # points of the cells beside the wall go to its first quarter, more or less
    x = points["x"].copy()
    beside = x[:, 0] < h
    x[beside, 0] = 0.25 * h + across * (x[beside, 0] - 0.25 * h)
    points["x"] = x
    V = mpm.Space(grid, basis)
    F = mpm.momentum(ELASTIC, points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost")
    # the facets of the four cells beside the wall: one each, and three between them
    assert problem.operator().here.ghost_facets == (7 if held else 0)
