"""Refined spaces: trees, hanging nodes, patch tests, ghost facets."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.grid.lattice import lattice_of
from dolfinmpm.grid.leafnodes import LeafNodes
from dolfinmpm.grid.leaves import leaves_of


def lattice(gdim, cells=4):
    return mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, cells, cells + 1)] * gdim)


def random_size(rng, gdim, levels):
    """Small cells around some places."""
    centres, sizes = rng.uniform(0, 4, (3, gdim)), 2.0 ** -rng.integers(1, levels + 1, 3)

    def size(x):
        apart = np.linalg.norm(x.T[:, None] - centres, axis=2)
        return np.minimum(sizes + np.maximum(apart - 0.3, 0.0), 1.0).min(axis=1) * 1.01

    return size


def covered(grid, levels, size):
    """Leaves all over a grid."""
    every = lattice_of(grid)
    x = np.array(list(np.ndindex(*every.shape))) + 0.5
    given = mpm.Space(grid, "gimp", refine=size, levels=levels).refinement
    return leaves_of(grid.comm, every, levels, x, np.full_like(x, 0.5), given.wanted)


@pytest.mark.parametrize("gdim", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_leaves_tile_the_grid_and_neighbours_differ_by_one_level(gdim, seed):
    grid, rng = lattice(gdim), np.random.default_rng(seed)
    leaves = covered(grid, 4, random_size(rng, gdim, 4))
    low, high = leaves.tree.corners(leaves.node)
    assert np.prod(high - low, axis=1).sum() == pytest.approx(4.0**gdim, rel=1e-14)
    # sizes of all pairs of leaves that touch
    a, b = leaves.low, leaves.low + leaves.size[:, None]
    touch = np.all((a[:, None] <= b) & (a <= b[:, None]), axis=2)
    ratio = leaves.size[:, None] / leaves.size
    assert ratio[touch].max() <= 2.0
    assert leaves.size.min() < leaves.size.max()


@pytest.mark.parametrize("gdim", [2, 3])
def test_hanging_nodes_reproduce_linear_functions_by_independent_nodes(gdim):
    grid, rng = lattice(gdim), np.random.default_rng(7)
    leaves = covered(grid, 3, random_size(rng, gdim, 3))
    nodes = LeafNodes.of(leaves)
    x = leaves.tree.coordinates(nodes.fine)
    f = x @ rng.normal(size=gdim) + 0.3
    assert nodes.hanging.any()
    assert not nodes.hanging[nodes.matrix.indices].any()
    assert np.abs(nodes.matrix @ np.where(nodes.hanging, 0.0, f) - f).max() < 1e-13


def patched(gdim, basis, seed, top, stabilisation, per_cell=2):
    """Largest error of a homogeneous deformation, in units of the largest displacement."""
    grid, rng = lattice(gdim), np.random.default_rng(seed)
    # points stay, also where no leaf outside of the body asks for small neighbours any more
    V = mpm.Space(grid, basis, refine=random_size(rng, gdim, 3), levels=3, per_cell=None)
    corner = (4.0,) * (gdim - 1) + (top,)
    box = mpm.Box((0.0,) * gdim, corner)
    points = mpm.fill(grid, box, per_cell=per_cell, density=1e3, refine=V)
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    A = 1e-3 * rng.normal(size=(gdim, gdim))

    # the sides, and all nodes of the cells that the body cuts; splines begin below their cells
    degree = V.basis.degree
    lowest = top - 1.0 + 1e-9 if degree == 1 else np.ceil(top - 1.0) - 0.51 * (degree - 1)

    def held(x):
        return np.any((x < 1e-9) | (x > 4 - 1e-9), axis=0) | (x[-1] > lowest)

    bcs = [
        condition
        for k in range(gdim)
        for condition in mpm.prescribed(V, held, k, increment=lambda x, k=k: A[k] @ x)
    ]
    problem = mpm.QuasiStatic(
        F, u, points, bcs, tolerance=1e-9, stabilisation=mpm.Stabilisation(stabilisation)
    )
    x0 = points["x"].copy()
    problem.step()
    moved = points["x"] - x0
    return np.abs(moved - x0 @ A.T).max() / np.abs(x0 @ A.T).max()


@pytest.mark.parametrize("basis", ["gimp", "linear"])
@pytest.mark.parametrize("seed", range(3))
def test_patch_on_random_leaves(basis, seed):
    assert patched(2, basis, seed, 4.0, "none") < 1e-12
    assert patched(2, basis, seed, 3.3, "ghost") < 1e-12


@pytest.mark.parametrize("stabilisation", ["none", "ghost", "aggregation"])
def test_patch_in_three_dimensions(stabilisation):
    assert patched(3, "gimp", 4, 3.3, stabilisation) < 1e-12


@pytest.mark.long
@pytest.mark.parametrize("gdim", [2, 3])
@pytest.mark.parametrize("seed", range(100))
def test_patch_on_many_random_leaves(gdim, seed):
    top = 4.0 if seed % 2 else float(np.random.default_rng(seed).uniform(2.5, 3.9))
    kind = ("none", "ghost", "aggregation")[seed % 3]
    assert patched(gdim, "gimp" if seed % 5 else "linear", seed, top, kind) < 1e-12


def gravity_column(cells=4, **options):
    """Mean settlement of a block under its weight."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, cells + 1)] * 2)
    V = mpm.Space(grid, "gimp", **options)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2.3)), per_cell=2, density=2000.0, refine=V)
    u, v = V.increment, V.test
    load = fem.Constant(grid, (0.0, -9.81))
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F -= ufl.inner(points.density * load, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=mpm.Stabilisation("ghost"))
    y0 = points["x"][:, 1].copy()
    problem.step()
    return float(points["V0"] @ (points["x"][:, 1] - y0)) / float(points["V0"].sum())


