"""Every basis: partition of unity, linear reproduction, agreement with direct averages."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import unit_grid
from dolfinx import mesh
from mpi4py import MPI
from scipy.interpolate import BSpline

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError, UnsupportedGridError
from dolfinmpm.basis.bspline import extension_weights, greville, spline_weights
from dolfinmpm.basis.lineweights import line_weights, overlapped
from dolfinmpm.basis.space import extraction
from dolfinmpm.basis.stencils import gather
from dolfinmpm.basis.uniformweights import middle_count, middle_weights


def everything(grid):
    d = grid.geometry.dim
    return mpm.Box((0.0,) * d, (1.0,) * d)


def check_reproduction(space, points, middle):
    """Sums of N, ∇N, N x and x ⊗ ∇N over the nodes of every point."""
    s = space.basis.stencils(points.placement())
    nodes = space.basis.node_coordinates()[:, : points.gdim]
    for g in range(s.groups.size - 1):
        x = nodes[s.nodes[s.node_start[g] : s.node_start[g + 1]]]
        for k in range(s.groups[g], s.groups[g + 1]):
            start = s.value_start[g] + (k - s.groups[g]) * len(x)
            N, dN = s.N[start : start + len(x)], s.dN[start : start + len(x)]
            assert np.all(N >= -1e-14)
            np.testing.assert_allclose(N.sum(), 1, atol=1e-13)
            np.testing.assert_allclose(dN.sum(axis=0), 0, atol=1e-12)
            np.testing.assert_allclose(N @ x, middle[s.order[k]], atol=1e-12)
            np.testing.assert_allclose(x.T @ dN, np.eye(points.gdim), atol=1e-12)


def test_linear_reproduces_linear_fields(any_grid):
    points = mpm.fill(any_grid, everything(any_grid), per_cell=2, density=1.0)
    check_reproduction(mpm.Space(any_grid, "linear"), points, points["x"])


@pytest.mark.parametrize("kind", ["interval", "quadrilateral", "hexahedron"])
def test_gimp_reproduces_linear_fields_on_any_domain(kind):
    grid = unit_grid(kind)
    points = mpm.fill(grid, everything(grid), per_cell=2, density=1.0)
    rng = np.random.default_rng(1)
    points["l"] = rng.uniform(0.01, 0.4, points["l"].shape)
    # what reaches outside the grid is cut off, which moves the middle of the domain
    low = np.maximum(points["x"] - points["l"], 0)
    high = np.minimum(points["x"] + points["l"], 1)
    check_reproduction(mpm.Space(grid, "gimp"), points, 0.5 * (low + high))


@pytest.mark.parametrize("basis", ["bspline2", "bspline3"])
@pytest.mark.parametrize("kind", ["interval", "quadrilateral", "hexahedron"])
def test_splines_reproduce_linear_fields(kind, basis):
    grid = unit_grid(kind)
    points = mpm.fill(grid, everything(grid), per_cell=2, density=1.0)
    check_reproduction(mpm.Space(grid, basis), points, points["x"])


@pytest.mark.parametrize("degree", [2, 3])
def test_splines_are_smooth_and_their_slopes_are_right(degree):
    """Against SciPy's, on cells of unequal size, the ends included."""
    line = np.array([0.0, 0.3, 0.5, 1.1, 1.6, 1.7])
    knots = np.concatenate([[line[0]] * degree, line, [line[-1]] * degree])
    S, dS = np.empty(64), np.empty(64)
    for x in np.linspace(0.01, 1.69, 57):
        cell = int(np.searchsorted(line, x, side="right")) - 1
        spline_weights(line, cell, degree, x, S, dS)
        for i in range(degree + 1):
            exact = BSpline(knots, np.eye(line.size - 1 + degree)[cell + i], degree)
            assert S[i] == pytest.approx(float(exact(x)), abs=1e-13)
            assert dS[i] == pytest.approx(float(exact(x, nu=1)), abs=1e-11)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("graded", [False, True])
