"""Terms over ghost facets of lattices: classes of facets against every facet by DOLFINx."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh
from scipy import sparse
from scipy.interpolate import NdBSpline

import dolfinmpm as mpm
from dolfinmpm.assembly.splinefacets import FacetBlock
from dolfinmpm.body.points import GHOST_FACETS
from dolfinmpm.cut.activecells import GhostFacets

SPLINES = ("bspline2", "bspline3")
BASES = ("linear", "gimp", *SPLINES)
LAW = mpm.materials.Hencky(E=1e6, nu=0.3)
CELLS = {1: (9,), 2: (8, 7), 3: (6, 5, 5)}


def box(*cells, size=None):
    """A grid of cells of 0.5 m by 0.4 m by 0.6 m, or of a box of that size."""
    size = np.array(size or np.array([0.5, 0.4, 0.6])[: len(cells)] * cells)
    if len(cells) == 1:
        return mesh.create_interval(COMM, cells[0], [0.0, size[0]])
    ends = [np.zeros(len(cells)), size]
    if len(cells) == 2:
        return mesh.create_rectangle(COMM, ends, cells, mesh.CellType.quadrilateral)
    return mesh.create_box(COMM, ends, cells, mesh.CellType.hexahedron)


def everywhere(grid):
    """A body with holes and steps that reaches two corners of the grid."""
    size = grid.geometry.x.max(axis=0)[: grid.geometry.dim]

    def inside(x):
        scaled = (x.T / size).T
        hole = np.all(np.abs(scaled - 0.6) < 0.15, axis=0)
        return (scaled.sum(axis=0) < 0.7 * len(size)) & ~hole | np.all(scaled > 0.75, axis=0)

    return mpm.Where(inside)


def problem_of(grid, basis, term, shape=None, **options):
    """A problem with a term over facets, its blocks ready; the term is a function of its own."""
    points = mpm.fill(grid, everywhere(grid), per_cell=2, density=1.0)
    V = mpm.Space(grid, basis, shape=shape, averaged=basis == "gimp")
    u, v = V.increment, V.test
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * points.dx + term(points, u, v)
    problem = mpm.QuasiStatic(F, u, points, **options)
    problem.activate()
    return problem


def matrix_of(problem):
    """Sum of the blocks of the terms over the grid, between the solver's nodes."""
    (part,) = problem.here.blocks_of("stiffness")
    rows, columns, blocks = part.rows, part.columns, part.values
    c, size = blocks.shape[1], problem.here.fields[0].basis.nodes.size
    i = rows[:, None, None] * c + np.arange(c)[:, None] + np.zeros((c, c), int)
    j = columns[:, None, None] * c + np.arange(c) + np.zeros((c, c), int)
    shape = size * c, size * c
    return sparse.csr_matrix((blocks.ravel(), (i.ravel(), j.ravel())), shape=shape).toarray()


def on_splines(problem):
    """Whether classes of facets are used."""
    return problem.form.grid.splines == {(0, 0)}


def every_facet(monkeypatch):
    """From now on DOLFINx integrates over every facet."""
    monkeypatch.setattr("dolfinmpm.assembly.gridassembler.uses_facet_classes", lambda *_: False)


def check(monkeypatch, make, tolerance=1e-11):
    """One matrix by classes and by all facets; returns that by classes."""
    problem = make()
    assert on_splines(problem)
    found = matrix_of(problem)
    with monkeypatch.context() as patch:
        every_facet(patch)
        reference = make()
    assert not on_splines(reference)
    expected = matrix_of(reference)
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max())
    return problem


def ghost(points, u, v):
    return mpm.ghost(points, u, v, gamma=2.0)


def by_definition(problem, u, gamma):
    """Ghost penalty of a scalar field of splines: its squared jumps, facet by facet."""
    (field,) = problem.here.fields
    basis, q = field.basis, field.basis.degree
    lines, cells = basis.lattice.lines, basis.lattice.cell_ijk
    values = np.zeros([line.size - 1 + q for line in lines])
    values[tuple(basis.halo.node_ijk.T)] = u
    knots = tuple(np.concatenate([[x[0]] * q, x, [x[-1]] * q]) for x in lines)
    spline = NdBSpline(knots, values, q)
    gauss, weights = np.polynomial.legendre.leggauss(q + 1)
    total = 0.0
    for first, _, second, _ in field.entities[GHOST_FACETS].reshape(-1, 4):
        low, high = np.sort([cells[first], cells[second]], axis=0)
        (across,) = np.flatnonzero(low != high)
        corners = [(x[i], x[i + 1]) for x, i in zip(lines, low)]
        sizes = np.array([x[i + 1] - x[i] for x, i in zip(lines, low)])
        beyond = np.array([x[i + 1] - x[i] for x, i in zip(lines, high)])
        h = min(sizes[across], beyond[across])
        along = [0.5 * (a + b) + 0.5 * (b - a) * gauss for a, b in corners]
        share = [0.5 * (b - a) * weights for a, b in corners]
        # along the normal the highest derivative is constant in either cell
        at = corners[across][1]
        along[across], share[across] = np.array([at]), np.ones(1)
        x = np.stack([c.ravel() for c in np.meshgrid(*along, indexing="ij")], axis=1)
        w = np.prod([c.ravel() for c in np.meshgrid(*share, indexing="ij")], axis=0)
        shift = 1e-6 * sizes[across] * (np.arange(len(lines)) == across)
        order = tuple(int(q * (d == across)) for d in range(len(lines)))
        jump = spline(x + shift, nu=order) - spline(x - shift, nu=order)
        factor = gamma * h ** (2 * q - 1) / ((2 * q + 1) * math.factorial(q) ** 2)
        total += factor * np.sum(w * jump**2)
    return total


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("gdim", [1, 2, 3])
def test_ghost_penalty(basis, gdim):
    check_ghost(problem_of(box(*CELLS[gdim]), basis, ghost))


