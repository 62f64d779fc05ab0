"""Truncated hierarchical B-splines on leaves: smoothness, order, patch tests, stabilisation."""

from __future__ import annotations

import numpy as np
import pytest
import test_refinement as refined
import ufl
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm.basis.leafsplines import LeafSplines
from dolfinmpm.grid.leafsearch import node_at
from dolfinmpm.solve.leaflevels import joined


def on_leaves(gdim, degree, seed=7, levels=3, cells=4):
    """A basis of splines on random leaves all over a grid."""
    grid, rng = refined.lattice(gdim, cells), np.random.default_rng(seed)
    size = refined.random_size(rng, gdim, levels)
    V = mpm.Space(grid, f"bspline{degree}", refine=size, levels=levels, per_cell=1)
    points = mpm.fill(grid, mpm.Box((0,) * gdim, (cells,) * gdim), 1, 1.0, refine=V)
    V.refinement.update_leaves(points.placement("updated"), True)
    return V, V.refinement.basis(V.basis, 0, None)


@pytest.mark.parametrize("degree", [2, 3])
@pytest.mark.parametrize("gdim", [2, 3])
def test_hanging_splines_follow_independent_ones(gdim, degree):
    _, basis = on_leaves(gdim, degree)
    splines = LeafSplines.of(basis.leaves, degree)
    assert splines.hanging.any()
    assert not splines.hanging[splines.matrix.indices].any()
    assert splines.matrix.data.min() > 0
    assert np.abs(splines.matrix.sum(axis=1) - 1).max() < 1e-14
    # a polynomial's coefficients on each level are its blossoms at the inner knots
    knots, rng = splines.inner_knots(basis.leaves.tree), np.random.default_rng(1)
    a = rng.normal(size=(gdim, 2))
    along = a[:, 0] + a[:, 1] * np.prod(knots[:, :, :2], axis=2) if degree == 2 else (
        a[:, 0] + a[:, 1] * np.prod(knots, axis=2)
    )  # fmt: skip
    f = np.prod(along, axis=1)
    known = np.where(splines.hanging, 0.0, f)
    assert np.abs(splines.matrix @ known - f).max() < 1e-12 * np.abs(f).max()


@pytest.mark.parametrize("degree", [2, 3])
def test_splines_are_as_smooth_across_leaves_as_within(degree):
    _, basis = on_leaves(2, degree)
    rng = np.random.default_rng(3)
    own = basis.hanging @ np.where(basis.hangs, 0.0, rng.normal(size=basis.nodes.size))
    low, high = basis.cell_corners()
    tree, cell_of = basis.leaves.tree, basis.cells_of_nodes()
    _, _, *search = tree.search
    at, first, second = [], [], []
    for c, fine in enumerate(basis.leaves.low[basis.leaf]):
        size = basis.leaves.size[basis.leaf][c]
        for axis in range(2):
            k = fine.astype(np.int64)
            k[axis] += size
            node = node_at(k, *search)
            if node >= 0 and cell_of[node] >= 0 and tree.size[node] >= size:
                t = rng.uniform(size=2)
                t[axis] = 1.0
                at.append(low[c] + t * (high[c] - low[c]))
                first.append(c)
                second.append(cell_of[node])
    at = np.array(at)
    sizes = basis.leaves.size[basis.leaf]
    assert np.any(sizes[first] != sizes[second])
    for values in ("N", "dN"):
        both = [
            _sums(basis.in_cells(at, np.array(cells, np.int32)), values, own)
            for cells in (first, second)
        ]
        assert np.abs(both[0] - both[1]).max() < 1e-11


def _sums(stencils, name, coefficients):
    """Values or gradients of a function at positions, shape (n, 1 or gdim)."""
    values = getattr(stencils, name).reshape(stencils.N.size, -1)
    shape = len(stencils.order), coefficients.size
    columns = np.ascontiguousarray(values.T)
    M = [mpm.basis.stencils.stencil_matrix(stencils, column, shape) for column in columns]
    return np.column_stack([matrix @ coefficients for matrix in M])


