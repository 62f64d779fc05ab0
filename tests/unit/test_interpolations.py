"""Interpolations between the levels of multigrid: polynomials, iterations, other solvers."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.basis.bspline import greville
from dolfinmpm.basis.knotinsertion import knot_insertion
from dolfinmpm.solve import latticelevels
from dolfinmpm.solve.interpolations import (
    LatticeLevel,
    interpolations,
    lattice_family,
    next_level,
)
from dolfinmpm.solve.latticelevels import finest_level, lattice_families, levels_of
from dolfinmpm.solve.leaflevels import joined, leaf_families


def body(
    n, kind="quadrilateral", basis="linear", stabilisation="ghost", nu=0.3, top=0.63, levels=0,
    **more,
):  # fmt: skip
    """A block under its weight whose upper sides cut cells, perhaps smaller ones in a corner."""
    grid = unit_grid(kind, n)
    d = grid.geometry.dim
    refined = {"refine": lambda x: 0.1 * abs(x[:d] - top).max(axis=0), "levels": levels}
    V = mpm.Space(grid, basis, **(refined if levels else {}))
    box = mpm.Box((0,) * d, (top,) * d)
    points = mpm.fill(grid, box, 2, 1.0, refine=V if levels else None)
    F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=nu), points, V.increment, V.test)
    weight = ufl.as_vector([0.0] * (d - 1) + [-1.0])
    F -= ufl.inner(points.density * weight, V.test) * points.dX
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left")
    return mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation, **more)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("cells", [6, 7])
def test_knots_are_inserted_exactly(degree, cells):
    """Coefficients of 1 and x, also on uneven lines: sums of weights and Greville points."""
    line = np.linspace(0.0, 1.0, cells + 1) ** 1.3
    lines, parents = knot_insertion(line, degree)
    assert lines.size == (cells + 1) // 2 + 1
    coarse, fine = greville(lines, degree), greville(line, degree)
    rows = np.repeat(np.arange(fine.size), np.diff(parents.start))
    for values, expected in ((np.ones(coarse.size), np.ones(fine.size)), (coarse, fine)):
        found = np.bincount(rows, parents.weight * values[parents.parent], fine.size)
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def blossoms(line, degree):
    """Coefficients of x² in quadratic splines: products of the two inner knots."""
    assert degree == 2
    knots = np.concatenate([[line[0]] * 2, line, [line[-1]] * 2])
    return knots[1:-2] * knots[2:-1]


@pytest.mark.parametrize(("basis", "degree"), [("linear", 1), ("gimp", 1), ("bspline2", 2)])
@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation"])
def test_active_nodes_get_polynomials(basis, degree, stabilisation):
    """Rows without prescribed parents reproduce linear functions; splines quadratic ones too."""
    problem = body(24, basis=basis, stabilisation=stabilisation)
    here = problem.activate()
    of_basis = here.fields[0].basis
    lines = of_basis.lattice.lines
    free = finest_level(here)
    # all components free, so that no parent is missing
    finest = LatticeLevel(free.nodes, np.ones_like(free.free), False)
    levels = levels_of(MPI.COMM_SELF, finest, lattice_families(lines, degree))
    assert len(levels) > 1
    [P] = interpolations(MPI.COMM_SELF, levels[:2])
    coarse = [knot_insertion(line, degree)[0] for line in lines]
    kinds = [greville, blossoms] if degree == 2 else [greville]
    for of in kinds:
        x, y = P.createVecs()
        of_coarse = [of(line, degree)[levels[1].nodes[:, d]] for d, line in enumerate(coarse)]
        of_fine = [of(line, degree)[finest.nodes[:, d]] for d, line in enumerate(lines)]
        x.setArray(np.repeat(of_coarse[0] + 2.0 * of_coarse[1], 2))
        P.mult(x, y)
        np.testing.assert_allclose(y.array, np.repeat(of_fine[0] + 2.0 * of_fine[1], 2), atol=1e-12)


@pytest.mark.parametrize(("kind", "n"), [("quadrilateral", 8), ("hexahedron", 4)])
def test_nodes_of_leaves_get_linear_functions(kind, n, monkeypatch):
    """On every level, through hanging nodes, and on the levels of the grid."""
    monkeypatch.setattr(latticelevels, "_COARSEST", 1)
    here = body(n, kind, levels=3).activate()
    basis, finest = here.fields[0].basis, finest_level(here)
    finest = LatticeLevel(finest.nodes, np.ones_like(finest.free), False)
    levels = levels_of(MPI.COMM_SELF, finest, leaf_families(basis.leaves))
    assert len(levels) > 2
    d = finest.nodes.shape[1]
    linear = [np.repeat(1.0 + level.nodes @ np.arange(1.0, d + 1.0), d) for level in levels]
    for k, P in enumerate(interpolations(MPI.COMM_SELF, levels)):
        x, y = P.createVecs()
        x.setArray(linear[k + 1])
        P.mult(x, y)
        np.testing.assert_allclose(y.array, linear[k], rtol=1e-13)


@pytest.mark.parametrize(("kind", "n"), [("quadrilateral", 8), ("hexahedron", 4)])
def test_joined_leaves_hold_the_leaves(kind, n):
    leaves = body(n, kind, levels=3).activate().fields[0].basis.leaves
    coarse, into = joined(leaves)
    assert coarse.node.size < leaves.node.size
    low, high = coarse.low[into], (coarse.low + coarse.size[:, None])[into]
    assert np.all(low <= leaves.low)
    assert np.all(leaves.low + leaves.size[:, None] <= high)
    # joined or not, no two overlap
    volume = coarse.size.astype(float) ** leaves.low.shape[1]
    inside = np.bincount(into, leaves.size.astype(float) ** leaves.low.shape[1])
    assert np.all(inside <= volume)
    assert np.all(coarse.size[into] <= 2 * leaves.size)


def test_prescribed_nodes_have_prescribed_parents():
    nodes = np.arange(5, dtype=np.int32)[:, None]
    fixed = np.array([False, True, True, True, True])[:, None]
    _, parents = knot_insertion(np.arange(5.0), 1)
    fine = LatticeLevel(nodes, fixed, True, lattice_family(nodes, [parents]))
    coarse = next_level(MPI.COMM_SELF, fine)
    assert coarse.nodes.ravel().tolist() == [1, 2]
    [P] = interpolations(MPI.COMM_SELF, [fine, coarse])
    dense = P.convert("dense").getDenseArray()
    assert dense.tolist() == [[0, 0], [0.5, 0], [1, 0], [0.5, 0.5], [0, 1]]


@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation"])
@pytest.mark.parametrize(
    ("basis", "grids"),
    [
        ("linear", ((80, 0), (160, 0))), ("linear", ((80, 2), (80, 5))),
        ("gimp", ((80, 0), (160, 0))), ("gimp", ((80, 2), (80, 5))),
        ("bspline2", ((80, 0), (160, 0))),
    ],
)  # fmt: skip
def test_iterations_do_not_grow_with_the_grid(basis, grids, stabilisation):
    """By cells of the grid, and by levels of leaves."""
    # both sizes keep preconditioners, so that both solutions have the same digits
    most = []
    for n, levels in grids:
        options = {"ksp_type": "cg", "pc_type": "mg"}
        given = {"nu": 0.45, "levels": levels, "petsc_options": options}
        problem = body(n, basis=basis, stabilisation=stabilisation, **given)
        problem.step()
        linear = problem.newton.linear
        b = np.random.default_rng(0).uniform(-1, 1, problem.here.unknowns.owned)
        linear.solve(b)
        ksp = linear.snes.getKSP()
        assert ksp.getPC().getMGLevels() > 1
        assert not linear.stuck
        most.append(ksp.getIterationNumber())
    assert max(most) <= 40
    assert most[1] <= most[0] + 5
