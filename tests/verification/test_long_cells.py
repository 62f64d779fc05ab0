"""Ghost penalties in long cells: their length is the height of the cells normal to a facet."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem
from scipy import sparse

import dolfinmpm as mpm


def block(basis, ratio, part=0.3):
    """A block that fills four cells and a part of the fifth in each direction."""
    hx, hy = 1.0, 1.0 / ratio
    grid = mpm.create_lattice(COMM, [np.arange(9) * hx, np.arange(9) * hy])
    box = mpm.Box((0, 0), ((4 + part) * hx, (4 + part) * hy))
    points = mpm.fill(grid, box, per_cell=3, density=1000.0, exact=True)
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), V.test) * points.dX
    bcs = mpm.fixed(V, "bottom")
    return mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")


@pytest.mark.parametrize(("basis", "most"), [("gimp", 1e5), ("bspline2", 1e5), ("bspline3", 2e8)])
def test_condition_numbers_in_cells_of_ten_to_one(basis, most):
    """The root of a cell's area in place of its height had 1e5, 1e7 and 2e11."""
    parts = 1e-3, 0.3, 0.9
    worst = max(mpm.study.condition_number(block(basis, 10, p).stiffness()) for p in parts)
    assert worst < most


@pytest.mark.parametrize("basis", ["bspline2", "bspline3"])
def test_a_step_in_cells_of_a_thousand_to_one(basis):
    """It had not converged with cubic splines, whose condition number was above 1e16."""
    problem = block(basis, 1000)
    assert problem.step().halvings == 0
    assert mpm.study.condition_number(problem.stiffness()) < 2e10


def test_cells_of_two_heights_take_the_lower_one():
    """A jump at the facet between them costs γ h |jump|² times the facet's length."""
    heights = np.array([1.0, 1.0, 0.1, 0.1, 0.1])
    lines = [np.arange(4.0), np.concatenate([[0.0], np.cumsum(heights)])]
    grid = mpm.create_lattice(COMM, lines)
    points = mpm.fill(grid, mpm.Box((0, 0), (3, 2.05)), per_cell=2, density=1000.0)
    V = mpm.Space(grid, "linear")
    F = mpm.momentum(mpm.materials.Hencky(1e-9, 0.0), points, V.increment, V.test)
    F += mpm.ghost(points, V.increment, V.test, gamma=5.0)
    problem = mpm.QuasiStatic(F, V.increment, points, tolerance=1e-6)
    matrix = problem.stiffness()
    K = sparse.csr_matrix(matrix.getValuesCSR()[::-1], shape=matrix.size)
    # y grows with slope 1 below the facets at y = 2, and with slope 3 above them
    y = V.basis.node_coordinates()[:, 1]
    nodes = problem.here.fields[0].nodes
    u = np.zeros((len(nodes), 2))
    u[:, 1] = np.where(y > 2, 3 * y - 4, y)[nodes]
    vector = u.ravel()
    energy = vector @ (K @ vector)
    assert energy == pytest.approx(5.0 * 0.1 / 3 * 2.0**2 * 3.0, rel=1e-6)


@pytest.mark.parametrize("basis", ["linear", "gimp"])
def test_a_cut_layer_of_thin_cells_carries_its_load(basis):
    """With the mean of both heights the mean stress in it was 38 % too large."""
    thin, load = 0.02, 1e4
    lines = [np.arange(3.0), np.concatenate([np.arange(5.0), 4 + thin * np.arange(1, 4)])]
    grid = mpm.create_lattice(COMM, lines)
    top = 4 + 0.5 * thin
    points = mpm.fill(grid, mpm.Box((0, 0), (2, top)), per_cell=2, density=2000.0, exact=True)
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(1e9, 0.0), points, V.increment, V.test)
    loaded = mpm.Surface(points, lambda x: x[1] > top - 0.3 * thin, normal=(0, 1))
    F += loaded.traction(fem.Constant(grid, (0.0, -load)), V.test)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost").step()
    stress = points["stress"][points["x"][:, 1] > 4, 1, 1]
    assert stress.mean() == pytest.approx(-load, rel=0.03)