@pytest.mark.parametrize(("degree", "order"), [(2, 3), (3, 4)])
def test_projections_have_the_order_of_the_splines(degree, order):
    errors = []
    for cells in (4, 8):
        grid = refined.lattice(2, cells)

        def size(x, cells=cells):  # the same tree, scaled
            apart = np.linalg.norm(x - 0.3 * cells, axis=0) * 4 / cells
            return np.where(apart < 0.8, 0.25, np.where(apart < 1.6, 0.5, 1.0)) * 1.01

        V = mpm.Space(grid, f"bspline{degree}", refine=size, levels=2, per_cell=1)
        points = mpm.fill(grid, mpm.Box((0, 0), (cells, cells)), 1, 1.0, refine=V)
        V.refinement.update_leaves(points.placement("updated"), True)
        basis = V.refinement.basis(V.basis, 0, None)
        gauss, weights = np.polynomial.legendre.leggauss(5)
        t = 0.5 * (gauss + 1)
        offsets = np.array([(a, b) for a in t for b in t])
        low, high = basis.cell_corners()
        x = (low[:, None] + offsets * (high - low)[:, None]).reshape(-1, 2)
        area = np.prod(high - low, axis=1)[:, None] * np.outer(weights, weights).ravel() / 4
        s = basis.in_cells(x, np.repeat(np.arange(len(low), dtype=np.int32), len(offsets)))
        N = mpm.basis.stencils.stencil_matrix(s, s.N, (len(x), basis.nodes.size))
        N = (N @ basis.hanging).tocsc()[:, ~basis.hangs]
        root = np.sqrt(area.ravel())
        f = np.sin(2.0 * x[:, 0] / cells * 4) * np.cos(1.3 * x[:, 1] / cells * 4)
        found = np.linalg.lstsq(root[:, None] * N.toarray(), root * f, rcond=None)[0]
        errors.append(np.linalg.norm(root * (N @ found - f)) / np.linalg.norm(root * f))
    assert np.log2(errors[0] / errors[1]) > order - 0.4


@pytest.mark.parametrize("stabilisation", ["none", "ghost", "aggregation", "extended"])
@pytest.mark.parametrize("gdim", [2, 3])
def test_patch_on_random_leaves(gdim, stabilisation):
    for seed in range(3 if gdim == 2 else 1):
        assert refined.patched(gdim, "bspline2", seed, 3.3, stabilisation) < 1e-12
    assert refined.patched(gdim, "bspline3", 1, 4.0, stabilisation) < 1e-12


@pytest.mark.long
@pytest.mark.parametrize("seed", range(60))
def test_patch_on_many_random_leaves(seed):
    top = 4.0 if seed % 2 else float(np.random.default_rng(seed).uniform(2.5, 3.9))
    kind = ("none", "ghost", "aggregation")[seed % 3]
    assert refined.patched(2 + seed % 2, "bspline2", seed, top, kind) < 1e-12


def settled(basis, cells, averaged=True, axisymmetric=False, stabilisation="ghost", **options):
    """Points of a block on a rough base, part of it cut, after two steps of its weight."""
    grid = refined.lattice(2, 4) if cells == 4 else mpm.create_lattice(
        refined.MPI.COMM_SELF, [np.linspace(0, 4, cells + 1)] * 2
    )  # fmt: skip
    V = mpm.Space(grid, basis, averaged=averaged, **options)
    points = mpm.fill(
        grid, mpm.Box((0, 0), (2.9, 2.3)), per_cell=2, density=2000.0, refine=V,
        axisymmetric=axisymmetric,
    )  # fmt: skip
    u, v = V.increment, V.test
    load = fem.Constant(grid, (0.0, -5.0))
    F = mpm.momentum(mpm.materials.VonMises(2e6, 0.3, yield_stress=4e4), points, u, v)
    F -= ufl.inner(points.density * load, v) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation, tolerance=1e-9)
    for g in (-5.0, -9.0):
        load.value[1] = g
        problem.step()
    return points["x"][np.lexsort(points["x"].T.round(6))]


@pytest.mark.parametrize("basis", ["bspline2", "bspline3"])
@pytest.mark.parametrize(
    ("averaged", "axisymmetric"), [(True, False), (False, False), (True, True)]
)
def test_leaves_of_one_size_are_a_finer_grid(basis, averaged, axisymmetric):
    kind = averaged, axisymmetric
    one = settled(basis, 4, *kind, refine=lambda x: np.full(x.shape[1], 0.5), levels=1)
    np.testing.assert_allclose(one, settled(basis, 8, *kind), rtol=0, atol=2e-8)