def test_without_levels_the_result_is_that_of_the_grid():
    def size(x):
        return np.full(x.shape[1], 0.1)

    assert gravity_column(refine=size, levels=0) == gravity_column()


def test_leaves_of_one_size_are_a_finer_grid():
    fine = gravity_column(refine=lambda x: np.full(x.shape[1], 0.25), levels=2)
    assert fine == pytest.approx(gravity_column(cells=16), rel=1e-9)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"basis": "bspline2", "configuration": "total"}, "refine needs"),
        ({"basis": "gimp", "coarsen": 2}, "refine needs"),
        ({"basis": "gimp", "levels": None}, "go together"),
        ({"basis": "gimp", "levels": 11}, "at most 10"),
        ({"basis": "gimp", "refine": 0.1}, "must be a function of positions"),
        ({"basis": "gimp", "refine": "fine", "levels": 0}, "must be a function of positions"),
        ({"basis": "gimp", "refine": []}, "has no size"),
    ],
)
def test_bad_refinements_are_refused(options, text):
    options = {"refine": lambda x: np.ones(x.shape[1]), "levels": 2} | options
    with pytest.raises(mpm.errors.ParameterError, match=text):
        mpm.Space(lattice(2), options.pop("basis"), **options)


@pytest.mark.parametrize("size", [np.nan, -1.0, True, 1.0 + 0.1j])
def test_sizes_that_are_no_lengths_are_refused(size):
    V = mpm.Space(lattice(2), "gimp", refine=lambda x: np.full(x.shape[1], size), levels=1)
    with pytest.raises(mpm.errors.ParameterError, match=r"it must be a length|give sizes in m"):
        mpm.fill(V.grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0, refine=V)


def test_sizes_of_another_dimension_are_refused():
    ball = mpm.RigidBody(mpm.Ball((2, 2, 2), 0.5), increment=(0, 0, 0))
    for levels in (0, 1):
        with pytest.raises(mpm.errors.ParameterError, match="3 dimensions, and the grid has 2"):
            mpm.Space(lattice(2), "gimp", refine=mpm.near(ball, 0.25), levels=levels)


