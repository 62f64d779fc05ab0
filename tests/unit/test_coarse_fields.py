"""Fields whose cells are joined from several of the grid: as on a grid of these cells."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError, UnsupportedGridError
from dolfinmpm.body.points import GHOST_FACETS


def grid_of(cells, parts, dim=2, power=1.0):
    """A grid of [0, 3]^d, graded by a power, with each cell in so many parts per direction."""
    line = 3.0 * np.linspace(0, 1, cells + 1) ** power
    fine = np.interp(np.arange(parts * cells + 1) / parts, np.arange(cells + 1), line)
    return mpm.create_lattice(COMM, [fine] * dim)


def body(grid, dim, rings=False, end=1.63):
    """Points whose domains lie across the lines of both grids."""
    lines = np.linspace(0.07, end, (9 if dim == 2 else 5) + 1)
    middle, half = 0.5 * (lines[1:] + lines[:-1]), 0.5 * (lines[1] - lines[0])
    x = np.stack(np.meshgrid(*[middle] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    return mpm.MaterialPoints.from_arrays(
        grid, x, (2 * half) ** dim, 1.0, half_length=np.full(x.shape, half), axisymmetric=rings
    )


def elastic(V, points, stabilisation, kind=mpm.QuasiStatic, **options):
    pull = ufl.as_vector((0.1,) * (points.gdim - 1) + (0.2,))
    fbar = options.pop("fbar", False)
    law = mpm.materials.Hencky(E=100.0, nu=0.3)
    F = mpm.momentum(law, points, V.increment, V.test, fbar=fbar)
    F -= ufl.inner(pull, V.test) * points.dX
    return kind(
        F, V.increment, points, mpm.fixed(V, "bottom"), stabilisation=stabilisation, **options
    )


def moved(
    parts, basis, stabilisation, dim=2, power=1.0, rings=False, fbar=False, steps=2, coarsen=None
):
    grid = grid_of(6 if dim == 2 else 4, parts, dim, power)
    points = body(grid, dim, rings)
    V = mpm.Space(grid, basis, coarsen=coarsen or parts)
    problem = elastic(V, points, stabilisation, fbar=fbar, tolerance=1e-11)
    for _ in range(steps):
        problem.step()
    return problem, points["x"] - points["x0"]


ADAPTIVE = mpm.Stabilisation("ghost", factor="adaptive")
long = pytest.mark.long


@pytest.mark.parametrize(
    ("basis", "stabilisation", "options"),
    [
        ("linear", "ghost", {}),
        ("gimp", "aggregation", {}),
        ("gimp", "weak-aggregation", {"power": 1.2}),
        ("gimp", "ghost", {"rings": True}),
        ("linear", ADAPTIVE, {"power": 1.2}),
        ("bspline2", "ghost", {"fbar": True}),
        ("bspline2", "aggregation", {}),
        pytest.param("gimp", "ghost", {"dim": 3}, marks=long),
        pytest.param("gimp", "ghost", {"fbar": True}, marks=long),
        pytest.param("gimp", "soft", {}, marks=long),
        pytest.param("bspline2", ADAPTIVE, {}, marks=long),
        pytest.param("bspline2", "extended", {}, marks=long),
        pytest.param("bspline2", "ghost", {"rings": True}, marks=long),
        pytest.param("bspline3", "ghost", {}, marks=long),
        pytest.param("bspline3", "aggregation", {}, marks=long),
    ],
)
def test_a_body_moves_as_on_the_coarse_grid(basis, stabilisation, options):
    there, expected = moved(1, basis, stabilisation, **options)
    here, found = moved(2, basis, stabilisation, **options)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    counts = [(p.history[-1].unknowns, p.here.active_cells) for p in (here, there)]
    assert counts[0] == counts[1]
    assert not np.allclose(
        found, moved(2, basis, stabilisation, coarsen=1, **options)[1], rtol=1e-4
    )


def test_three_cells_are_one():
    expected, found = (moved(parts, "gimp", "ghost", steps=1)[1] for parts in (1, 3))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("basis", ["linear", "bspline2"])
def test_a_scalar_spreads_as_on_the_coarse_grid(basis):
    """Terms of the points, over active cells and over facets of both."""
    found = []
    for parts in (1, 2):
        grid = grid_of(6, parts)
        points = body(grid, 2)
        T = mpm.Space(grid, basis, shape=(), coarsen=parts)
        u, v = T.increment, T.test
        F = (1 + points.x[0]) * ufl.inner(ufl.grad(u), ufl.grad(v)) * points.dX
        F += 1e-3 * ufl.inner(ufl.grad(u), ufl.grad(v)) * points.dC
        F -= ufl.sin(points.x[1]) * v * points.dX
        F += mpm.ghost(points, u, v, 0.03)
        points.add_field("value")
        problem = mpm.QuasiStatic(F, u, points, mpm.fixed(T, "left"), updates={"value": u})
        problem.step()
        found.append(points["value"].copy())
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-12 * np.abs(found[0]).max())


@pytest.mark.parametrize("power", [1.0, 1.3])
@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_facets_in_parts_are_whole_ones(monkeypatch, basis, power):
    """Classes of coarse facets, against DOLFINx's integrals over their parts."""
    expected = moved(2, basis, "ghost", power=power, steps=1)[1]
    monkeypatch.setattr("dolfinmpm.assembly.gridassembler.uses_facet_classes", lambda *_: False)
    problem, found = moved(2, basis, "ghost", power=power, steps=1)
    assert not problem.form.grid.splines
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_ghost_facets_are_those_of_coarse_cells():
    """Inside coarse cells there are none, and each whole facet has all its parts."""
    facets = []
    for parts in (1, 2):
        grid = grid_of(6, parts)
        V = mpm.Space(grid, "linear", coarsen=parts)
        problem = elastic(V, body(grid, 2), "ghost")
        problem.activate()
        (field,) = problem.here.fields
        rows = field.entities[GHOST_FACETS].reshape(-1, 4)[:, [0, 2]]
        cells = field.basis.lattice.cell_ijk[rows]
        low = cells.min(axis=1)
        facets.append(sorted(map(tuple, np.hstack([low, cells.max(axis=1) - low]))))
    assert facets[1] == sorted(facets[0] * 2)
    assert len(facets[0]) > 10