def swung(cells, **options):
    """Points of a bar that swings, after three steps in time."""
    grid = mpm.create_lattice(refined.MPI.COMM_SELF, [np.linspace(0, 4, cells + 1)] * 2)
    V = mpm.Space(grid, "bspline2", **options)
    points = mpm.fill(grid, mpm.Box((0, 0), (3.3, 1.3)), per_cell=2, density=2000.0, refine=V)
    F = mpm.momentum(mpm.materials.Hencky(2e6, 0.3), points, V.increment, V.test)
    problem = mpm.Newmark(
        F, V.increment, points, mpm.fixed(V, "left"), stabilisation="ghost", tolerance=1e-10
    )
    x = points["x"]
    points["velocity"] = np.column_stack([np.zeros(len(x)), x[:, 0]])
    for k in range(3):
        problem.step(5e-3 * (k + 1))
    order = np.lexsort(points["x0"].T.round(6))
    return [points[name][order] for name in ("x", "velocity")]


def soaked(cells, **options):
    """Positions and pressures of a saturated block that settles, after two steps."""
    grid = mpm.create_lattice(refined.MPI.COMM_SELF, [np.linspace(0, 4, cells + 1)] * 2)
    V, Q = (mpm.Space(grid, "bspline2", **options), mpm.Space(grid, "gimp", shape=(), **options))
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0, refine=V)
    top = mpm.Surface(points, lambda x: x[1] > 2 - 1e-9, (0, 1), name="top")
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    F = mpm.poromechanics(
        mpm.materials.Hencky(1e6, 0.3), points, fields, tests, drained=top, permeability=1e-3,
        porosity=0.4, fluid=mpm.Fluid(gravity=10.0),
    )  # fmt: skip
    bcs = mpm.rollers(V, "left", "right", "bottom")
    problem = mpm.Transient(
        F, list(fields), points, bcs, stabilisation=["ghost", "ghost"], tolerance=1e-10
    )
    for k in range(2):
        problem.step(10.0 * (k + 1))
    order = np.lexsort(points["x0"].T.round(6))
    return [points[name][order] for name in ("x", "pressure")]


@pytest.mark.parametrize("run", [swung, soaked])
def test_steps_in_time_on_leaves_of_one_size(run):
    fine = run(8)
    one = run(4, refine=lambda x: np.full(x.shape[1], 0.5), levels=1)
    for a, b in zip(one, fine):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-7 * np.abs(b).max())
    several = run(4, refine=lambda x: np.where(x[0] < 1.5, 0.25, 0.5), levels=2)
    assert np.isfinite(several[0]).all()
    assert several[0][:, 1].max() == pytest.approx(fine[0][:, 1].max(), abs=0.15)


@pytest.mark.parametrize("degree", [2, 3])
def test_spaces_of_joined_leaves_are_nested(degree):
    _, basis = on_leaves(2, degree)
    leaves = basis.leaves
    while leaves.size.min() < 1 << leaves.tree.levels:
        fine = LeafSplines.of(leaves, degree)
        leaves, _ = joined(leaves)
        coarse = LeafSplines.of(leaves, degree)
        P = coarse.at(leaves, fine.level, fine.index)
        # hanging splines of the fine leaves follow to the same function
        free = np.where(fine.hanging, 0.0, 1.0)
        assert np.abs(fine.matrix.multiply(free) @ P - P).max() < 1e-14
        assert not coarse.hanging[P.indices].any()


def test_multigrid_on_leaves_takes_few_iterations():
    grid = refined.lattice(3, 6)
    size = 0.25 * 1.01

    def wanted(x):
        return np.maximum(size, 0.3 * np.linalg.norm(x - 3.0, axis=0))

    V = mpm.Space(grid, "bspline2", refine=wanted, levels=2)
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (6, 6, 4.3)), 2, 2000.0, refine=V)
    F = mpm.momentum(mpm.materials.Hencky(1e7, 0.3), points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, 0.0, -10.0)), V.test) * points.dX
    options = {"ksp_type": "cg", "pc_type": "mg"}
    problem = mpm.QuasiStatic(
        F, V.increment, points, mpm.fixed(V, "bottom"), stabilisation="ghost", petsc_options=options
    )
    record = problem.step()
    assert problem.newton.linear.snes.getKSP().getPC().getMGLevels() >= 4
    assert max(record.linear_iterations) <= 20


def test_soft_stiffness_is_refused():
    with pytest.raises(mpm.errors.UnsupportedGridError, match="does not know splines on leaves"):
        settled(
            "bspline2", 4, stabilisation=mpm.Stabilisation("soft", E=2e6, nu=0.3),
            refine=lambda x: np.full(x.shape[1], 0.5), levels=1,
        )  # fmt: skip