def test_refinement_needs_a_field_of_one_number():
    grid = lattice(2)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    points.add_field("vector", (2,), "m")
    wanted = mpm.where_it_yields(points, 0.1, field="vector")
    with pytest.raises(mpm.errors.ParameterError, match="a field of one number"):
        wanted.wanted(np.zeros((1, 2)), np.ones((1, 2)))
    with pytest.raises(mpm.errors.ParameterError, match="field = 1 must be a str"):
        mpm.where_it_yields(points, 0.1, field=1)


@pytest.mark.parametrize("how", ["linear form over cells", "facets of the grid", "coefficient"])
def test_integrals_over_the_grid_are_refused(how):
    grid = lattice(2)
    V = mpm.Space(grid, "gimp", refine=lambda x: np.full(x.shape[1], 0.5), levels=1)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0, refine=V)
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    if how == "linear form over cells":
        F -= v[1] * points.dC
    elif how == "facets of the grid":
        F += ufl.inner(u("+"), v("+")) * ufl.dS(grid)
    else:
        F += fem.Function(fem.functionspace(grid, ("DG", 0))) * ufl.inner(u, v) * points.dC
    with pytest.raises(mpm.errors.UnsupportedGridError, match=r"leaves|coefficients"):
        mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom")).step()


def test_points_split_and_merge_with_the_leaves():
    grid, place = lattice(2), [1.0]

    def size(x):
        return np.where(np.abs(x[0] - place[0]) < 0.4, 0.25, 1.0)

    V = mpm.Space(grid, "gimp", refine=size, levels=2)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=1e3)
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    mass, number = float(points["density"] @ points["V0"]), len(points)
    first = problem.adapt()
    assert first.split > 0
    inside = np.abs(points["x"][:, 0] - 1.0) < 0.3
    assert points["l"][inside].max() <= 0.0625 * (1 + 1e-9)
    # nothing changes at the same place
    assert problem.adapt().split == 0
    refined, place[0] = len(points), 9.0
    assert problem.step().merged > 0
    assert number <= len(points) < refined
    assert float(points["density"] @ points["V0"]) == pytest.approx(mass, rel=1e-13)


def test_cells_follow_a_part_of_a_body():
    """The sizes are those near the part, where the body has gone."""
    pile = mpm.RigidBody(mpm.Box((0, 0), (1, 9)), increment=(0, -0.2))
    toe = mpm.near(pile, 0.1, reach=0.5, growth=0.5, part=mpm.Box((0, 0), (1, 1)))
    low = np.array([[1.0, 0.5], [1.0, 8.0]])
    assert toe.wanted(low, low + 0.01) == pytest.approx([0.1, 3.25], abs=0.02)
    object.__setattr__(pile, "start", pile.pose.moved(np.array([0.0, -2.0]), np.zeros(1)))
    assert toe.wanted(low, low + 0.01) == pytest.approx([0.5, 4.25], abs=0.02)
    with pytest.raises(mpm.errors.ParameterError, match="3 dimensions"):
        mpm.near(pile, 0.1, part=mpm.Box((0, 0, 0), (1, 1, 1)))


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_cells_follow_a_rigid_body(basis):
    grid = lattice(2)
    ball = mpm.RigidBody(mpm.Ball((2, 2.8), 0.5), increment=(0, -0.2))
    fine = mpm.near(ball, size=0.25, reach=0.2)
    V = mpm.Space(grid, basis, refine=fine, levels=2)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=1e3, refine=V)
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F += mpm.contact(ball, points, u, v)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=mpm.Stabilisation("ghost"))
    splits = [problem.step().split for _ in range(5)]
    assert sum(splits) > 0
    assert ball.force[1] > 0
    apart = np.linalg.norm(points["x"] - ball.position, axis=1) - 0.5
    assert points["l"][apart < 0.1].max() < 0.09