def test_ghost_penalty_where_all_cells_differ():
    """On a graded grid, whose cells' size is a function."""
    check_ghost(problem_of(graded(20, 1.1), "bspline3", ghost))


def check_ghost(problem):
    """The matrix of a ghost penalty is that of its definition, for each component."""
    assert on_splines(problem)
    block = problem.form.grid._jacobian[0, 0, 0]
    assert isinstance(block, FacetBlock)
    A, gdim = matrix_of(problem), problem.points.gdim
    assert len(np.unique(block.facets.couplings.direction)) == gdim
    np.testing.assert_allclose(A, A.T, atol=1e-11 * np.abs(A).max())
    rng = np.random.default_rng(1)
    for i in range(gdim):
        own = A[i::gdim, i::gdim]
        u = rng.normal(size=len(own))
        assert u @ own @ u == pytest.approx(by_definition(problem, u, gamma=2.0), rel=1e-8)
    A = A.reshape(-1, gdim, len(A) // gdim, gdim)
    assert not np.any(A * (1 - np.eye(gdim))[:, None, :])


# second derivatives in hexahedra, and third ones, take FFCx long: terms of one's own stand for them
@pytest.mark.parametrize(("basis", "gdim"), [("bspline2", 1), ("bspline2", 2), ("bspline3", 1)])
def test_ghost_penalty_by_dolfinx(basis, gdim, monkeypatch):
    problem = check(monkeypatch, lambda: problem_of(box(*CELLS[gdim]), basis, ghost))
    block = problem.form.grid._jacobian[0, 0, 0]
    # borders of the grid on all sides, and insides
    kinds = [np.unique(cells).size for cells, _ in block._kinds]
    assert kinds == [3 if basis == "bspline2" else 5] * gdim


@pytest.mark.parametrize("basis", ["linear", "gimp"])
@pytest.mark.parametrize("gdim", [1, 2, 3])
def test_linear_functions_by_dolfinx(basis, gdim, monkeypatch):
    """A ghost penalty and a term that tells the sides apart, to the last digits."""
    grid = box(*CELLS[gdim])
    problem = check(monkeypatch, lambda: problem_of(grid, basis, ghost), 1e-13)
    check(monkeypatch, lambda: problem_of(grid, basis, one_sided), 1e-13)
    # one class a direction, or two where DOLFINx numbers the upper cell first
    block = problem.form.grid._jacobian[0, 0, 0]
    assert gdim <= len(block.facets.examples) <= 2 * gdim


@pytest.mark.parametrize("gdim", [1, 2, 3])
def test_what_the_classes_leave_out(gdim):
    """DOLFINx integrates over fewer facets than there are."""
    problem = problem_of(box(*CELLS[gdim]), "bspline2", ghost)
    block = problem.form.grid._jacobian[0, 0, 0]
    assert 0 < len(block.facets.examples) <= problem.here.ghost_facets
    assert gdim == 1 or len(block.facets.examples) < problem.here.ghost_facets
    assert block.facets.kind.size == problem.here.ghost_facets


def one_sided(points, u, v):
    """Unsymmetric, and other where the first cell is the upper one."""
    n = ufl.FacetNormal(points.grid)("+")
    a = ufl.as_vector(np.arange(1.0, 1 + points.gdim))
    slope = ufl.dot(ufl.grad(u)("+"), n)
    mixed = ufl.inner(ufl.outer(u("+"), a), ufl.outer(ufl.dot(n, a) * a, v("-")))
    return (ufl.inner(slope, v("+")) + mixed) * points.dS


@pytest.mark.parametrize("gdim", [2, 3])
@pytest.mark.parametrize("basis", SPLINES)
def test_a_term_of_ones_own(basis, gdim, monkeypatch):
    # in the smallest grid every cell is near borders on both sides
    cells = (4, 4, 3) if gdim == 3 and basis == "bspline3" else CELLS[gdim]
    problem = check(monkeypatch, lambda: problem_of(box(*cells), basis, one_sided))
    block = problem.form.grid._jacobian[0, 0, 0]
    A = matrix_of(problem)
    assert np.abs(A - A.T).max() > 0.05 * np.abs(A).max()
    assert all(t.shape[-1] == gdim**2 for t in block._kept.tensors.values())


@pytest.mark.parametrize("basis", SPLINES)
def test_both_sides_come_first(basis, monkeypatch):
    """DOLFINx numbers cells as it likes: a facet's first cell is the lower one or the upper."""
    select = GhostFacets.select

    def swapped(self, active, empty):
        rows = select(self, active, empty).reshape(-1, 4)
        rows[::2] = rows[::2][:, [2, 3, 0, 1]]
        return rows.ravel()

    straight = matrix_of(problem_of(box(8, 7), basis, one_sided))
    monkeypatch.setattr(GhostFacets, "select", swapped)
    problem = check(monkeypatch, lambda: problem_of(box(8, 7), basis, one_sided))
    assert np.abs(matrix_of(problem) - straight).max() > 0.1 * np.abs(straight).max()


def test_two_integrals_and_a_scalar(monkeypatch):
    """Quadrature of its own makes a second integral over the same facets."""

    def term(points, u, v):
        fine = points.dS(metadata={"quadrature_degree": 9})
        rough = points.dS(metadata={"quadrature_degree": 1})
        return u("+") * v("-") * rough + 3.0 * ufl.jump(u) * v("+") * fine + u("-") * v("-") * fine

    check(monkeypatch, lambda: problem_of(box(8, 7), "bspline2", term, shape=()))


def test_constants_that_change(monkeypatch):
    """Tensors are integrated again when a constant of the form has another value."""
    grid = box(8, 7)
    gamma, direction = fem.Constant(grid, 2.0), fem.Constant(grid, (1.0, 0.5))

    def term(points, u, v):
        a = ufl.dot(u("+"), direction) * ufl.dot(ufl.dot(direction, ufl.grad(v)("-")), direction)
        return gamma * ufl.inner(ufl.jump(u), v("+")) * points.dS + gamma * a * points.dS

    problem = check(monkeypatch, lambda: problem_of(grid, "bspline2", term))
    once = matrix_of(problem)
    problem.activate()
    np.testing.assert_array_equal(matrix_of(problem), once)
    gamma.value *= 3.0
    problem.activate()
    np.testing.assert_allclose(matrix_of(problem), 3 * once, atol=1e-11 * np.abs(once).max())
    direction.value[:] = (0.2, -0.7)
    problem.activate()
    changed = matrix_of(problem)
    assert np.abs(changed - 3 * once).max() > 0.1 * np.abs(once).max()
    every_facet(monkeypatch)
    expected = matrix_of(problem_of(grid, "bspline2", term))
    np.testing.assert_allclose(changed, expected, atol=1e-11 * np.abs(expected).max())


def test_points_that_move(monkeypatch):
    """New facets and classes come, tensors of the old ones stay."""
    grid = box(12, 9)
    problem = problem_of(grid, "bspline2", ghost)
    block = problem.form.grid._jacobian[0, 0, 0]
    before = dict(block._kept.tensors)
    problem.points["x"][:] = problem.points["x"] * [0.9, 0.8] + [0.6, 0.2]
    problem.activate()
    assert before.keys() < block._kept.tensors.keys()
    assert all(block._kept.tensors[code] is tensor for code, tensor in before.items())
    every_facet(monkeypatch)
    reference = problem_of(grid, "bspline2", ghost)
    reference.points["x"][:] = reference.points["x"] * [0.9, 0.8] + [0.6, 0.2]
    reference.activate()
    expected = matrix_of(reference)
    np.testing.assert_allclose(
        matrix_of(problem), expected, rtol=0, atol=1e-11 * np.abs(expected).max()
    )


def graded(cells, ratio):
    """Columns of cells each wider than the one before by a ratio; rows of two heights."""
    grid = mesh.create_unit_square(COMM, cells, 6, mesh.CellType.quadrilateral)
    x = grid.geometry.x
    lines = np.concatenate([[0.0], np.cumsum(ratio ** np.arange(cells))])
    x[:, 0] = np.interp(x[:, 0], np.linspace(0, 1, cells + 1), lines / lines[-1])
    x[:, 1] = np.where(x[:, 1] < 0.49, x[:, 1], 2 * x[:, 1] - 0.5)
    return grid


def test_a_graded_grid():
    """The size of a cell is a function there, and no class is of more than one column."""
    assert not on_splines(problem_of(graded(20, 1.1), "bspline2", ghost))
    assert not on_splines(problem_of(graded(20, 1.1), "bspline2", one_sided))


@pytest.mark.parametrize("basis", BASES)
def test_a_grid_of_few_sizes(basis, monkeypatch):
    """Cells of other sizes nearby are another class."""
    check(monkeypatch, lambda: problem_of(graded(8, 1.0), basis, one_sided))
    check(monkeypatch, lambda: problem_of(graded(5, 1.3), basis, one_sided))


@pytest.mark.parametrize("basis", ["bspline2", "gimp", "linear"])
def test_what_is_not_alike(basis):
    """Terms that vary in space, other entities, other bases: DOLFINx takes every facet."""
    grid = box(8, 7)
    x = ufl.SpatialCoordinate(grid)
    f = fem.Function(fem.functionspace(grid, ("DG", 0)))
    f.x.array[:] = 1.0
    others = [
        lambda points, u, v: x[0] * ufl.inner(u("+"), v("+")) * points.dS,
        lambda points, u, v: f("+") * ufl.inner(u("+"), v("+")) * points.dS,
        lambda points, u, v: ghost(points, u, v) + ufl.inner(u, v) * ufl.dx(grid),
        lambda points, u, v: ghost(points, u, v) + ufl.inner(u("+"), v("+")) * ufl.dS(grid),
        lambda points, u, v: ufl.inner(u, u)("+") * ufl.inner(u("+"), v("+")) * points.dS,
    ]
    for term in others:
        problem = problem_of(grid, basis, term)
        assert not on_splines(problem)
    assert on_splines(problem_of(grid, basis, ghost))


def test_linear_functions_on_other_grids():
    """Where cells are no boxes, or all of other sizes, DOLFINx takes every facet."""
    triangles = mesh.create_unit_square(COMM, 6, 6, mesh.CellType.triangle)
    assert not on_splines(problem_of(triangles, "linear", ghost))
    assert not on_splines(problem_of(graded(20, 1.1), "linear", ghost))


@pytest.mark.parametrize("basis", SPLINES)
def test_with_nodes_that_follow_others(basis, monkeypatch):
    """Ties alone are left to apply: the matrix is Cᵀ A C."""

    def follow(stencils, nodes):
        # the last active node is the mean of the two before it
        size = problem_size[0]
        C = sparse.identity(size, format="lil")
        C[nodes[-1], nodes[-1]] = 0.0
        C[nodes[-1], nodes[-3]] = C[nodes[-1], nodes[-2]] = 0.5
        return C.tocsr()

    grid = box(8, 7)
    free = problem_of(grid, basis, one_sided)
    problem_size = [free.here.fields[0].basis.nodes.size]
    tied = check(monkeypatch, lambda: problem_of(grid, basis, one_sided, prolongation=follow))
    C = sparse.kron(follow(None, free.here.unknowns.fields[0].nodes), sparse.identity(2)).toarray()
    A = matrix_of(free)
    np.testing.assert_allclose(matrix_of(tied), C.T @ A @ C, atol=1e-11 * np.abs(A).max())


@pytest.mark.parametrize("kind", ["aggregation", "weak-aggregation", "extended"])
def test_with_another_stabilisation(kind, monkeypatch):
    """Whose search for roots makes more nodes known, and whose ties are applied on top."""
    stabilisation = mpm.Stabilisation(kind, E=1.0)
    grid = box(8, 7)
    check(monkeypatch, lambda: problem_of(grid, "bspline2", ghost, stabilisation=stabilisation))


@pytest.mark.parametrize("basis", ["linear", "bspline2"])
def test_steps(basis, monkeypatch):
    """A column under its weight with a ghost penalty comes to the same state."""

    def settle():
        grid = box(3, 12, size=(0.75, 3.0))
        points = mpm.fill(grid, mpm.Box((0, 0), (0.75, 2.1)), per_cell=2, density=1e3)
        V = mpm.Space(grid, basis)
        g = fem.Constant(grid, (0.0, 0.0))
        F = mpm.momentum(LAW, points, V.increment, V.test)
        F -= ufl.inner(points.density * g, V.test) * points.dX
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
        for k in range(3):
            g.value[1] = -10.0 * (k + 1)
            problem.step()
        return problem

    problem = settle()
    assert on_splines(problem)
    every_facet(monkeypatch)
    reference = settle()
    assert not on_splines(reference)
    moved = np.abs(reference.points["x"] - reference.points["x0"]).max()
    np.testing.assert_allclose(
        problem.points["x"], reference.points["x"], rtol=0, atol=1e-8 * moved
    )
    iterations = [[record.iterations for record in p.history] for p in (problem, reference)]
    assert iterations[0] == iterations[1]