def test_extension_continues_polynomials(degree, graded):
    line = np.linspace(0, 1, 9) ** (1.5 if graded else 1)
    n = line.size - 1 + degree
    knots = np.concatenate([[line[0]] * degree, line, [line[-1]] * degree])
    x = greville(line, degree)
    for power in range(degree + 1):
        # coefficients of a polynomial, by interpolation at the Greville points
        matrix = BSpline.design_matrix(np.clip(x, 0, 1 - 1e-12), knots, degree).toarray()
        coefficients = np.linalg.solve(matrix, np.clip(x, 0, 1 - 1e-12) ** power)
        for cell in (0, 3, 7):
            for function in range(n):
                weights = extension_weights(line, degree, cell, function)
                value = weights @ coefficients[cell : cell + degree + 1]
                assert value == pytest.approx(coefficients[function], abs=1e-8)


def test_extension_is_hoellig_s_formula_on_equal_cells():
    line = np.arange(12.0)
    for degree in (2, 3):
        cell, function = 5, 9
        weights = extension_weights(line, degree, cell, function)
        for i in range(degree + 1):
            factors = [(function - cell - m) / (i - m) for m in range(degree + 1) if m != i]
            assert weights[i] == pytest.approx(np.prod(factors), rel=1e-9)


def test_extraction_gives_the_same_function():
    """A spline and its Lagrange form agree at random points, in value and gradient."""
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, everything(grid), per_cell=3, density=1.0)
    for basis in ("bspline2", "bspline3"):
        V = mpm.Space(grid, basis, shape=(), averaged=False)
        u = np.random.default_rng(2).uniform(-1, 1, (V.basis.nodes.size, 1))
        V.increment.x.array[:] = (extraction(V, V.basis) @ u)[:, 0]
        value, gradient = np.empty((len(points), 1)), np.empty((len(points), 1, 2))
        gather(V.basis.stencils(points.placement()), u, value, gradient)
        x = np.zeros((len(points), 3))
        x[:, :2] = points["x"]
        np.testing.assert_allclose(V.increment.eval(x, points["cell"]), value, atol=1e-12)


def test_gimp_on_a_graded_grid():
    grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
    grid.geometry.x[:, 0] **= 2
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), per_cell=2, density=1.0)
    np.testing.assert_allclose(points["V"].sum(), 1)
    check_reproduction(mpm.Space(grid, "gimp"), points, points["x"])


def test_gimp_is_the_average_of_the_linear_functions():
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0.3, 0.4), (0.31, 0.41)), per_cell=1, density=1.0)
    assert len(points) == 1
    points["x"] = (0.52, 0.41)
    points["l"] = (0.17, 0.13)
    nodes, N, dN = mpm.Space(grid, "gimp").basis.stencils(points.placement()).row(0)
    X = mpm.Space(grid, "gimp").function_space.tabulate_dof_coordinates()[nodes, :2]
    offset = (np.arange(2000) + 0.5) / 1000 - 1
    h = np.array([1 / 4, 1 / 5])
    expected, slope = np.ones(len(nodes)), np.ones((len(nodes), 2))
    for d in range(2):
        t = (points["x"][0, d] + points["l"][0, d] * offset[:, None] - X[:, d]) / h[d]
        hat = np.maximum(1 - np.abs(t), 0).mean(axis=0)
        kink = np.where(np.abs(t) < 1, -np.sign(t) / h[d], 0).mean(axis=0)
        expected *= hat
        for e in range(2):
            slope[:, e] *= kink if d == e else hat
    np.testing.assert_allclose(N, expected, atol=2e-3)
    np.testing.assert_allclose(dN, slope, atol=2e-2)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("graded", [False, True])