@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation"])
def test_condition_is_bounded_with_leaves_of_two_sizes_in_the_cut(stabilisation):
    rng, found = np.random.default_rng(0), []
    for k in range(12):
        grid, centre = lattice(2), rng.uniform(1, 3, (2, 1))
        centre[1] = 2.3

        def size(x, centre=centre):
            return np.where(np.linalg.norm(x - centre, axis=0) < 0.6, 0.25, 1.0)

        V = mpm.Space(grid, "gimp", refine=size, levels=2)
        top = 2.0 + 10 ** rng.uniform(-4, -0.3) if k % 2 else rng.uniform(2.01, 2.9)
        points = mpm.fill(grid, mpm.Box((0, 0), (4, top)), per_cell=2, density=1e3, refine=V)
        F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        kind = mpm.Stabilisation(stabilisation)
        problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=kind)
        found.append(mpm.study.condition_number(problem.stiffness()))
    assert max(found) / min(found) < 20


def swept(basis, steps, path=None, restart=None):
    """Points of a block whose fine cells move with the number of the step."""
    grid, place = lattice(2), [0]

    def size(x):
        return np.where(np.abs(x[0] - 0.5 - 0.3 * place[0]) < 0.3, 0.25, 1.1)

    V = mpm.Space(grid, basis, refine=size, levels=2)
    points = mpm.fill(grid, mpm.Box((0.2, 0), (3.4, 2)), per_cell=2, density=1e3)
    u, v = V.increment, V.test
    load = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.VonMises(1e6, 0.3, yield_stress=2e4), points, u, v)
    F -= ufl.inner(points.density * load, v) * points.dX
    bcs = mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=mpm.Stabilisation("ghost"))
    if restart is not None:
        problem.load(restart)
    for k in range(len(problem.history), steps):
        place[0], load.value[:] = k, (0.4 * k, -8.0)
        problem.step()
    if path is not None:
        problem.save(path)
    order = np.argsort(points["id"])
    return points["x"][order], [(r.split, r.merged) for r in problem.history]


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_a_restart_goes_on_with_the_same_leaves(tmp_path, basis):
    whole, adapted = swept(basis, 6)
    swept(basis, 3, path=tmp_path / "run.npz")
    again, same = swept(basis, 6, restart=tmp_path / "run.npz")
    assert sum(merged for _, merged in adapted) > 0
    assert same == adapted
    np.testing.assert_array_equal(again, whole)


def at_levels(levels):
    """A problem whose cells are as fine as its levels allow, at the left end."""
    grid = lattice(2)

    def size(x):
        return np.where(x[0] < 0.3, 0.9 * 0.5**levels, 1.05)

    refined = {"refine": size, "levels": levels} if levels else {}
    V = mpm.Space(grid, "gimp", **refined)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 1.5)), 2, 1e3, refine=V if levels else None)
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    return mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"), stabilisation="ghost")


@pytest.mark.parametrize(("there", "here"), [(1, 3), (3, 1), (2, 0), (0, 2)])
def test_a_checkpoint_of_other_levels_keeps_leaves_at_their_places(there, here, tmp_path):
    def edges(leaves, most):
        """Edges of the leaves, at least those of some levels, by their lower corners (m)."""
        low, high = leaves.tree.corners(leaves.node)
        edge = np.maximum(np.ptp([low, high], axis=0)[:, 0], 0.5**most)
        return {tuple(edge[k] * (low[k] // edge[k])): edge[k] for k in range(len(low))}

    first = at_levels(there)
    first.step()
    first.save(tmp_path / "run.npz")
    second = at_levels(here)
    with pytest.warns(mpm.errors.DifferentProblemWarning, match="leaves of field 1: "):
        second.load(tmp_path / "run.npz")
    if there and here:
        held = second.fields[0].space.refinement._former
        now = edges(first.fields[0].space.refinement.leaves, min(there, here))
        assert edges(held, here) == now
    second.step()


def test_points_follow_leaves_along_a_path():
    grid = lattice(2)
    V = mpm.Space(grid, "gimp", refine=lambda x: np.where(x[0] < 1.2, 0.5, 1.0), levels=1)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=1e3)
    u, v, load = V.increment, V.test, fem.Constant(grid, 1.0)
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F += ufl.inner(points.density * load, v[1]) * points.dX
    problem = mpm.ArcLength(F, u, points, mpm.fixed(V, "bottom"), load=load)
    assert problem.step().split > 0