def test_terms_over_facets_that_measure_cells_mean_the_coarse_ones():
    found = []
    for size in (lambda V: ufl.CellVolume(V.grid)("+"), lambda V: V.cell_size**2):
        grid = grid_of(6, 2)
        points = body(grid, 2)
        points.add_field("value")
        V = mpm.Space(grid, "linear", shape=(), coarsen=2)
        u, v = V.increment, V.test
        F = ufl.inner(ufl.grad(u), ufl.grad(v)) * points.dX - v * points.dX
        jumps = ufl.inner(ufl.jump(ufl.grad(u)), ufl.jump(ufl.grad(v)))
        F += size(V) * jumps * points.dS
        problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "left"), updates={"value": u})
        problem.step()
        found.append(points["value"].copy())
    np.testing.assert_allclose(found[0], found[1], rtol=1e-10)


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.Explicit])
def test_in_time(kind):
    found = []
    for parts in (1, 2):
        grid = grid_of(6, parts)
        points = body(grid, 2)
        V = mpm.Space(grid, "gimp", coarsen=parts)
        problem = elastic(V, points, "none" if kind is mpm.Explicit else "ghost", kind)
        for k in range(1, 6):
            problem.step(0.002 * k)
        # explicit steps keep points in the order of the grid's cells
        found.append(points["x"][np.argsort(points["id"])])
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-11)


def test_lines_laid_anew():
    """A grid that is graded otherwise from step to step takes the coarse lines along."""
    found = []
    for parts in (1, 2):
        grid = grid_of(6, parts, power=1.3)
        points = body(grid, 2)
        V = mpm.Space(grid, "gimp", coarsen=parts)
        problem = elastic(V, points, "ghost", tolerance=1e-12)
        problem.step()
        other = 3.0 * np.linspace(0, 1, 7) ** 1.15
        fine = np.interp(np.arange(6 * parts + 1) / parts, np.arange(7), other)
        mpm.regrid(problem, [fine] * 2)
        problem.step()
        found.append(points["x"].copy())
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-12)


def test_sizes_of_cells():
    grid = grid_of(6, 2)
    V, W = mpm.Space(grid), mpm.Space(grid, coarsen=2)
    assert V.cell_size is mpm.cell_size(grid)
    assert float(W.cell_size.value) == pytest.approx(0.5)
    graded = grid_of(6, 2, power=1.3)
    coarse = mpm.Space(graded, coarsen=2).cell_size.x.array
    expected = mpm.cell_size(grid_of(6, 1, power=1.3)).x.array
    np.testing.assert_allclose(np.unique(coarse.round(9)), np.unique(expected.round(9)))


def test_cells_that_cannot_be_joined():
    odd = mesh.create_rectangle(COMM, [(0, 0), (1, 1)], (5, 4), mesh.CellType.quadrilateral)
    with pytest.raises(UnsupportedGridError, match=r"the grid has 5 × 4 cells.*multiples of 2"):
        mpm.Space(odd, coarsen=2)
    mpm.Space(odd, "gimp", coarsen=1)
    with pytest.raises(UnsupportedGridError, match="multiples of 3"):
        mpm.Space(grid_of(4, 1), "bspline2", coarsen=3)
    triangles = mesh.create_unit_square(COMM, 4, 4)
    with pytest.raises(UnsupportedGridError, match=r"coarsen=2 needs a rectangular grid"):
        mpm.Space(triangles, coarsen=2)
    for wrong in (0, -1, 1.5, "2"):
        with pytest.raises(ParameterError, match="coarsen"):
            mpm.Space(odd, coarsen=wrong)