def test_splines_are_averaged_over_domains(degree, graded):
    """Against integrals of SciPy's splines, exact by their antiderivatives."""
    grid = mesh.create_unit_interval(MPI.COMM_WORLD, 7)
    if graded:
        grid.geometry.x[:, 0] **= 1.5
    line = np.sort(grid.geometry.x[:, 0])
    points = mpm.fill(grid, mpm.Box(0.5, 0.51), per_cell=1, density=1.0)
    V = mpm.Space(grid, "gimp" if degree == 1 else f"bspline{degree}")
    knots = np.concatenate([[0.0] * degree, line, [1.0] * degree])
    for x, half in ((0.5, 0.31), (0.42, 0.02), (0.05, 0.05), (0.9, 0.1), (2 / 7, 0.01)):
        points["x"], points["l"] = (x,), (half,)
        nodes, N, dN = V.basis.stencils(points.placement()).row(0)
        for a, i in enumerate(V.basis.halo.node_ijk[nodes, 0]):
            spline = BSpline(knots, np.eye(line.size - 1 + degree)[i], degree)
            low, high = max(x - half, 0.0), min(x + half, 1 - 1e-15)
            assert N[a] == pytest.approx(spline.integrate(low, high) / (high - low), abs=1e-12)
            slope = (spline(high) - spline(low)) / (high - low)
            assert dN[a, 0] == pytest.approx(float(slope), abs=1e-10)


def test_a_domain_that_ends_on_a_line_activates_nothing_beyond():
    """Rounding at 1/3 must not make a cell active with a share of 1e-16."""
    grid = unit_grid("interval", 30)
    points = mpm.fill(grid, mpm.Box(0, 1), per_cell=3, density=1.0)
    s = mpm.Space(grid, "gimp").basis.stencils(points.placement())
    assert np.all(np.diff(s.cell_start) == 1)
    assert s.groups.size - 1 == 30


def test_wide_domains_span_many_cells():
    grid = unit_grid("interval", 10)
    points = mpm.fill(grid, mpm.Box(0.4, 0.5), per_cell=1, density=1.0)
    points["l"] = (0.33,)
    nodes, N, _ = mpm.Space(grid, "gimp").basis.stencils(points.placement()).row(0)
    assert len(nodes) == 8
    np.testing.assert_allclose(N.sum(), 1)


@pytest.mark.parametrize("kind", ["triangle", "distorted quadrilateral", "tetrahedron"])
def test_gimp_refuses_other_grids(kind):
    with pytest.raises(UnsupportedGridError, match="rectangular"):
        mpm.Space(unit_grid(kind), "gimp")


def test_unknown_basis():
    with pytest.raises(ParameterError, match="'splines'"):
        mpm.Space(unit_grid("interval"), "splines")


@pytest.mark.parametrize("averaged", [False, True])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_weights_in_the_middle_of_a_uniform_line_are_those_of_any_line(degree, averaged):
    cells = 12
    line = np.linspace(-0.7, 1.7, cells + 1)
    h = line[1] - line[0]
    rng = np.random.default_rng(3)
    n = middle_count(degree, averaged)
    found, expected = np.empty((2, n)), np.zeros((2, 64))
    room = np.empty(degree + 1), np.empty(degree + 1)
    used = 0
    positions = [*rng.uniform(line[0], line[-1], 400), *(0.5 * (line[1:] + line[:-1]))]
    if degree > 1 or averaged:
        # slopes of linear functions at a point jump there
        positions += list(line)
    for k, x in enumerate(positions):
        # domains of a point, small ones, those that end on lines, and some over three cells
        half = (0.3, 1e-2, 0.5, 0.25, 0.9)[k % 5] * h if averaged else 0.0
        known, i = middle_weights(
            degree, averaged, x, half, line[0], 1 / h, cells - 1, found[0], found[1]
        )
        inside = line[0] + degree * h < x - half and x + half < line[-1] - degree * h
        assert known or not inside or half > 0.5 * h, (x, half)
        if not known:
            continue
        used += 1
        first, count = overlapped(line, True, x, half)
        line_weights(line, True, degree, first, count, x, half, *expected, *room)
        for own, one, size in zip(found, expected, (1.0, 1 / h)):
            # rounding may put a point on a line into either cell
            both = np.zeros((2, cells + 8))
            both[0, i : i + n], both[1, first : first + count + degree] = own, one[: count + degree]
            assert np.abs(both[0] - both[1]).max() <= 1e-12 * size, (x, half)
    assert used > 200
